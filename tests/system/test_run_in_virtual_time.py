"""`run` over the bus in virtual time, as a process; and what goes with a clock alone."""

import json
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording

pytestmark = pytest.mark.slow

PAPER = Path(__file__).resolve().parents[2] / "configs" / "paper.yaml"


def test_run_in_virtual_time_by_the_command_line(start: Any, tmp_path: Path) -> None:
    ended = start(
        "run", "--rig", PAPER, "--out", tmp_path / "out", "--interface", "virtual_forceps", "--channel", "any",
        "--option", f"rig={PAPER}", "--duration", "1.5", "--bus-log", "blf",
    ).end()  # fmt: skip
    assert (ended.code, ended.err) == (0, "")
    recording = read_recording(tmp_path / "out" / "run.mcap")
    assert (recording.notes, recording.result["reason"]) == ((), "completed")
    assert len(recording.samples) > 1000
    result = json.loads((tmp_path / "out" / "run.json").read_text())
    assert result["counters"]["service"]["overruns"] == 0
    decoded = start("decode", tmp_path / "out" / "bus.blf", "--form", "csv").end()
    assert (decoded.code, decoded.err) == (0, "")
    assert decoded.out.count(",Feedback,theta_m_rad,") >= len(recording.samples)


def test_live_in_virtual_time_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def refused(*arguments: object) -> str:
        with pytest.raises(SystemExit) as ended:
            cli.main([*map(str, arguments), "--out", str(tmp_path / "out")])
        assert ended.value.code == 2
        return capsys.readouterr().err

    virtual = ("run", "--rig", PAPER, "--interface", "virtual_forceps", "--option", f"rig={PAPER}")
    for option in (("--live",), ("--references", "0")):
        assert f"{option[0]}: virtual_forceps runs in virtual time" in refused(*virtual, *option)
    assert (
        refused(*virtual, "--live-control")
        == "hil-forceps: --live-control: only with --live; add it, or leave --live-control out\n"
    )
    assert "--live: only with --realtime" in refused("bench", "--config", PAPER, "--live")
