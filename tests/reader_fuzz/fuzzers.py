"""One fuzzer a reader: a strategy for its input, and what must hold of what comes out.

Whatever the bytes: a reader ends, gives no more frames or rows than the bytes can hold, and raises nothing but
`UserError`, whose problems are one line each and begin with the path. What a whole file says of its beginning, the
file cut anywhere says, too (`cut_*`).
"""

import json
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from hypothesis import strategies as st

from hil_forceps.bench.assembly import settings_of
from hil_forceps.bench.explanation.evidence import read_evidence
from hil_forceps.bench.explanation.story import story_of, text_of
from hil_forceps.bench.recovery.recording import recover, sound_file
from hil_forceps.data.readers.bus_logs.account import Account, LoggedFrame
from hil_forceps.data.readers.bus_logs.frames import read_frames
from hil_forceps.data.readers.bus_logs.run import read_bus_log
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables.mapping import load_map
from hil_forceps.data.recording.reader import parse_recording
from hil_forceps.data.strict_json import parse_json
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_files, sound_logs
from tests.reader_fuzz.damage import WORDS, Edit, edited, edited_lines, edits

DEFLATE_RATIO = 1032  # of zlib, at best
BLF_FRAME_BYTES = 16 + 16 + 16  # heads and data of the smallest
PLACES = st.integers(0, (1 << 20) - 1)


class FoundError(AssertionError):
    """Something that must not be."""


class Fuzzer(NamedTuple):
    """Inputs, and the check that every one of them has to pass; it returns whether the input was read."""

    inputs: st.SearchStrategy[Any]
    check: Callable[[Any], bool]


@cache
def scratch() -> Path:
    """Return a folder for files, the same in one process."""
    kept.append(tempfile.TemporaryDirectory(prefix="reader-fuzz-"))
    return Path(kept[-1].name)


kept: list["tempfile.TemporaryDirectory[str]"] = []


def require(holds: bool, what: str) -> None:
    """FoundError where something doesn't hold."""
    if not holds:
        raise FoundError(what)


def told_well(path: Path, error: UserError) -> None:
    """Check the words of a refusal."""
    require(len(error.problems) > 0, "a refusal without a word")
    for problem in error.problems:
        require(problem.startswith(str(path)), f"no path before: {problem!r}")
        require(problem.isprintable() and len(problem) < 1000, f"no single line, or too long: {problem[:1000]!r}")
        require(len(problem) > len(str(path)) + 4, f"no words: {problem!r}")


# --- bus logs ---------------------------------------------------------------------------------------------------------


def most_frames(content: bytes, suffix: str) -> int:
    """Return how many frames so many bytes can hold: one a line, or as many as zlib can pack."""
    if suffix == ".blf":
        return len(content) * DEFLATE_RATIO // BLF_FRAME_BYTES
    return content.count(b"\n") + 1


def frames_of(path: Path, content: bytes, account: Account) -> list[LoggedFrame]:
    """Read a log; FoundError when it gives more frames than it can hold."""
    path.write_bytes(content)
    most = most_frames(content, path.suffix)
    found = []
    for frame in read_frames(path, account=account):
        found.append(frame)
        require(len(found) <= most, f"more than {most} frames out of {len(content)} bytes")
    return found


def check_log(suffix: str) -> Callable[[bytes], bool]:
    """Return the check of a log's bytes: as frames, then as runs."""

    def check(content: bytes) -> bool:
        path = scratch() / f"fuzz{suffix}"
        account = Account()
        try:
            found = frames_of(path, content, account)
        except UserError as error:
            told_well(path, error)
            found = []
        for frame in found:
            require(frame.time_ns is None or 0 <= frame.time_ns < 10**22, f"time {frame.time_ns}")
            require(0 <= frame.frame.arbitration_id < 1 << 12, f"id {frame.frame.arbitration_id}")
            require(len(frame.frame.data) <= (64 if frame.frame.is_fd else 8), f"data {frame.frame.data!r}")
        require(all(told.isprintable() for told in account.told()), f"remarks {account.told()}")
        return runs_are_sound(path, lambda: read_bus_log(path), most_frames(content, suffix))

    return check


def runs_are_sound(path: Path, read: Callable[[], Any], most_rows: int) -> bool:
    """Check what comes of a file as runs; True when there was any."""
    try:
        runs = read()
    except UserError as error:
        told_well(path, error)
        return False
    require(len(runs) > 0, "no run and no refusal")
    for run in runs:
        require(len(run) <= most_rows, f"{len(run)} rows out of what can hold {most_rows}")
        require(all(note.isprintable() and len(note) < 1000 for note in run.notes), f"notes {run.notes}")
    return True


