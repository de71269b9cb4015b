"""The YAML that a rig file may use: scalars of the core schema, places, and what is refused."""

import math

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hil_forceps.rig import parse_rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.yaml_loader import MAX_DEPTH, MAX_FILE_BYTES, Mark, load_document, resolve_plain

# YAML 1.2.2, section 10.3.2 (table of the core schema) and the places where YAML 1.1 reads something else.
CORE_SCALARS: list[tuple[str, object]] = [
    ("null", None),
    ("Null", None),
    ("NULL", None),
    ("~", None),
    ("", None),
    ("nUll", "nUll"),
    ("true", True),
    ("True", True),
    ("FALSE", False),
    ("tRue", "tRue"),
    ("yes", "yes"),
    ("no", "no"),
    ("on", "on"),
    ("Off", "Off"),
    ("y", "y"),
    ("0", 0),
    ("-19", -19),
    ("+7", 7),
    ("012", 12),
    ("0o7", 7),
    ("0o14", 12),
    ("0o8", "0o8"),
    ("-0o7", "-0o7"),
    ("0x3A", 58),
    ("0xff", 255),
    ("0xg", "0xg"),
    ("0b101", "0b101"),
    ("1_000", "1_000"),
    ("190:20:30", "190:20:30"),
    ("0.", 0.0),
    ("-0.0", -0.0),
    (".5", 0.5),
    ("+12e03", 12000.0),
    ("-2E+05", -200000.0),
    ("1e-3", 1e-3),
    ("1e3", 1000.0),
    ("2.6e4", 26000.0),
    ("6.8523015e+5", 685230.15),
    ("1.e1", 10.0),
    (".e1", ".e1"),
    ("1e", "1e"),
    ("1e1.5", "1e1.5"),
    ("+", "+"),
    ("-", "-"),
    (".", "."),
    (".inf", math.inf),
    ("-.Inf", -math.inf),
    ("+.INF", math.inf),
    ("inf", "inf"),
    ("nan", "nan"),
    ("2001-12-14", "2001-12-14"),
    ("١٢", "١٢"),  # digits, but not those of the schema
]


@pytest.mark.parametrize(("text", "value"), CORE_SCALARS)
def test_plain_scalar_follows_the_core_schema(text: str, value: object) -> None:
    read = resolve_plain(text)
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize("text", [".nan", ".NaN", ".NAN"])
def test_nan_words(text: str) -> None:
    read = resolve_plain(text)
    assert isinstance(read, float)
    assert math.isnan(read)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_float_comes_back_from_its_repr(number: float) -> None:
    read = resolve_plain(repr(number))
    assert isinstance(read, float)
    assert read == number
    assert math.copysign(1.0, read) == math.copysign(1.0, number)


@given(st.integers(-(10**60), 10**60))
def test_every_integer_comes_back(number: int) -> None:
    assert resolve_plain(str(number)) == number


def test_quoted_and_block_scalars_are_text() -> None:
    data = load_document("a: '1'\nb: \"true\"\nc: |\n  2\nd: >-\n  3\n", "f").data
    assert data == {"a": "1", "b": "true", "c": "2\n", "d": "3"}


def test_places_of_keys_values_and_list_items() -> None:
    document = load_document("a:\n  b: 1\n  c: [2,\n    {d: 3}]\n", "f")
    assert document.data == {"a": {"b": 1, "c": [2, {"d": 3}]}}
    assert document.key_marks[("a",)] == Mark(1, 1)
    assert document.value_marks[("a",)] == Mark(2, 3)
    assert document.key_marks[("a", "b")] == Mark(2, 3)
    assert document.value_marks[("a", "b")] == Mark(2, 6)
    assert document.key_marks[("a", "c", 0)] == Mark(3, 7)
    assert document.key_marks[("a", "c", 1)] == Mark(4, 5)
    assert document.value_marks[("a", "c", 1, "d")] == Mark(4, 9)


def test_first_of_duplicate_keys_is_kept_whatever_the_second_holds() -> None:
    document = load_document("a: 1\na: {b: [1, {c: 2, c: 3}], b: 4}\nd: 5\n", "f")
    assert document.data == {"a": 1, "d": 5}
    assert [(mark.line, problem.path) for mark, problem in document.problems] == [(2, ("a",))]


def test_duplicates_are_found_in_every_mapping() -> None:
    document = load_document("a: {x: 1, x: 2}\nb: [{y: 1, y: 2}]\n'a': 3\n", "f")
    assert document.data == {"a": {"x": 1}, "b": [{"y": 1}]}
    assert {problem.path for _, problem in document.problems} == {("a", "x"), ("b", 0, "y"), ("a",)}


