"""What pip-audit's JSON says, in lines, and with which exit code."""

import json
from pathlib import Path
from typing import Any

import pytest

from tools.release import audit_answer

# As pip-audit 2.10 writes it.
SOUND = {"name": "numpy", "version": "2.4.6", "vulns": []}
KNOWN = {
    "name": "jinja2",
    "version": "3.1.2",
    "vulns": [{"id": "PYSEC-2024-1", "fix_versions": ["3.1.3"], "aliases": ["CVE-2024-22195"], "description": "x"}],
}
SKIPPED = {"name": "thing", "skip_reason": "not found on PyPI"}


def told(path: Path, content: Any, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    code = audit_answer.main(str(path))
    return code, *capsys.readouterr()


def test_nothing_known_is_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = told(tmp_path / "a", {"dependencies": [SOUND], "fixes": []}, capsys)
    assert (code, out, err) == (0, "audit: 1 packages looked up, 0 known vulnerabilities\n", "")


def test_what_is_known_is_listed_with_the_version_that_mends_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = told(tmp_path / "a", {"dependencies": [SOUND, KNOWN]}, capsys)
    assert code == 1
    assert "jinja2 3.1.2: PYSEC-2024-1 (CVE-2024-22195); mended in 3.1.3\n" in out


@pytest.mark.parametrize("content", ["", "{", "[]", "{}", '{"dependencies": 3}', '{"dependencies": []}'])
def test_what_is_no_answer_is_not_well(content: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = told(tmp_path / "a", content, capsys)
    assert code == 2
    assert err.startswith("audit: ")


def test_what_was_not_looked_up_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = told(tmp_path / "a", {"dependencies": [SOUND, SKIPPED]}, capsys)
    assert (code, err) == (2, "audit: 1 packages could not be looked up: not found on PyPI\n")
