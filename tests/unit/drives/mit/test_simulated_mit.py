"""The whole way: service, bus in virtual time, simulated mini cheetah drive, forceps; and what goes wrong."""

from pathlib import Path

import numpy as np
import pytest

from firmware_protocol.frames import Frame
from hil_forceps.cli import main as cli
from hil_forceps.data.recording.reader import read_recording
from tests.unit.drives.mit.simulated import MS, RIG_FILE, VARIANTS, run
from virtual_bus.drives.mit import SimulatedMit


def changed(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = RIG_FILE.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    return path


def error_line(capsys: pytest.CaptureFixture[str]) -> str:
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hil-forceps:")]
    return line


@pytest.mark.parametrize("ratio", ["1.0", "-0.5"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_run_is_completed_with_nothing_lost(tmp_path: Path, variant: str, ratio: str) -> None:
    rig = changed(
        tmp_path, ("mit_variant: bgkatz", f"mit_variant: {variant}"), ("pulley_rev: 1.0 ", f"pulley_rev: {ratio} ")
    )
    if variant == "cubemars":
        rig.write_text(rig.read_text().replace("  reply_id: 0\n", ""))
    code, result = run(tmp_path, rig)
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host, service = result["counters"]["host"], result["counters"]["service"]
    assert host["samples"] > 3000
    assert service["frames_received"] >= service["frames_sent"] - (10 if variant == "cubemars" else 0) - 1
    lost = ("repeats", "releases", "unasked", "bad_length", "not_for_us", "wrapped", "at_range_end", "not_increasing")
    assert {name: host[name] for name in lost} == dict.fromkeys(lost, 0)
    with pytest.raises(SystemExit) as ended:
        cli.main(["replay", str(tmp_path / "out" / "run.mcap")])
    assert not ended.value.code
    recording = read_recording(tmp_path / "out" / "run.mcap")
    reference, angle = recording.references["passed_rad"][2500:], recording.samples["theta_m_rad"][2500:]
    assert abs(float(np.nanmean(reference)) - float(np.mean(angle))) < 0.02


def test_enabling_moves_nothing(tmp_path: Path) -> None:
    run(tmp_path)
    samples = read_recording(tmp_path / "out" / "run.mcap").samples
    enabling = samples["state"] != 2
    enabling &= samples["stamp_ns"] < samples["stamp_ns"][0] + 1_000 * MS
    assert np.count_nonzero(enabling) > 10
    assert float(np.ptp(samples["theta_m_rad"][enabling])) < 2e-3


def test_lost_frames_cost_repeats_and_no_silence(tmp_path: Path) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text("- {fault: drop, probability: 0.02}\n")
    code, result = run(tmp_path, RIG_FILE, "--option", f"faults={faults}")
    assert (code, result["reason"], result["drive_disabled"]) == (0, "completed", True)
    host = result["counters"]["host"]
    assert 60 < host["repeats"] < 240  # of 3000 ticks, each with two frames that may be lost
    assert host["samples"] > 2800
    assert host["releases"] < host["repeats"] // 4


def test_a_drive_that_stops_answering_ends_the_run_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = SimulatedMit._loop

    def falls_silent(self: SimulatedMit, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            self.trip()
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedMit, "_loop", falls_silent)
    code, result = run(tmp_path)
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_lost", False)
    assert "did not confirm that it is disabled" in error_line(capsys)
    assert len(read_recording(tmp_path / "out" / "run.mcap").samples["stamp_ns"]) > 1400


def test_a_restart_ends_the_run_as_far_as_it_can_be_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is out for 20 ms, and back without motor mode: what bgkatz's takes at least is 8 ms."""
    receive = SimulatedMit.receive

    def restarts(self: SimulatedMit, frame: Frame, now_ns: int) -> None:
        if 1_500 * MS < now_ns < 1_520 * MS:
            self.reset()
        else:
            receive(self, frame, now_ns)

    monkeypatch.setattr(SimulatedMit, "receive", restarts)
    code, result = run(tmp_path)
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_lost", True)
    assert "sent no more samples or restarted" in error_line(capsys)


def test_a_damiao_that_restarts_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = SimulatedMit._loop

    def resets(self: SimulatedMit, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            self.reset()
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedMit, "_loop", resets)
    code, result = run(tmp_path, changed(tmp_path, ("mit_variant: bgkatz", "mit_variant: damiao")))
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_stopped", True)
    assert "left the operational state without a request" in error_line(capsys)


def test_a_damiaos_fault_is_told_in_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = SimulatedMit._loop

    def overloads(self: SimulatedMit, at_ns: int) -> None:
        if at_ns == 1_500 * MS:
            self.enabled, self.fault = False, 0xE
        loop(self, at_ns)

    monkeypatch.setattr(SimulatedMit, "_loop", overloads)
    code, result = run(tmp_path, changed(tmp_path, ("mit_variant: bgkatz", "mit_variant: damiao")))
    assert (code, result["reason"], result["drive_disabled"]) == (2, "drive_fault", True)
    assert "error Eh (overload)" in error_line(capsys)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("node_id: 5", "node_id: 6"), "no drive answered: no frame was received"),
        (("reply_id: 0", "reply_id: 21"), "answers have the id 000h, not 015h"),
    ],
)
def test_what_does_not_fit_the_drive_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], told: str
) -> None:
    other = changed(tmp_path, change)
    arguments = ["run", "--rig", str(other), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={RIG_FILE}", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert told in error_line(capsys)
