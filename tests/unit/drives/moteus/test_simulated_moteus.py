"""The whole way: service, bus in virtual time, simulated moteus, forceps; and what goes wrong with real ones."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from tests.unit.drives.moteus.simulated import MS, RIG, RIG_FILE
from virtual_bus.drives.moteus import POSITION, STOPPED, TIMEOUT, SimulatedMoteus
from virtual_bus.drives.registry import SIMULATED_DRIVES

NOTHING_LOST = ("bad_reply", "no_value", "stale", "restarts", "not_increasing", "not_for_us", "samples_overflow")


def run(tmp_path: Path, rig: str | Path = RIG_FILE, *more: str) -> tuple[int, dict[str, Any]]:
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "3", "--out", str(tmp_path / "out"), *more])
    return int(ended.value.code or 0), json.loads((tmp_path / "out" / "run.json").read_text())


def changed(tmp_path: Path, old: str, new: str) -> Path:
    text = RIG_FILE.read_text()
    assert old in text
    path = tmp_path / "rig.yaml"
    path.write_text(text.replace(old, new))
    return path


def line_of(capsys: pytest.CaptureFixture[str]) -> str:
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hil-forceps:")]
    return line


def peer_that(monkeypatch: pytest.MonkeyPatch, at_ns: int, does: Callable[[SimulatedMoteus, int], None]) -> None:
    """Have something happen to the peer at one time of the bus."""
    loop = SimulatedMoteus._loop

    def watched(self: SimulatedMoteus, now_ns: int) -> None:
        if now_ns == at_ns:
            does(self, now_ns)
        loop(self, now_ns)

    monkeypatch.setattr(SimulatedMoteus, "_loop", watched)


@pytest.mark.parametrize(("ratio", "node"), [("1.0", "5"), ("-3.0", "5"), ("1.0", "8")])
def test_a_run_is_completed_with_nothing_lost(tmp_path: Path, ratio: str, node: str) -> None:
    rig = changed(tmp_path, "pulley_rev: 1.0 ", f"pulley_rev: {ratio} ")
    rig.write_text(rig.read_text().replace("node_id: 5 ", f"node_id: {node} "))  # from 8 on answers have 29 bits
    code, result = run(tmp_path, rig)
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host, service = result["counters"]["host"], result["counters"]["service"]
    assert host["samples"] > 3000
    assert not any(host[name] for name in NOTHING_LOST)
    assert service["frames_sent"] - service["frames_received"] <= 1  # the last answer, if nobody waits for it
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out" / "run.mcap")])
    assert not ended.value.code
    recording = read_recording(tmp_path / "out" / "run.mcap")
    reference, angle = recording.references["passed_rad"][2500:], recording.samples["theta_m_rad"][2500:]
    assert abs(float(np.nanmean(reference)) - float(np.mean(angle))) < 0.02


def test_stamps_lie_between_the_request_and_what_came_back(tmp_path: Path) -> None:
    run(tmp_path)
    samples = read_recording(tmp_path / "out" / "run.mcap").samples
    late_ns = samples["received_ns"] - samples["stamp_ns"]
    assert late_ns.min() > 0
    assert late_ns.max() < 0.5 * RIG.bench.host_period_s * 1e9


def test_a_service_that_enables_it_moves_nothing(tmp_path: Path) -> None:
    run(tmp_path)
    recording = read_recording(tmp_path / "out" / "run.mcap")
    enabling = recording.samples["state"] != 2
    enabling[np.flatnonzero(~enabling)[0] :] = False
    assert np.count_nonzero(enabling) > 5
    assert float(np.ptp(recording.samples["theta_m_rad"][enabling])) < 2e-3


def test_another_register_map_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def older(*arguments: Any, **keywords: Any) -> SimulatedMoteus:
        return SimulatedMoteus(*arguments, **keywords, register_map=4)

    monkeypatch.setitem(SIMULATED_DRIVES, "moteus", older)
    code, result = run(tmp_path)
    assert code == 2
    assert result["counters"]["service"]["references_sent"] == 0
    line = line_of(capsys)
    assert "node 5 has register map version 4" in line
    assert "moteus_tool --flash" in line


def test_another_node_id_is_no_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = changed(tmp_path, "node_id: 5", "node_id: 6")
    arguments = ["run", "--rig", str(other), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={RIG_FILE}", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "no drive answered: no frame was received" in line_of(capsys)


@pytest.mark.parametrize(
    ("does", "reason", "said"),
    [
        (lambda peer, now_ns: peer.reboot(now_ns), "drive_lost", "sent no more samples or restarted"),
        (lambda peer, _: peer.fail(33), "drive_fault", "fault 33 (motor driver fault"),
        (lambda peer, _: setattr(peer, "mode", TIMEOUT), "drive_fault", "watchdog expired (mode 11)"),
        (
            lambda peer, _: setattr(peer, "mode", STOPPED),
            "drive_stopped",
            "left the operational state without a request",
        ),
        (lambda peer, _: setattr(peer, "node", 99), "drive_lost", "sent no more samples or restarted"),
    ],
)
def test_what_happens_while_running_ends_the_run_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    does: Callable[[SimulatedMoteus, int], None],
    reason: str,
    said: str,
) -> None:
    seen: list[SimulatedMoteus] = []

    def happens(peer: SimulatedMoteus, now_ns: int) -> None:
        seen.append(peer)
        does(peer, now_ns)

    peer_that(monkeypatch, 1_500 * MS, happens)
    code, result = run(tmp_path)
    assert (code, result["reason"]) == (2, reason)
    assert said in line_of(capsys)
    assert len(read_recording(tmp_path / "out" / "run.mcap").samples["stamp_ns"]) > 1400
    assert seen[0].mode != POSITION  # nothing that was on its way has enabled it again


def test_an_encoder_that_fails_ends_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    peer_that(monkeypatch, 1_500 * MS, lambda peer, _: setattr(peer, "has_position", False))
    code, result = run(tmp_path)
    assert code == 2
    assert result["counters"]["host"]["no_value"] > 10
    assert "the drive sent no more samples" in line_of(capsys)


def test_lost_answers_do_not_end_in_silence_on_both_sides(tmp_path: Path) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text("- {fault: drop, direction: to_host, probability: 0.05}\n")
    code, result = run(tmp_path, RIG_FILE, "--option", f"faults={faults}")
    assert (code, result["reason"]) == (0, "completed")
    host, service = result["counters"]["host"], result["counters"]["service"]
    assert 2500 < host["samples"] < 3000
    assert service["frames_sent"] > service["references_sent"] + 100  # queries in place of references


def test_a_fault_from_before_is_told_and_cleared_on_request(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    peer_that(monkeypatch, 0, lambda peer, _: setattr(peer, "mode", TIMEOUT))
    code, result = run(tmp_path)
    assert (code, result["reason"]) == (2, "drive_fault")
    assert "the drive has a latched fault: watchdog expired (mode 11)" in line_of(capsys)
    code, result = run(tmp_path, RIG_FILE, "--reset-fault", "--overwrite")
    assert (code, result["reason"]) == (0, "completed")


def test_a_classic_bus_is_a_problem(tmp_path: Path) -> None:
    rig = changed(tmp_path, "transport: fd", "transport: classic")
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(rig)])
    assert ended.value.code == 1
