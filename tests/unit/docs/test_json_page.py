"""docs/json.md names the keys that are there, and no others."""

import re
from pathlib import Path

from hil_forceps.diagnosis.result import Diagnosis, to_json
from hil_forceps.drift.result import Trend
from hil_forceps.drift.result import to_json as trend_json

PAGE = (Path(__file__).parents[3] / "docs" / "json.md").read_text(encoding="utf-8")


def keys_told(heading: str, page: str = PAGE) -> set[str]:
    """Return the keys in the tables below a heading."""
    section = re.split(rf"^## {re.escape(heading)}$", page, flags=re.MULTILINE)[1].split("\n## ")[0]
    rows = (line.split(" | ")[0] for line in section.splitlines() if line.startswith("| `"))
    return {key for row in rows for key in re.findall(r"`(\w+)`", row)}


def test_diagnosis() -> None:
    assert keys_told("diagnosis.json") == set(to_json(Diagnosis("consistent", "nothing")))


def test_trend() -> None:
    assert keys_told("trend.json") == set(trend_json(Trend((), (), 0.05)))


def test_tables_are_read() -> None:
    assert keys_told("a", "## a\n| key | x |\n|---|---|\n| `b`, `c_s` | `d` |\n## e\n| `f` | |\n") == {"b", "c_s"}
