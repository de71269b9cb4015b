"""A problem in a rig file before it becomes a line of text, and how values and keys are shown in such lines."""

import difflib
import math
import re
from collections.abc import Iterable
from typing import NamedTuple

from pydantic_core import PydanticCustomError

Path = tuple[str | int, ...]

SHOWN_CHARACTERS = 60
PROBLEMS_ERROR = "rig_problems"
_NUMBER_AND_MORE = re.compile(r"[-+]?\.?[0-9][0-9.]*(e[-+]?[0-9]+)?\s*[A-Za-zµ]")
_PLAIN_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,79}")


class Problem(NamedTuple):
    """What is wrong with the value or key at `path`; `text` holds the remedy after a semicolon."""

    path: Path
    text: str


def problems_error(problems: Iterable[Problem]) -> PydanticCustomError:
    """Pack several problems, with paths relative to the validated value, into one error for pydantic to raise."""
    return PydanticCustomError(PROBLEMS_ERROR, "several problems", {"problems": tuple(problems)})


def text_error(text: str) -> PydanticCustomError:
    """Pack what is wrong, in our words, into an error for pydantic to raise."""
    return PydanticCustomError("rig_problem", "{text}", {"text": text})


def show_value(value: object) -> str:
    """Show a value from a file: one line, printable, bounded, in the file's own words where they differ from ours."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "empty"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, float) and not math.isfinite(value):
        return {"inf": ".inf", "-inf": "-.inf"}.get(str(value), ".nan")
    shown = show_number(value) if isinstance(value, int | float) else repr(value)
    return shown if len(shown) <= SHOWN_CHARACTERS else shown[: SHOWN_CHARACTERS - 3] + "..."


def show_number(number: float) -> str:
    """Show a number as a person would write it: 1000, 0.0014, 4.62e-09."""
    return str(number) if isinstance(number, int) else f"{number:.12g}"


def remedy_for_text(given: object) -> str:
    """Say what to do about a value that should be a number, when it is text that nearly is one."""
    if not isinstance(given, str):
        return "correct it"
    text = given[:SHOWN_CHARACTERS].strip()
    for candidate in (text, text.replace(",", ".")):
        try:
            number = float(candidate)
        except ValueError:
            continue
        return (
            f"write {show_number(number)}, without quotes, commas and underscores"
            if math.isfinite(number)
            else "correct it"
        )
    return "write the bare number, in the unit of the key" if _NUMBER_AND_MORE.match(text) else "correct it"


def show_path(path: Path) -> str:
    """Write a path as `bench.algorithms[2]`; keys that aren't plain names are quoted."""
    parts: list[str] = []
    for step in path:
        if isinstance(step, int):
            parts.append(f"[{step}]")
        else:
            parts.append(("." if parts else "") + (step if _PLAIN_KEY.fullmatch(step) else show_value(step)))
    return "".join(parts)


def nearest(given: str, known: Iterable[str]) -> str | None:
    """Return the known name that a given one is most likely a slip of, if any is near."""
    by_lower = {name.lower(): name for name in known}
    found = difflib.get_close_matches(given[:SHOWN_CHARACTERS].lower(), by_lower, n=1, cutoff=0.7)
    return by_lower[found[0]] if found else None
