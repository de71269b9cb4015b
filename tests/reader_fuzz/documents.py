"""Rigs, mappings and JSON for the fuzzers: damaged, and the checks of what comes out."""

import json

from hypothesis import strategies as st

from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.readers.tables.mapping import load_map
from hil_forceps.data.strict_json import parse_json
from hil_forceps.rig import load_rig
from hil_forceps.rig.errors import UserError
from tests.reader_fuzz import sound_files
from tests.reader_fuzz.checks import require, scratch, told_well
from tests.reader_fuzz.damage import edited, edited_lines, edits


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
