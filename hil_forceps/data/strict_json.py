"""JSON from outside, as RFC 8259 has it: no NaN, no key twice, no nesting without end."""

import json
from typing import Any

MAX_CHARACTERS = 1 << 26
MAX_DEPTH = 64


def parse_json(text: str) -> Any:
    """Return the value; ValueError, with line and column where there are, for whatever is not strictly JSON."""
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"{len(text)} characters are more than {MAX_CHARACTERS}")
    _check_depth(text)
    return json.loads(text, parse_constant=_no_constant, object_pairs_hook=_no_repeats)


def _check_depth(text: str) -> None:
    """Refuse deep nesting before the parser recurses into it; brackets inside of strings don't count."""
    depth = 0
    is_text = False
    escaped = False
    for character in text:
        if is_text:
            is_text = escaped or character != '"'
            escaped = character == "\\" and not escaped
        elif character == '"':
            is_text = True
        elif character in "[{":
            depth += 1
            if depth > MAX_DEPTH:
                raise ValueError(f"nested deeper than {MAX_DEPTH} levels")
        elif character in "]}":
            depth -= 1


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _no_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"key {twice[:40]!r} is there twice")
    return found
