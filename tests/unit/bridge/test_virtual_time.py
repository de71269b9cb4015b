"""The whole room against the simulated world: the same bytes every time, whatever goes wrong on the bus."""

import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from firmware_protocol.host.machine import HostConfig, HostMachine
from hil_forceps.bench.assembly import Settings, make_pipeline, metadata, settings_of
from hil_forceps.bridge.axis import Axis
from hil_forceps.bridge.clocks import VirtualClock
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.bridge.logs.bus_log import LoggedLink, open_bus_log
from hil_forceps.bridge.replay import replay
from hil_forceps.bridge.results import ServiceConfig, ServiceResult, StopReason
from hil_forceps.bridge.service import Service
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.data.recording.reader import Recording, read_recording
from hil_forceps.data.recording.writer import Outcome, open_recorder
from hil_forceps.rig import parse_rig
from virtual_bus.drive import SimulatedDrive
from virtual_bus.interface import VirtualForcepsBus

PAPER = (Path(__file__).parents[3] / "configs" / "paper.yaml").read_text(encoding="utf-8")


class Ran(NamedTuple):
    result: ServiceResult
    recording: Recording
    sha256: tuple[str, str]  # of recording and bus log
    drive_state: str


def run(
    path: Path,
    algorithm: str = "improved",
    rig_text: str = PAPER,
    faults: list[object] | None = None,
    duration_s: float = 0.4,
) -> Ran:
    rig = parse_rig(rig_text, "paper")
    bus = VirtualForcepsBus(f"{path}", rig=rig, simulation=1, seed=3, faults=faults)
    clock = VirtualClock(bus)
    log = open_bus_log(path / "bus.log", clock.now_ns(), threaded=False)
    link = LoggedLink(VirtualTimeLink(bus), clock, log)
    settings = Settings(algorithm, True, 1e-3, PAPER_TRAJECTORY, same_clock=rig.bench.drive_clock_ppm == 0.0)
    recorder = open_recorder(path / "run.mcap", metadata(rig, settings, {}), threaded=False)
    host = HostMachine(HostConfig(rig.bench.node_id, fd=rig.bench.transport == "fd"))
    config = ServiceConfig(duration_ns=round(duration_s * 1e9))
    axis = Axis(host, make_pipeline(rig, settings), config, recorder)
    (result,) = Service(link, clock, [axis], config).run()
    bus.advance_until_ns(bus.now_ns() + 100_000_000)
    (drive,) = bus._world.drives
    assert isinstance(drive, SimulatedDrive)
    state = drive.machine.state.name
    recorder.close({"reason": result.reason.value})
    log.close()
    link.close()
    digests = [hashlib.sha256((path / name).read_bytes()).hexdigest() for name in ("run.mcap", "bus.log")]
    return Ran(result, read_recording(path / "run.mcap"), (digests[0], digests[1]), state)


def replayed(ran: Ran) -> None:
    assert replay(ran.recording, make_pipeline(*settings_of(ran.recording))).first_difference is None


@pytest.mark.parametrize("algorithm", ["improved", "kalman"])
def test_a_run_repeats_and_replays_to_the_byte(tmp_path: Path, algorithm: str) -> None:
    rans = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        rans.append(run(tmp_path / name, algorithm))
    assert rans[0].result.reason is StopReason.COMPLETED
    assert rans[0].drive_state == "DISABLED"
    assert rans[0].sha256 == rans[1].sha256
    replayed(rans[0])
    assert rans[0].result.timing["age"]["max_us"] == 600.0
    assert rans[0].recording.to_run().notes == ()


def test_nothing_moves_at_enabling_and_the_first_reference_of_the_paper_needs_no_approach(tmp_path: Path) -> None:
    recording = run(tmp_path, duration_s=0.1).recording
    sent = recording.references[recording.references["outcome"] == Outcome.SENT]
    first = recording.samples[recording.samples["state"] == 1]["theta_m_raw"]
    assert sent["reference_raw"][0] in first
    following = sent[sent["trajectory_ns"] >= 0]
    assert following["theta_j_ref_rad"].tolist() == [
        PAPER_TRAJECTORY(t * 1e-9) for t in following["trajectory_ns"].tolist()
    ]
    plain = (1.4e-3 * following["theta_j_ref_rad"] + following["elongation_used_m"]) / 2.0e-3
    assert following["requested_rad"] == pytest.approx(plain, abs=1e-15)


def test_can_fd(tmp_path: Path) -> None:
    ran = run(tmp_path, rig_text=PAPER.replace("transport: classic", "transport: fd"))
    assert ran.result.reason is StopReason.COMPLETED
    replayed(ran)


@pytest.mark.parametrize(("ppm", "seen"), [(20000.0, "SSR"), (-20000.0, "SRR")])
def test_clocks_that_drift_lose_nothing(tmp_path: Path, ppm: float, seen: str) -> None:
    """At 2 % the phases pass each other every 50 ms: a tick (R) sees two samples (S), or none."""
    text = PAPER.replace("transport: classic", f"transport: classic\n  drive_clock_ppm: {ppm}")
    ran = run(tmp_path, rig_text=text)
    assert ran.result.reason is StopReason.COMPLETED
    order = ran.recording.order
    arrivals = "".join("SR"[channel - 1] for channel in order[order < 3].tolist()).rstrip("S")
    assert seen in arrivals
    assert "SSS" not in arrivals
    assert "RRR" not in arrivals
    ticks = ran.recording.references
    fresh = ticks[ticks["outcome"] == Outcome.SENT]
    assert len(np.unique(fresh["stamp_ns"])) == len(fresh)
    assert ran.result.counters["pipeline"]["samples"] == ran.result.counters["host"]["samples"]
    assert ran.result.counters["pipeline"]["stale"] == 0
    replayed(ran)


@pytest.mark.parametrize(
    "fault",
    [
        {"fault": "drop", "probability": 0.1},
        {"fault": "duplicate", "probability": 0.3},
        {"fault": "delay", "direction": "to_host", "probability": 0.05, "delay_s": 2.0e-3},
        {"fault": "reorder", "probability": 0.1},
        {"fault": "corrupt_wire", "probability": 0.02},
    ],
    ids=lambda fault: str(fault["fault"]),
)
def test_an_unreliable_bus_is_borne(tmp_path: Path, fault: dict[str, object]) -> None:
    ran = run(tmp_path, faults=[{**fault, "from_s": 0.15}])
    assert ran.result.reason is StopReason.COMPLETED, ran.result.message
    stamps = ran.recording.samples["stamp_ns"]
    assert np.all(np.diff(stamps) > 0), "each sample once and in order"
    assert ran.drive_state == "DISABLED"
    replayed(ran)


def test_a_bus_that_is_gone_ends_the_run_and_leaves_the_drive_safe(tmp_path: Path) -> None:
    ran = run(tmp_path, faults=[{"fault": "bus_gone", "from_s": 0.2, "to_s": 9.0}])
    assert ran.result.reason is StopReason.BUS_DOWN
    assert ran.drive_state == "FAULT"
    replayed(ran)


def test_a_drive_that_goes_off_the_bus_ends_the_run_and_is_safe(tmp_path: Path) -> None:
    ran = run(tmp_path, faults=[{"fault": "bus_off", "node": "drive", "from_s": 0.2, "to_s": 9.0}])
    assert ran.result.reason in {StopReason.DRIVE_LOST, StopReason.DRIVE_FAULT}
    assert ran.drive_state == "FAULT"
