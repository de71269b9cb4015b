"""The page on the rig file is the schema's."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_page_is_up_to_date() -> None:
    command = [sys.executable, str(ROOT / "tools" / "documents" / "rig_file_doc.py"), "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
