"""Recordings of the service as runs."""

from dataclasses import replace

from hil_forceps.data.readers.format import Format, Request
from hil_forceps.data.run import Run


def _read(request: Request) -> list[Run]:
    from hil_forceps.data.recording.reader import read_recording  # noqa: PLC0415 - mcap and zstd, for recordings only

    return [replace(read_recording(request.path).to_run(), name=request.path.stem)]


FORMAT = Format("MCAP", (".mcap",), _read, magic=(b"\x89MCAP0\r\n",))
