"""One fuzzer a reader: a strategy for its input, and what must hold of what comes out (`checks`).

What a whole file says of its beginning, the file cut anywhere says, too (`cut_*`).
"""

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any, NamedTuple

from hypothesis import strategies as st

from tests.reader_fuzz import sound_files
from tests.reader_fuzz.checks import PLACES, Cut
from tests.reader_fuzz.damage import WORDS, edited, edited_lines, edits
from tests.reader_fuzz.documents import check_json, check_map, check_rig, map_yaml, rig_yaml
from tests.reader_fuzz.logs import BLF, LOGS, check_cut_log, check_log, text_logs
from tests.reader_fuzz.recordings import (
    FAULT,
    RECORDINGS,
    STRANGE,
    check_fault,
    check_recording,
    check_salvage,
    strange_fault,
)
from tests.reader_fuzz.tables import (
    LAYOUTS,
    MAT,
    STRUCTURE,
    TABLES,
    _book,
    _layout,
    _of_container,
    check_container,
    check_cut_csv,
    check_file,
)


class Fuzzer(NamedTuple):
    """Inputs, and the check that every one of them has to pass; it returns whether the input was read."""

    inputs: st.SearchStrategy[Any]
    check: Callable[[Any], bool]


cuts: st.SearchStrategy[tuple[int, int]] = st.tuples(PLACES, st.sampled_from([0, 0, 1, 600, 9000]))


def _of(sound: bytes) -> st.SearchStrategy[bytes]:
    return st.builds(edited, st.just(sound), edits)


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
