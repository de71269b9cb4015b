"""The side of the process that asks: a container's tables as runs."""

import json
import os
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hil_forceps.data.readers.containers.content import MAX_SAMPLES
from hil_forceps.data.readers.format import Request
from hil_forceps.data.readers.no_run import NoRunError
from hil_forceps.data.readers.tables.columns import Header, Use
from hil_forceps.data.readers.tables.mapping import Source, map_beside
from hil_forceps.data.readers.tables.named_columns import read_named
from hil_forceps.data.run import Column, Run
from hil_forceps.rig.errors import UserError

MAX_FILE_BYTES = 2 << 30
_MAX_LINE_BYTES = 16 << 20
_MAX_ENDING_TIME_S = 10.0
_CHILD = "hil_forceps.data.readers.containers.child"
_ROOT = Path(__file__).parents[4]


def read_contained(kind: str, name: str, request: Request) -> list[Run]:
    """Read every table of a file that has columns of a run; UserError where none has, or the file can't be used."""
    kept, note = map_beside(request.path)
    mapping = {**kept, **request.mapping}
    runs: list[Run] = []
    strange: list[str] = []
    with _opened(request.path, kind, name) as file:
        for number, table in enumerate(file.tables):
            try:
                run = _read_table(file, number, table, request, mapping)
            except NoRunError as error:
                strange += error.problems
                continue
            runs.append(Run(run.name, run.columns, (*table["notes"], *run.notes, *([note] if note else []))))
    if not runs:
        raise NoRunError(strange)
    return runs


class _File:
    """A container, as the child that reads it tells of it."""

    def __init__(self, path: Path, name: str, child: "subprocess.Popen[bytes]") -> None:
        assert child.stdin is not None
        assert child.stdout is not None
        self.path = path
        self._name = name
        self._child = child
        self._asks, self._answers = child.stdin, child.stdout
        self.tables: list[dict[str, Any]] = self._answer()["tables"]

    def columns(self, table: int, positions: list[int], base: int | None) -> list[Column]:
        """Ask for columns; UserError where they can't be had."""
        self._asks.write(json.dumps({"table": table, "positions": positions, "base": base}).encode() + b"\n")
        self._asks.flush()
        self._answer()
        return [self._column() for _ in positions]

    def _answer(self) -> dict[str, Any]:
        line = self._answers.readline(_MAX_LINE_BYTES)
        try:
            answer: dict[str, Any] = json.loads(line)
        except ValueError:
            raise self._ended() from None
        if "missing" in answer:
            told = f"{self._name} needs {answer['missing']}, which can't be imported ({answer['error'][:100]})"
            raise UserError(f"{self.path}: {told}: pip install 'hil-forceps[{answer['extra']}]', or export it as CSV")
        if "error" in answer:
            raise UserError(f"{self.path}: {self._name}: {answer['error']}")
        return answer

    def _column(self) -> Column:
        head = self._answers.read(8)
        count = struct.unpack("<q", head)[0] if len(head) == 8 else -1
        data = self._answers.read(8 * count) if 0 <= count <= MAX_SAMPLES else b""
        if count < 0 or len(data) < 8 * count:
            raise self._ended()
        return np.frombuffer(data, dtype="<f8")

    def _ended(self) -> UserError:
        self._child.kill()
        code = self._child.wait()
        how = f"signal {-code}" if code < 0 else f"code {code}"
        return UserError(
            f"{self.path}: its reader ended ({how}): not a valid {self._name} file; write it again, or as CSV"
        )


@contextmanager
def _opened(path: Path, kind: str, name: str) -> Iterator[_File]:
    """Start the child that reads a file, and let it end; UserError where the file is too large or damaged."""
    if path.stat().st_size > MAX_FILE_BYTES:
        raise UserError(f"{path}: larger than {MAX_FILE_BYTES >> 30} GiB; cut it")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(_ROOT), os.environ.get("PYTHONPATH", "")])}
    with subprocess.Popen(  # noqa: S603 - this interpreter, our own module
        [sys.executable, "-m", _CHILD, kind, str(path.absolute())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    ) as child:
        try:
            yield _File(path, name, child)
            assert child.stdin is not None
            child.stdin.close()  # then it ends by itself, and takes what files it made for itself away
            child.wait(_MAX_ENDING_TIME_S)
        except subprocess.TimeoutExpired:
            pass
        except BrokenPipeError:
            raise UserError(f"{path}: its reader ended: not a valid {name} file; write it again, or as CSV") from None
        finally:
            child.kill()


def _read_table(
    file: _File, number: int, table: dict[str, Any], request: Request, mapping: Mapping[str, Source]
) -> Run:
    label = table["label"]
    place = f"{file.path}!{label}" if label else str(file.path)
    header = Header(tuple(table["names"]), tuple(table["units"]), place, table["group"])
    base = mapping.get("time_s")
    at = None
    if base is not None and base.text.startswith("@"):
        if base.text[1:] not in header.names:
            raise UserError(
                f"{file.path}: {base.told_by}: the file has no channel {base.text[1:][:40]!r}; correct the name"
            )
        at = header.names.index(base.text[1:])
        mapping = {each: source for each, source in mapping.items() if each != "time_s"}

    def get(uses: Sequence[Use]) -> list[Column]:
        return file.columns(number, [use.position for use in uses], at)

    name = f"{file.path.stem}-{label}" if len(file.tables) > 1 else file.path.stem
    run = read_named(file.path, name, header, get, request.rig, mapping, request.on_columns, first=table["first_row"])
    if at is None:
        return run
    return Run(run.name, run.columns, (*run.notes, f"interpolated linearly at the times of {header.names[at]!r}"))
