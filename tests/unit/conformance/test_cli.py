"""`hil-forceps conformance` and the pytest plugin, against the simulated drive in virtual time."""

import json
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from hil_forceps.cli.main import main

ROOT = Path(__file__).parents[3]
LINE = ["--interface", "virtual_forceps", "--channel", "conformance", "--option", "simulation=0"]
RIG = f"rig={ROOT / 'configs' / 'paper.yaml'}"


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["conformance", *arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.mark.parametrize("fd", [False, True])
def test_the_simulated_drive_conforms(fd: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mode = ["--fd"] if fd else []
    assert run(*LINE, "--option", RIG, *mode, "--allow-motion", "--out", str(tmp_path)) == 0
    said = capsys.readouterr().out
    assert said.splitlines()[-1] == ("82 pass, 33 not run" if fd else "77 pass, 38 not run")
    written = json.loads((tmp_path / "certificate.json").read_text(encoding="utf-8"))
    assert written["device"]["fd"] is fd
    assert "issued" not in written
    assert ET.parse(tmp_path / "junit.xml").getroot().get("failures") == "0"


def test_without_motion_and_only(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*LINE, "--option", RIG, "--only", "HFP-092", "--only", "hfp-150") == 0
    assert run(*LINE, "--option", RIG, "--only", "HFP-120") == 1
    assert run(*LINE, "--option", RIG, "--only", "HFP-160") == 1
    said = capsys.readouterr().out
    assert "wants --allow-motion" in said
    assert "speaks of serial lines: HFP-160" in said


def test_list_needs_no_drive(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--list") == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 115
    assert "HFP-120 MUST   watchdog timeout: WATCHDOG [motion]" in lines


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give either a CAN interface and its channel"),
        (
            [*LINE, "--option", RIG, "--only", "HFP-999", "--only", "x"],
            "--only x: unknown requirement; --list shows all",
        ),
        ([*LINE, "--option", RIG, "--node", "31"], "--node 31: must be 1 to 30"),
        ([*LINE, "--option", RIG, "--node", "7"], "node 7: can't be tested"),
        ([*LINE, "--option", RIG, "--line-ms", "0"], "--line-ms 0.0: must be above 0"),
        ([*LINE, "--option", RIG, "--flood-s", "-1"], "--flood-s -1.0: must be above 0"),
        ([*LINE, "--option", "rig"], "--option rig: must be KEY=VALUE"),
        (["--serial", "/no/such/port"], "/no/such/port: can't be opened"),
    ],
)
def test_user_errors(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*arguments) == 2
    assert words in capsys.readouterr().err


def test_plugin(tmp_path: Path) -> None:
    options = ["--hfp-interface", "virtual_forceps", "--hfp-channel", "plugin", "--hfp-option", "simulation=0"]
    options += ["--hfp-option", RIG, "--hfp-out", str(tmp_path / "out"), "-k", "HFP-09 or HFP-16", "-rs"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "5 passed, 11 skipped" in done.stdout or "4 passed" in done.stdout, done.stdout
    assert (tmp_path / "out" / "certificate.json").is_file()
