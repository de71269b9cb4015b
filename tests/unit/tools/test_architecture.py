"""The page on the architecture is drawn from the import contracts, and what it names is there."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_page_is_up_to_date() -> None:
    command = [sys.executable, str(ROOT / "tools" / "documents" / "architecture_doc.py"), "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_file_that_the_page_names_is_there() -> None:
    named = re.findall(r"`([a-z_]+/[a-z_/]+(?:\.py)?)`", PAGE)
    assert len(named) > 40
    missing = [name for name in named if not any((root / name).exists() for root in (ROOT, ROOT / "hil_forceps"))]
    assert not missing
