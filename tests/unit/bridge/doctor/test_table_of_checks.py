"""docs/doctor.md has every check that there is, and no other."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[4]
ID = r"(?:machine|disk|timing|can|serial|udp|line|drive)\.[a-z_]+"


def test_the_table_has_all_checks() -> None:
    code = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "hil_forceps/bridge/doctor").glob("*.py"))
    made = set(re.findall(rf'"({ID})"', code))
    table = (ROOT / "docs/doctor.md").read_text(encoding="utf-8").split("## What is sent")[0]
    heads = [row.split(" | ")[0] for row in table.splitlines() if row.startswith("| `")]
    told = {name for head in heads for name in re.findall(rf"`({ID})`", head)}
    assert made == told
    assert len(made) > 30
