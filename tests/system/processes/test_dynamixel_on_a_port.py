"""A simulated servo as a process behind a pseudo terminal, `scan` and `run` against it, in real time.

A machine that stalls may end a run (the gate closes after 20 ms), so what is asserted is what holds however it ends.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_forceps.cli import main as cli

pytestmark = [pytest.mark.realtime, pytest.mark.alone, pytest.mark.slow]

RIG = Path(__file__).resolve().parents[3] / "configs" / "drives" / "dynamixel.yaml"


@pytest.fixture
def servo(tmp_path: Path) -> Iterator[tuple[str, "subprocess.Popen[str]"]]:
    port = str(tmp_path / "port")
    process = subprocess.Popen(
        [sys.executable, "-m", "virtual_bus", "--rig", str(RIG), "--serial-pty", port],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline().startswith(f"ready serial {port}")
    yield port, process
    process.terminate()
    process.wait(30.0)
    process.stdout.close()


def test_it_is_found_and_driven(
    servo: tuple[str, "subprocess.Popen[str]"], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    port, process = servo
    with pytest.raises(SystemExit) as ended:
        cli.main(["scan", "--serial", port, "--ask", "dynamixel", "--seconds", "1"])
    assert ended.value.code == 0
    assert "XM430-W350, firmware 45" in capsys.readouterr().out
    arguments = ["--rig", str(RIG), "--serial", port, "--duration", "2", "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit):
        cli.main(["run", *arguments])
    result = json.loads((tmp_path / "out" / "run.json").read_text())
    assert result["drive_disabled"]
    host, link = result["counters"]["host"], result["counters"]["link"]
    assert host["setpoints_sent"] > 0
    assert host["samples"] > 0
    assert not any(host[name] for name in ("restarts", "bad_length", "not_for_us", "echoes"))
    assert not any(link.values())
    process.terminate()
    assert process.stdout is not None
    summary = json.loads(process.stdout.readline())
    assert summary["transport"] == {"bad_crc": 0, "bad_length": 0, "unread": 0}
    assert summary["drive"]["not_understood"] == 0
    assert summary["drive"]["watchdog_trips"] == 0 or result["reason"] != "completed"