def log_lines() -> dict[str, list[bytes]]:
    """Return sound text logs by name; the suffix is what follows the last dot."""
    frames = sound_logs.traffic(12)
    return {
        "candump.log": sound_logs.candump(frames),
        **{
            f"printed-{stamps or 'none'}.log": sound_logs.printed(frames, stamps) for stamps in ("", "a", "A", "d", "z")
        },
        "absolute.asc": sound_logs.asc(frames),
        "relative.asc": sound_logs.asc(frames, "relative"),
        "decimal.asc": sound_logs.asc(frames, base=10),
        **{f"{v}.trc": sound_logs.trc(frames, v) for v in ("1.0", "1.1", "1.2", "1.3", "2.0", "2.1")},
    }


LOGS = log_lines()
OBJECTS = {version: sound_logs.blf_objects(sound_logs.traffic(12), version) for version in (1, 2)}


def text_logs(suffix: str) -> st.SearchStrategy[bytes]:
    """Damage lines of a log, then bytes of it."""
    logs = [lines for name, lines in LOGS.items() if name.endswith(suffix)]
    return st.builds(lambda lines, at, made: edited(edited_lines(lines, at), made), st.sampled_from(logs), edits, edits)


def _blf(version: int, inside: list[Edit], size: int, packed: bool, outside: list[Edit]) -> bytes:
    return edited(sound_logs.blf(edited(OBJECTS[version], inside), size, packed=packed), outside)


BLF = st.builds(_blf, st.sampled_from([1, 2]), edits, st.sampled_from([64, 200, 1000, 1 << 20]), st.booleans(), edits)


# --- a file that was cut anywhere -------------------------------------------------------------------------------------


class Cut(NamedTuple):
    """A sound file, how much of it is left, and whether zero bytes follow."""

    name: str
    where: int
    zeros: int


cuts: st.SearchStrategy[tuple[int, int]] = st.tuples(PLACES, st.sampled_from([0, 0, 1, 600, 9000]))


def check_cut_log(cut: Cut) -> bool:
    """What is before the cut comes out as from the whole log; what isn't there is said."""
    whole = b"".join(LOGS[cut.name])
    suffix = Path(cut.name).suffix
    where = cut.where % (len(whole) + 1)
    expected, read = Account(), Account()
    try:
        frames = frames_of(scratch() / f"whole{suffix}", whole, expected)
        part = frames_of(scratch() / f"part{suffix}", whole[:where] + bytes(cut.zeros), read)
    except UserError as error:
        require("-td" in str(error) or "nothing in it is a frame" in str(error), f"refused: {error}")
        return False
    require(part == frames[: len(part)], f"cut at {where}: other frames than before the cut")
    others = whole.count(b"\n") - len(frames)  # lines of a head and of events
    require(len(part) >= whole[:where].count(b"\n") - others, f"cut at {where}: {len(part)} frames are too few")
    torn = cut.zeros > 0 or (where > 0 and not whole[:where].endswith(b"\n") and whole[:where].split(b"\n")[-1].strip())
    said = bool(read.unreadable or read.damage)
    require(said or not torn, f"cut at {where}, {cut.zeros} zeros: not a word")
    return True


def check_cut_csv(cut: Cut) -> bool:
    """The rows before the cut, and no other; where the last line isn't whole, it is said."""
    whole = TABLES["a.csv"]
    where = cut.where % (len(whole) + 1)
    path = scratch() / "cut.csv"
    path.write_bytes(whole[:where] + bytes(cut.zeros))
    full = sound_files.a_run(20)
    try:
        (run,) = read_run(path)
    except UserError as error:
        told_well(path, error)
        return False
    require(len(run) == whole[:where].count(b"\n") - 1, f"cut at {where}: {len(run)} rows")
    for name, values in run.columns.items():
        require(values.tobytes() == full.columns[name][: len(run)].tobytes(), f"cut at {where}: {name} is another")
    is_whole = whole[:where].endswith(b"\n") and not cut.zeros
    require(is_whole == (not any("left out" in note for note in run.notes)), f"cut at {where}: {run.notes}")
    return True


# --- tables, recordings -----------------------------------------------------------------------------------------------

TABLES = sound_files.tables()
MAT = sound_files.mat()
STRUCTURE = sound_files.mat_structure()
LAYOUTS = sound_files.layouts()
RECORDS = sound_files.records(sound_files.recording(12))


