"""Tables and containers for the fuzzers: damaged, or cut anywhere, and the checks of what comes out."""

from collections.abc import Callable

from hypothesis import strategies as st

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_files
from tests.reader_fuzz.checks import DEFLATE_RATIO, Cut, require, runs_are_sound, scratch, told_well
from tests.reader_fuzz.damage import Edit, edited, edited_lines, edits


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


TABLES = sound_files.tables()
MAT = sound_files.mat()
STRUCTURE = sound_files.mat_structure()
LAYOUTS = sound_files.layouts()


def check_file(name: str) -> Callable[[bytes], bool]:
    """Return the check of a file that `read_run` reads; rows may be packed, a number of a thousandth of a byte each."""
    rig = load_rig(sound_files.ROOT / "configs" / "epos_screw.yaml")

    def check(content: bytes) -> bool:
        path = scratch() / name
        path.write_bytes(content)
        return runs_are_sound(path, lambda: read_run(path, rig=rig), (len(content) + 1) * DEFLATE_RATIO)

    return check


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
    return edited(sound_files.zipped(parts | {at: edited(parts[at], inside)}), outside)


def _of_container(name: str) -> st.SearchStrategy[bytes]:
    return st.builds(lambda made: edited(sound_files.container(name), made), edits)
