"""The side of the process that asks: a container's tables as runs."""

import json
import os
import struct
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

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
_MAX_LINE = 16 << 20
_TO_END_S = 10.0
_CHILD = "hil_forceps.data.readers.containers.child"
_ROOT = Path(__file__).parents[4]


def read_contained(kind: str, name: str, request: Request) -> list[Run]:
    """Read every table of a file that has columns of a run; UserError where none has, or the file can't be used."""
    path = request.path
    kept, note = map_beside(path)
    mapping = {**kept, **request.mapping}
    with _asked(path, kind, name) as first:
        tables = first["tables"]
    runs: list[Run] = []
    strange: list[str] = []
    for number, table in enumerate(tables):
        try:
            run = _read_table(path, kind, name, number, len(tables) > 1, table, request, mapping)
        except NoRunError as error:
            strange += error.problems
            continue
        runs.append(Run(run.name, run.columns, (*table["notes"], *run.notes, *([note] if note else []))))
    if not runs:
        raise NoRunError(strange)
    return runs


def _read_table(
    path: Path,
    kind: str,
    name: str,
    number: int,
    is_one_of_many: bool,
    table: dict[str, Any],
    request: Request,
    mapping: dict[str, Source],
) -> Run:
    label = table["label"]
    place = f"{path}!{label}" if label else str(path)
    header = Header(tuple(table["names"]), tuple(table["units"]), place, table["group"])
    base = mapping.get("time_s")
    at = None
    if base is not None and base.text.startswith("@") and kind == "mf4":
        if base.text[1:] not in header.names:
            raise UserError(f"{path}: {base.told_by}: no channel {base.text[1:][:40]!r} is in the file")
        at = header.names.index(base.text[1:])
        mapping = {each: source for each, source in mapping.items() if each != "time_s"}

    def get(uses: Sequence[Use]) -> list[Column]:
        return _columns(path, kind, name, number, [use.position for use in uses], at)

    own_name = f"{path.stem}-{label}" if is_one_of_many else path.stem
    run = read_named(path, own_name, header, get, request.rig, mapping, request.on_columns, first=table["first_row"])
    if at is None:
        return run
    return Run(
        run.name, run.columns, (*run.notes, f"interpolated linearly at the times of {base.text[1:]!r}" if base else "")
    )


def _columns(path: Path, kind: str, name: str, table: int, positions: list[int], base: int | None) -> list[Column]:
    with _asked(path, kind, name, {"table": table, "positions": positions, "base": base}) as answer:
        out: IO[bytes] = answer["out"]
        columns = []
        for _ in positions:
            head = out.read(8)
            count = struct.unpack("<q", head)[0] if len(head) == 8 else -1
            if not 0 <= count <= MAX_SAMPLES:
                raise UserError(f"{path}: more than {MAX_SAMPLES} samples, or the reading was ended; cut it")
            data = out.read(8 * count)
            if len(data) < 8 * count:
                raise UserError(f"{path}: the reading was ended: not enough memory for it; cut it")
            columns.append(np.frombuffer(data, dtype="<f8"))
    return columns


@contextmanager
def _asked(path: Path, kind: str, name: str, wanted: dict[str, Any] | None = None) -> Iterator[dict[str, Any]]:
    """Start the child, ask, and yield its (last) answer, with what follows as `out`; UserError where it has none."""
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
        assert child.stdin is not None
        assert child.stdout is not None
        is_done = False
        try:
            answer = _answer(path, name, child.stdout, child)
            if wanted is not None:
                child.stdin.write(json.dumps(wanted).encode() + b"\n")
                child.stdin.flush()
                answer = _answer(path, name, child.stdout, child)
            yield {**answer, "out": child.stdout}
            child.stdin.close()  # then it ends by itself, and takes what files it made for itself away
            child.wait(_TO_END_S)
            is_done = True
        except subprocess.TimeoutExpired:
            pass
        finally:
            if not is_done:
                child.kill()


def _answer(path: Path, name: str, out: IO[bytes], child: "subprocess.Popen[bytes]") -> dict[str, Any]:
    line = out.readline(_MAX_LINE)
    if not line.endswith(b"\n"):
        code = child.wait()
        how = f"signal {-code}" if code < 0 else f"code {code}"
        raise UserError(f"{path}: its reader ended ({how}): not a sound {name} file; write it again, or as CSV")
    answer: dict[str, Any] = json.loads(line)
    if "missing" in answer:
        told = f"{name} needs {answer['missing']}, which can't be imported ({answer['error'][:100]})"
        raise UserError(f"{path}: {told}: pip install 'hil-forceps[formats]', or export it as CSV")
    if "error" in answer:
        raise UserError(f"{path}: {name}: {answer['error']}")
    return answer