def check_file(name: str) -> Callable[[bytes], bool]:
    """Return the check of a file that `read_run` reads; rows may be packed, a number of a thousandth of a byte each."""
    rig = load_rig(sound_files.ROOT / "configs" / "epos_screw.yaml")

    def check(content: bytes) -> bool:
        path = scratch() / name
        path.write_bytes(content)
        return runs_are_sound(path, lambda: read_run(path, rig=rig), (len(content) + 1) * DEFLATE_RATIO)

    return check


def _of(sound: bytes) -> st.SearchStrategy[bytes]:
    return st.builds(edited, st.just(sound), edits)


def _recording(which: int, inside: list[Edit], outside: list[Edit]) -> bytes:
    at = which % len(RECORDS)
    damaged = [(opcode, edited(body, inside) if place == at else body) for place, (opcode, body) in enumerate(RECORDS)]
    return edited(sound_files.mcap(damaged), outside)


def check_container(name: str) -> Callable[[bytes], bool]:
    """Return the check of a container by its library in a process of its own, where it may die or go round for ever."""

    def check(content: bytes) -> bool:
        path = scratch() / name
        path.write_bytes(content)
        return runs_are_sound(path, lambda: read_run(path), (len(content) + 1) * DEFLATE_RATIO)

    return check


def _layout(lines: list[bytes], at: list[Edit], made: list[Edit], packing: str, outside: list[Edit]) -> bytes:
    return edited(sound_files.packed_text(edited(edited_lines(lines, at), made), packing), outside)


def _book(which: int, inside: list[Edit], outside: list[Edit]) -> bytes:
    parts = sound_files.excel_parts(sound_files.container("a.xlsx"))
    at = sorted(parts)[which % len(parts)]
    return edited(sound_files.excel(parts | {at: edited(parts[at], inside)}), outside)


def _of_container(name: str) -> st.SearchStrategy[bytes]:
    return st.builds(lambda made: edited(sound_files.container(name), made), edits)


RECORDINGS = st.builds(_recording, PLACES, edits, st.just([]) | edits)


def check_recording(content: bytes) -> bool:
    """Read a recording as one, as a run, and the settings that it was made with."""
    try:
        recording = parse_recording(content, "r.mcap")
    except UserError as error:
        told_well(Path("r.mcap"), error)
        return False
    read = False
    for use in (recording.to_run, lambda: settings_of(recording)):
        try:
            use()
            read = True
        except UserError as error:
            told_well(Path("r.mcap"), error)
    return read


def check_salvage(content: bytes) -> bool:
    """What is salvaged makes a sound recording of the same messages."""
    path = scratch() / "damaged.mcap"
    path.write_bytes(content)
    try:
        found = recover(path, None)
    except UserError as error:
        told_well(path, error)
        return False
    again = parse_recording(sound_file(found), "r.mcap")
    require(len(again.order) == len(found.messages), f"{len(again.order)} of {len(found.messages)} messages")
    require(all(not note.startswith("recording is") for note in again.notes), f"notes {again.notes}")
    return True


