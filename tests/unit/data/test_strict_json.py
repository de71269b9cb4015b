"""JSON from outside: what RFC 8259 allows is read as Python reads it, all else is refused in words."""

import json

import pytest

from hil_forceps.data.strict_json import MAX_DEPTH, parse_json


@pytest.mark.parametrize(
    "text", ["{}", "[]", "1.5e3", '{"a": [1, {"b": "[[[{{{\\\\"}], "c": null}', "true", '"\\u00e4"']
)
def test_json_is_read(text: str) -> None:
    assert parse_json(text) == json.loads(text)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"a": NaN}', "NaN is no number of JSON"),
        ("[-Infinity]", "-Infinity is no number of JSON"),
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "key 'c' is there twice"),
        ("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1), "nested deeper than 64 levels"),
        ('{"a":' * 100_000, "nested deeper than 64 levels"),
        ("{'a': 1}", "line 1 column 2"),
        ("", "line 1 column 1"),
        ("9" * 5000, "digits"),
        ("[1, 2", "line 1 column 6"),
    ],
)
def test_what_is_no_json_is_refused(text: str, told: str) -> None:
    with pytest.raises(ValueError, match=told.replace("(", r"\(")):
        parse_json(text)


def test_as_deep_as_it_may_be() -> None:
    assert parse_json("[" * MAX_DEPTH + "]" * MAX_DEPTH) == json.loads("[" * MAX_DEPTH + "]" * MAX_DEPTH)