def test_alias_is_refused_and_has_no_value() -> None:
    document = load_document("a: &x {b: 1}\nc: *x\n", "f")
    assert document.data == {"a": {"b": 1}, "c": None}
    assert document.refused == {("c",)}
    assert len(document.problems) == 2


def test_depth_up_to_the_bound_and_one_more() -> None:
    load_document("[" * MAX_DEPTH + "]" * MAX_DEPTH, "f")
    with pytest.raises(UserError, match=r"f:1:9: nested deeper than 8 levels"):
        load_document("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "f")


@pytest.mark.parametrize("opening", ["[", "{a: ", "- ", "? ", "a:\n"])
def test_deep_nesting_is_one_clear_error(opening: str) -> None:
    text = opening * (MAX_FILE_BYTES // len(opening))
    if opening == "a:\n":
        text = "\n".join(" " * depth + "a:" for depth in range(300))
    with pytest.raises(UserError) as caught:
        load_document(text, "f")
    assert len(caught.value.problems) == 1


def test_size_up_to_the_bound_and_one_byte_more() -> None:
    load_document("#" * MAX_FILE_BYTES, "f")
    with pytest.raises(UserError, match=r"f:1:1: 65537 bytes is no rig file"):
        load_document("#" * (MAX_FILE_BYTES + 1), "f")


def test_number_of_problems_is_bounded() -> None:
    with pytest.raises(UserError) as caught:
        load_document("a: 1\n" * 5000, "f")
    assert len(caught.value.problems) == 101
    assert caught.value.problems[-1].endswith("too many problems; the rest isn't read")


def test_number_of_lines_is_bounded() -> None:
    with pytest.raises(UserError) as caught:
        parse_rig("".join(f"key_{index}: 1\n" for index in range(1000)), "f")
    assert len(caught.value.problems) == 101
    assert caught.value.problems[-1] == "f: 903 more problems; correct these first"


def test_byte_order_mark_and_carriage_returns_are_fine() -> None:
    assert load_document("\ufeffa: 1\r\nb: 2\r\n", "f").data == {"a": 1, "b": 2}


def test_yaml_1_2_directive_is_fine() -> None:
    document = load_document("%YAML 1.2\n---\na: 1\n", "f")
    assert (document.data, document.problems) == ({"a": 1}, [])


@pytest.mark.parametrize(
    "text",
    ['"\\UFFFFFFFF"', '"\\U00110000"', f"%YAML {'1' * 5000}.1\n---\n", "%TAG ! tag:x,2000:\n--- !y a", "!<%FF> a"],
)
def test_what_pyyaml_itself_stumbles_over(text: str) -> None:
    try:
        problems = [problem.text for _, problem in load_document(text, "f").problems]
    except UserError as error:
        problems = list(error.problems)
    assert problems


def assert_only_user_errors(text: str) -> None:
    lines: tuple[str, ...] = ("f:",)
    try:
        load_document(text, "f")
    except UserError as error:
        lines = error.problems
    assert lines
    for line in lines:
        assert line.startswith("f:")
        assert "\n" not in line
        line.encode()


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    assert_only_user_errors(text)


@given(st.text(alphabet="ab01.:-?,[]{}#&*!|>'\"%@` \t\n\\~<=_eE+x\ud800\x85\u2028", max_size=80))
def test_any_mess_of_yaml_signs_is_read_or_refused(text: str) -> None:
    assert_only_user_errors(text)


class _NoAliases(yaml.SafeDumper):
    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002
        return True


# Text that only the core schema takes for a number (`1e3`, `0o7`) is left plain by a YAML 1.1 writer.
LETTERS = st.characters(exclude_characters="\x85\u2028\u2029", exclude_categories=["Cs"])
TEXT = st.text(LETTERS, max_size=8).filter(lambda text: isinstance(resolve_plain(text), str))
PLAIN_DATA = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(allow_nan=False) | TEXT,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXT, inner, max_size=3),
    max_leaves=8,
)


@given(PLAIN_DATA, st.booleans())
def test_reads_what_an_independent_writer_wrote(data: object, flow: bool) -> None:
    text = yaml.dump(data, Dumper=_NoAliases, default_flow_style=flow, allow_unicode=True)
    try:
        document = load_document(text, "f")
    except UserError as error:
        if "nested deeper" in str(error):
            return
        raise
    assert document.problems == []
    assert document.data == data