FAULT = sound_files.fault()
STRANGE: tuple[Any, ...] = (None, True, -1, 1 << 70, 1e308, 0.5, "x", "\x1b[2J", [], [[]], {}, {"a": 1})


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Return every container with each of its keys."""
    keys = range(len(value)) if isinstance(value, list) else value if isinstance(value, dict) else ()
    return [place for key in keys for place in ((value, key), *_places(value[key]))]


def strange_fault(places: list[tuple[int, Any]]) -> bytes:
    """Put strange values in places of a `fault.json`."""
    content = json.loads(FAULT)
    for at, strange in places:
        found = _places(content)
        container, key = found[at % len(found)]
        container[key] = strange
    return json.dumps(content).encode()


def check_fault(content: bytes) -> bool:
    """The last second before a fault is told in lines, or refused."""
    path = scratch() / "fault.json"
    path.write_bytes(content)
    try:
        lines = list(text_of(story_of(read_evidence(path))))
    except UserError as error:
        told_well(path, error)
        return False
    require(all(line.isprintable() for line in lines), "a line that steers the terminal")
    return True


# --- YAML, JSON -------------------------------------------------------------------------------------------------------


def check_rig(content: bytes) -> bool:
    """A rig, or the problems of it."""
    path = scratch() / "rig.yaml"
    path.write_bytes(content)
    try:
        load_rig(path)
    except UserError as error:
        told_well(path, error)
        return False
    return True


def check_json(content: bytes) -> bool:
    """What is read is what Python reads, and holds neither NaN nor infinity; all else is refused as a ValueError."""
    text = content.decode("utf-8", errors="replace")
    try:
        value = parse_json(text)
    except ValueError:
        return False
    require(value == json.loads(text), "another value than Python's")
    require(json.loads(json.dumps(value, allow_nan=False)) == value, "a value that JSON doesn't have")
    return True


rig_yaml: st.SearchStrategy[bytes] = st.builds(
    lambda at, made: edited(edited_lines(sound_files.RIG.splitlines(keepends=True), at), made), edits, edits
)

MAP = b"time_s: 'Zeit:ms'\ntheta_m_rad: 'Position [deg]:deg'\ncurrent_A: none\n"


def check_map(content: bytes) -> bool:
    """A mapping, or the problems of it; and a table read by it."""
    path = scratch() / "map.yaml"
    path.write_bytes(content)
    try:
        mapping = load_map(path)
    except UserError as error:
        told_well(path, error)
        return False
    table = scratch() / "mapped.csv"
    table.write_text("Zeit;Position [deg];current_A\n0;1;2\n1;2;3\n2;3;5\n")
    try:
        read_run(table, mapping=mapping)
    except UserError as error:
        require(all(problem.isprintable() and len(problem) < 2000 for problem in error.problems), f"{error.problems}")
    return True


map_yaml: st.SearchStrategy[bytes] = st.builds(
    lambda at, made: edited(edited_lines(MAP.splitlines(keepends=True), at), made), edits, edits
)

FUZZERS: Mapping[str, Fuzzer] = {
    "log": Fuzzer(text_logs(".log"), check_log(".log")),
    "asc": Fuzzer(text_logs(".asc"), check_log(".asc")),
    "trc": Fuzzer(text_logs(".trc"), check_log(".trc")),
    "blf": Fuzzer(BLF, check_log(".blf")),
    "cut_log": Fuzzer(st.builds(lambda n, c: Cut(n, *c), st.sampled_from(sorted(LOGS)), cuts), check_cut_log),
    "cut_csv": Fuzzer(st.builds(lambda c: Cut("a.csv", *c), cuts), check_cut_csv),
    "csv": Fuzzer(
        st.builds(
            lambda at, made: edited(edited_lines(TABLES["a.csv"].splitlines(keepends=True), at), made), edits, edits
        ),
        check_file("fuzz.csv"),
    ),
    "layouts": Fuzzer(
        st.builds(_layout, st.sampled_from(LAYOUTS), edits, edits, st.just("plain"), st.just([])), check_file("l.csv")
    ),
    "packed": Fuzzer(
        st.builds(
            _layout,
            st.sampled_from(LAYOUTS),
            edits,
            st.just([]),
            st.sampled_from(["gz", "zst"]),
            st.just([]) | edits,
        ),
        check_file("l.csv.gz"),
    ),
    "map": Fuzzer(map_yaml, check_map),
    "excel": Fuzzer(st.builds(_book, PLACES, edits, st.just([]) | edits), check_container("fuzz.xlsx")),
    "hdf5": Fuzzer(_of_container("a.h5"), check_container("fuzz.h5")),
    **({"mf4": Fuzzer(_of_container("a.mf4"), check_container("fuzz.mf4"))} if find_spec("asammdf") else {}),
    "parquet": Fuzzer(_of(TABLES["a.parquet"]) | _of(TABLES["b.parquet"]), check_file("fuzz.parquet")),
    "zip": Fuzzer(_of(TABLES["a.zip"]), check_file("fuzz.zip")),
    "surgical": Fuzzer(_of(sound_files.SURGICAL), check_file("fuzz.txt")),
    "epos": Fuzzer(_of(sound_files.EPOS), check_file("epos.csv")),
    "mat": Fuzzer(
        _of(MAT)
        | _of(STRUCTURE)
        | _of(STRUCTURE).map(sound_files.packed_mat)
        | _of(MAT).map(sound_files.packed_mat)
        | _of(sound_files.packed_mat(MAT)),
        check_file("fuzz.mat"),
    ),
    "mcap": Fuzzer(RECORDINGS, check_recording),
    "salvage": Fuzzer(RECORDINGS, check_salvage),
    "fault": Fuzzer(
        _of(FAULT) | st.lists(st.tuples(PLACES, st.sampled_from(STRANGE)), min_size=1, max_size=3).map(strange_fault),
        check_fault,
    ),
    "rig": Fuzzer(rig_yaml, check_rig),
    "json": Fuzzer(_of(sound_files.JSON), check_json),
    "any": Fuzzer(
        st.tuples(
            st.sampled_from([".csv", ".txt", ".log", ".asc", ".trc", ".blf", ".mat", ".mcap", ""]),
            st.lists(st.sampled_from(WORDS) | st.binary(max_size=30), max_size=12).map(b"".join),
        ),
        lambda drawn: check_file(f"any{drawn[0]}")(drawn[1]),
    ),
}
