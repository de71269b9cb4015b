"""The suite, unchanged, against the drive as a process: over a pseudo terminal and over UDP multicast, in real time.

A machine that is busy may keep a check from telling, so what is asserted is that nothing fails and that most passes.
"""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

ROOT = Path(__file__).resolve().parents[2]
RIG = ROOT / "configs" / "paper.yaml"
GROUP = "239.74.163.79"
ENVIRONMENT = {**os.environ, "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}"}


@contextmanager
def drive(*arguments: str) -> Iterator[None]:
    command = [sys.executable, "-m", "virtual_bus", "--rig", str(RIG), "--simulation", "0", *arguments]
    with subprocess.Popen(command, cwd=ROOT, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline().startswith("ready ")
            yield
        finally:
            process.terminate()
            process.communicate(timeout=30)


def judge(out: Path, *arguments: str) -> dict[str, Any]:
    command = [sys.executable, "-m", "hil_forceps.cli.main", "conformance", "--out", str(out), *arguments]
    done = subprocess.run(command, cwd=ROOT, env=ENVIRONMENT, capture_output=True, text=True, check=False, timeout=280)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    certificate: dict[str, Any] = json.loads((out / "certificate.json").read_text(encoding="utf-8"))
    return certificate


def check(certificate: dict[str, Any], applicable: int) -> None:
    failed = {row["id"]: row["evidence"] for row in certificate["requirements"] if row["verdict"] == "fail"}
    assert failed == {}
    verdicts = certificate["verdicts"]
    assert verdicts["pass"] + verdicts["inconclusive"] == applicable
    assert verdicts["pass"] >= 0.8 * applicable, [
        (row["id"], row["evidence"]) for row in certificate["requirements"] if row["verdict"] == "inconclusive"
    ]
    assert certificate["time"] == "real"
    assert "issued" in certificate


def test_over_a_pseudo_terminal(tmp_path: Path) -> None:
    link = tmp_path / "port"
    with drive("--serial-pty", str(link)):
        check(judge(tmp_path / "out", "--serial", str(link), "--allow-motion"), 82)


def test_over_udp_multicast_fd(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = f"port={probe.getsockname()[1]}"
    line = ("--interface", "udp_multicast", "--channel", GROUP, "--option", port, "--fd")
    with drive(*line):
        check(judge(tmp_path / "out", *line, "--allow-motion"), 79)
