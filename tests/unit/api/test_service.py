"""`Service` and `virtual_bench`: runs against the simulated drive, and what goes wrong in words."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

import hil_forceps as hf
from firmware_protocol.messages import DriveState
from hil_forceps.cli.main import main
from hil_forceps.data.readers.read_run import read_run
from hil_forceps.data.recording.reader import read_recording

ROOT = Path(__file__).parents[3]
PAPER = ROOT / "configs" / "paper.yaml"
REALISTIC = ROOT / "configs" / "realistic.yaml"
Bench = Callable[..., hf.VirtualBench]


def test_a_run_is_recorded_and_its_files_are_those_of_the_command_line(forceps_bench: Bench, tmp_path: Path) -> None:
    run = forceps_bench(REALISTIC, load_N_m=5e-4, seed=3).run(duration_s=0.2, out=tmp_path / "out")
    assert (run.ok, run.reason, run.drive_disabled, run.notes) == (True, "completed", True, ())
    assert run.recorded is not None
    assert run.estimates is not None
    (read,) = read_run(tmp_path / "out" / "run.mcap")
    assert list(read.columns) == list(run.recorded.columns)
    for name in read.columns:
        np.testing.assert_array_equal(run.recorded[name], read[name])
    assert len(run.estimates.tau_w_N_m) == len(run.recorded) == 201
    samples = read_recording(tmp_path / "out" / "run.mcap").samples
    rows = samples[samples["state"] == DriveState.OPERATIONAL]
    np.testing.assert_array_equal(run.estimates.tau_w_N_m, rows["tau_w_estimate_N_m"])
    np.testing.assert_array_equal(run.estimates.elongation_m, rows["elongation_estimate_m"])
    assert run.folder == tmp_path / "out"
    assert set(run.gate) <= {"limited_acceleration", "limited_jerk"}
    assert repr(run).startswith("<ServiceRun completed: completed; <Run 'run': 201 samples")


def test_it_is_the_run_of_the_command_line(tmp_path: Path) -> None:
    line = ["--interface", "virtual_forceps", "--channel", "same", "--option", f"rig={REALISTIC}"]
    command = ["run", "--rig", str(REALISTIC), *line, "--duration", "0.2", "--out", str(tmp_path / "command")]
    with pytest.raises(SystemExit) as ended:
        main(command)
    assert ended.value.code == 0
    options = {"rig": str(REALISTIC)}
    service = hf.Service(REALISTIC, interface="virtual_forceps", channel="same", options=options)
    assert service.run(duration_s=0.2, out=tmp_path / "api").ok
    for name in ("run.mcap", "bus.log"):
        assert (tmp_path / "api" / name).read_bytes() == (tmp_path / "command" / name).read_bytes()


def test_the_same_seed_gives_the_same_numbers_and_another_one_others(forceps_bench: Bench) -> None:
    def current(seed: int) -> list[float]:
        recorded = forceps_bench(REALISTIC, seed=seed).run(duration_s=0.1).recorded
        assert recorded is not None
        return list(recorded["current_A"])

    assert current(1) == current(1)
    assert current(1) != current(2)


def test_what_is_hidden_in_the_world_is_not_in_the_rig_of_the_service(forceps_bench: Bench) -> None:
    rig = hf.load_rig(PAPER)
    hidden = rig.with_changes({"effects": {"current_gain": {"relative_error": 0.2}}})
    told = forceps_bench(hidden, load_N_m=1e-3).run(duration_s=0.5)
    untold = forceps_bench(hidden, load_N_m=1e-3).run(duration_s=0.5, rig=rig)
    assert told.estimates is not None
    assert untold.estimates is not None
    assert told.estimates.tau_w_N_m[-1] == pytest.approx(1e-3, rel=0.03)
    assert untold.estimates.tau_w_N_m[-1] == pytest.approx(1.2e-3, rel=0.03)


def test_truth_follows_the_load_and_the_next_run_goes_on(forceps_bench: Bench) -> None:
    load = hf.Trajectory(
        (0.0, 0.1, 0.2, 0.3), (0.0, 0.0, 1e-3, 0.0)
    )  # let go at the end: a drive without torque gives way
    bench = forceps_bench(PAPER, load_N_m=load)
    still = hf.Trajectory((0.0,), (np.pi / 2,))
    assert bench.run(still, 0.3).ok
    truth = bench.truth()
    assert truth["tau_w_N_m"][0] == 0.0
    assert truth["tau_w_N_m"].max() == pytest.approx(1e-3)
    assert bench.run(still, 0.1).ok
    assert bench.truth()["stamp_ns"][-1] > truth["stamp_ns"][-1]


def test_any_program_reaches_the_bench_through_python_can() -> None:
    with hf.virtual_bench(PAPER) as bench, can.Bus(interface=bench.interface, channel=bench.channel) as bus:
        assert bus.recv(0.1) is not None
    with pytest.raises(can.CanInitializationError, match="nothing is on channel"):
        can.Bus(interface=bench.interface, channel=bench.channel)


def test_a_drive_that_is_not_there_is_told_in_the_result(forceps_bench: Bench) -> None:
    other = hf.load_rig(PAPER).with_changes({"bench.node_id": 5})
    run = forceps_bench(PAPER).run(rig=other)
    assert (run.ok, run.reason, run.recorded, run.estimates) == (False, "no_drive", None, None)
    assert "no drive answered" in run.message


def test_a_host_that_comes_right_behind_another_is_told_what_to_do(forceps_bench: Bench) -> None:
    bench = forceps_bench(PAPER)
    service = hf.Service(PAPER, interface=bench.interface, channel=bench.channel)
    still = hf.Trajectory((0.0,), (np.pi / 2,))
    assert service.run(still, 0.1).ok
    run = service.run(still, 0.1)
    assert (run.ok, run.reason) == (False, "enable_failed")
    assert (
        "it stays DISABLED; if another program controlled it just before: it enables a new host only 0.1 s"
        in run.message
    )
    with can.Bus(interface=bench.interface, channel=bench.channel) as bus:
        world: Any = bus
        world.advance_until_ns(world.now_ns() + 150_000_000)
    assert service.run(still, 0.1).ok, "and then it is enabled"


def test_an_interrupt_and_a_wish_to_stop_end_it_cleanly(forceps_bench: Bench) -> None:
    bench = forceps_bench(PAPER)
    service = hf.Service(PAPER, interface=bench.interface, channel=bench.channel)
    before = signal.getsignal(signal.SIGINT)
    asked = iter(range(10_000))
    run = service.run(stop_requested=lambda: next(asked) > 300)
    assert (run.ok, run.reason, run.drive_disabled) == (True, "stop_requested", True)

    bench = forceps_bench(PAPER)
    service = hf.Service(PAPER, interface=bench.interface, channel=bench.channel)
    run = service.run(telemetry=lambda _: os.kill(os.getpid(), signal.SIGINT))
    assert (run.reason, run.drive_disabled) == ("stop_requested", True)
    assert signal.getsignal(signal.SIGINT) is before


def test_faults_of_the_bus_happen_there(forceps_bench: Bench, tmp_path: Path) -> None:
    gone = [{"fault": "bus_gone", "from_s": 0.3}]
    (tmp_path / "faults.yaml").write_text("- {fault: bus_gone, from_s: 0.3}\n")
    for faults in (gone, tmp_path / "faults.yaml", str(tmp_path / "faults.yaml")):
        run = forceps_bench(PAPER, faults=faults).run()
        assert (run.ok, run.reason) == (False, "bus_down")
        assert run.recorded is not None  # what came before
    with pytest.raises(hf.UserError, match="gremlin"):
        forceps_bench(PAPER, faults=[{"fault": "gremlin"}])


def test_what_is_refused(tmp_path: Path) -> None:
    rig = hf.load_rig(PAPER)
    with pytest.raises(hf.UserError, match="limits: is missing"):
        hf.Service(rig.with_changes({"limits": None}), interface="virtual_forceps")
    with pytest.raises(hf.UserError, match="unknown algorithm 'kalmann'"):
        hf.Service(rig, interface="virtual_forceps", algorithm="kalmann")
    with pytest.raises(hf.UserError, match="give either a CAN interface and its channel"):
        hf.Service(rig)
    with pytest.raises(hf.UserError, match="is on a CAN bus; give interface and channel"):
        hf.Service(ROOT / "configs" / "drives" / "odrive.yaml", serial="/dev/ttyUSB0")
    with pytest.raises(hf.UserError, match=r"baudrate 9600: the rig says motor_driver\.baudrate_bit_per_s"):
        hf.Service(ROOT / "configs" / "drives" / "dynamixel.yaml", serial="/dev/ttyUSB0", baudrate=9600)
    with pytest.raises(ValueError, match="duration_s: is nan; must be a finite number above 0"):
        hf.Service(rig, interface="virtual_forceps").run(duration_s=float("nan"))
    with pytest.raises(hf.UserError, match=r"trajectory: at 1 s the motor reference is 35 rad .*; change it or the li"):
        hf.Service(rig, interface="virtual_forceps").run(hf.Trajectory((0.0, 1.0), (1.5, 50.0)))
    (tmp_path / "run.mcap").touch()
    with pytest.raises(hf.UserError, match=r"out .*: contains a run \(run\.mcap\); name another folder"):
        hf.Service(rig, interface="virtual_forceps").run(out=tmp_path)
    with pytest.raises(hf.UserError, match="nothing is on channel"):
        hf.Service(rig, interface="virtual_forceps", channel="nobody").run(out=tmp_path / "new" / "run")
    assert not (tmp_path / "new").exists(), "a run that is refused leaves no folder behind"
    (tmp_path / "file").touch()
    with pytest.raises(hf.UserError, match=r"out .*/file: can't be made: .*; name another folder"):
        hf.Service(rig, interface="virtual_forceps").run(out=tmp_path / "file")
    with (
        pytest.raises(hf.UserError, match="drive: the section is missing"),
        hf.virtual_bench(rig.with_changes({"drive": None})),
    ):
        pass
