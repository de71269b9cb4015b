"""Bus logs for the fuzzers: damaged lines and objects, a log cut anywhere, and the checks of what comes out."""

from collections.abc import Callable
from pathlib import Path

from hypothesis import strategies as st

from hil_forceps.data.readers.bus_logs.account import Account, LoggedFrame
from hil_forceps.data.readers.bus_logs.frames import read_frames
from hil_forceps.data.readers.bus_logs.run import read_bus_log
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_logs
from tests.reader_fuzz.checks import DEFLATE_RATIO, Cut, require, runs_are_sound, scratch, told_well
from tests.reader_fuzz.damage import Edit, edited, edited_lines, edits

BLF_FRAME_BYTES = 16 + 16 + 16  # heads and data of the smallest


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
        require("-td" in str(error) or "it contains no frame" in str(error), f"refused: {error}")
        return False
    require(part == frames[: len(part)], f"cut at {where}: other frames than before the cut")
    others = whole.count(b"\n") - len(frames)  # lines of a head and of events
    require(len(part) >= whole[:where].count(b"\n") - others, f"cut at {where}: {len(part)} frames are too few")
    torn = cut.zeros > 0 or (where > 0 and not whole[:where].endswith(b"\n") and whole[:where].split(b"\n")[-1].strip())
    said = bool(read.unreadable or read.damage)
    require(said or not torn, f"cut at {where}, {cut.zeros} zeros: not a word")
    return True
