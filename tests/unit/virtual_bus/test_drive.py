"""The simulated drive as a whole: frames in, frames out, the paper's steady states."""

import math
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

from firmware_protocol import codec
from firmware_protocol.frames import Frame
from firmware_protocol.messages import (
    PROTOCOL_MAJOR,
    PROTOCOL_MINOR,
    BenchSensor,
    Control,
    DriveState,
    Estop,
    FaultReason,
    FdFeedback,
    Feedback,
    HostHeartbeat,
    Message,
    Timing,
)
from firmware_protocol.scales import ANGLE_LSB_RAD, BENCH_TORQUE_LSB_N_M, CURRENT_LSB_A, angle_raw_from_rad, wrap_int32
from hil_forceps.rig import Rig, UserError, parse_rig
from virtual_bus.bus.node import Node
from virtual_bus.drive import OUTBOX_LIMIT, SimulatedDrive
from virtual_bus.plant.load import LoadProfile, paper_load, piecewise_linear

MS = 1_000_000
PAPER = """
forceps:
  motor_pulley_radius_m: 2.0e-3
  jaw_pulley_radius_m: 1.4e-3
  motor_inertia_kg_m2: 3.18e-8
  jaw_inertia_kg_m2: 6.85e-8
  motor_viscous_N_m_s_per_rad: 1.16e-4
  motor_coulomb_N_m: 4.62e-7
  jaw_coulomb_N_m: 4.62e-9
  wire_stiffness_N_per_m: 2.6e4
motor:
  torque_constant_N_m_per_A: 1.35e-2
encoder:
  counts_per_rev: ideal
drive:
  sample_time_s: 1.0e-3
  kp_A_per_rad: 1.2
  ki_A_per_rad_s: 15.0
  kd_A_s_per_rad: 0.006
  derivative_cutoff_Hz: 150.0
  current_limit_A: 1.0
"""


def rig_with(**changes: object) -> Rig:
    """The paper's rig with other values; `a__b` stands for the key a.b."""
    return parse_rig(PAPER).with_changes({key.replace("__", "."): value for key, value in changes.items()})


def jaw_reference_rad(time_s: float) -> float:
    return math.radians(90.0 - 16.0 * min(max(time_s, 0.0), 5.0))


class Seen(NamedTuple):
    """One feedback with its timing and bench sensor, as decoded from the bus."""

    at_ns: int
    theta_m: int
    current: int
    sequence: int
    stamp_us: int
    state: int
    fault: int
    setpoint_sequence: int
    bench: BenchSensor


class HandMadeHost:
    """Enables the drive and streams uncompensated references, 0.6 ms after each feedback."""

    def __init__(self, drive: SimulatedDrive, fd: bool = False) -> None:
        self.drive = drive
        self.fd = fd
        self.decoder = codec.Decoder()
        self.setpoints = 0
        self.heartbeats = 0
        self.zero_ns: int | None = None
        self.other: list[Message] = []

    def send(self, frame: Frame, now_ns: int) -> None:
        self.drive.receive(frame, now_ns)

    def heartbeat(self, control: Control, now_ns: int) -> None:
        self.heartbeats += 1
        message = HostHeartbeat(1, control, PROTOCOL_MAJOR, PROTOCOL_MINOR, self.heartbeats % 256)
        self.send(codec.encode(message), now_ns)

    def step(self) -> Seen | None:
        """Let the drive do its next wake and collect what it says."""
        now_ns = self.drive.next_wake_ns()
        self.drive.wake(now_ns)
        parts: dict[type, Message] = {}
        for frame in self.drive.take_outbox():
            message = self.decoder.decode(frame)
            assert message is not None
            if isinstance(message, Feedback | Timing | FdFeedback | BenchSensor):
                parts[type(message)] = message
            else:
                self.other.append(message)
        return seen(parts, now_ns) if parts else None

    def follow(self, s: Seen, control: Control = Control.ENABLE) -> None:
        """Answer one feedback: heartbeat every 20th, a reference when the drive wants one."""
        now_ns = s.at_ns + 600_000
        if s.sequence % 20 == 0:
            self.heartbeat(control, now_ns)
        if s.state == DriveState.ARMED:
            reference = s.theta_m
        elif s.state == DriveState.OPERATIONAL:
            self.zero_ns = s.at_ns if self.zero_ns is None else self.zero_ns
            time_s = (s.at_ns - self.zero_ns) * 1.0e-9
            reference = angle_raw_from_rad(0.7 * jaw_reference_rad(time_s))
        else:
            return
        self.setpoints = (self.setpoints + 1) % 256
        self.send(codec.encode_setpoint(1, reference, self.setpoints, s.sequence, self.fd), now_ns)

    def run(self, duration_s: float) -> Iterator[Seen]:
        """Show ENABLE low, then enable, then follow, until this long after the zero."""
        self.heartbeat(Control.NONE, 0)
        while self.zero_ns is None or self.drive.next_wake_ns() <= self.zero_ns + duration_s * 1.0e9:
            s = self.step()
            if s is not None:
                self.follow(s)
                yield s
            assert self.drive.next_wake_ns() < 100_000 * MS


def seen(parts: dict[type, Message], now_ns: int) -> Seen:
    bench = parts[BenchSensor]
    assert isinstance(bench, BenchSensor)
    if FdFeedback in parts:
        m = parts[FdFeedback]
        assert isinstance(m, FdFeedback)
        fields = (m.theta_m, m.current, m.sequence, m.stamp_us, m.state, m.fault, m.setpoint_sequence)
    else:
        f, t = parts[Feedback], parts[Timing]
        assert isinstance(f, Feedback)
        assert isinstance(t, Timing)
        assert f.sequence == t.sequence
        fields = (f.theta_m, f.current, f.sequence, t.stamp_us, t.state, t.fault, t.setpoint_sequence)
    assert bench.sequence == fields[2]
    return Seen(now_ns, *fields, bench)


def operational(host: HandMadeHost) -> Seen:
    for s in host.run(0.1):
        if s.state == DriveState.OPERATIONAL:
            return s
    raise AssertionError("never operational")


def test_is_a_node() -> None:
    node: Node = SimulatedDrive(rig_with(), paper_load(0))
    assert node.next_wake_ns() == 0


@pytest.mark.parametrize(("simulation", "steady"), [(1, (16.0, 20.0)), (2, (11.5, 12.4))])
@pytest.mark.parametrize("fd", [False, True])
def test_uncompensated_jaw_is_off_by_what_the_paper_implies(
    simulation: int, steady: tuple[float, float], fd: bool
) -> None:
    host = HandMadeHost(SimulatedDrive(rig_with(), paper_load(simulation), truth_duration_s=25.0, fd=fd), fd)
    bench = [(s.at_ns, s.bench.theta_j, s.bench.tau_w, s.current) for s in host.run(20.0)]
    assert host.drive.zero_ns == host.zero_ns
    assert host.zero_ns is not None
    time_s = (np.array([row[0] for row in bench]) - host.zero_ns) * 1.0e-9
    window = (time_s > steady[0]) & (time_s < steady[1])
    jaw_deg = np.degrees(np.array([row[1] for row in bench]) * ANGLE_LSB_RAD)
    assert (jaw_deg[window] - 10.0) == pytest.approx(-2.249, abs=0.01)
    quiet = (time_s > 8.0) & (time_s < 10.0)
    assert (jaw_deg[quiet] - 10.0) == pytest.approx(0.0, abs=0.001)
    assert np.array([row[2] for row in bench])[window] * BENCH_TORQUE_LSB_N_M == pytest.approx(2.0e-3, abs=1.0e-9)
    assert np.array([row[3] for row in bench])[window] * CURRENT_LSB_A == pytest.approx(0.212, abs=1.0e-3)
    truth = host.drive.truth.columns()
    at = (truth["bus_time_ns"] - host.zero_ns) * 1.0e-9
    assert truth["elongation_m"][(at > steady[0]) & (at < steady[1])] == pytest.approx(54.9e-6, abs=0.1e-6)


def test_load_begins_at_the_first_operational_feedback_and_steps_within_its_period() -> None:
    load = piecewise_linear([0.0105] * 2, [0.0, 2.0e-3])
    host = HandMadeHost(SimulatedDrive(rig_with(), load))
    torque = {}
    for s in host.run(0.02):
        assert s.bench.tau_w == 0 or s.state == DriveState.OPERATIONAL
        if host.zero_ns is not None:
            torque[s.at_ns - host.zero_ns] = s.bench.tau_w * BENCH_TORQUE_LSB_N_M
    assert torque[10 * MS] == 0.0
    assert torque[11 * MS] == pytest.approx(2.0e-3)


@pytest.mark.parametrize("restarts", [False, True])
def test_load_starts_anew_with_a_new_enable_only_when_asked(restarts: bool) -> None:
    host = HandMadeHost(SimulatedDrive(rig_with(), paper_load(0), load_restarts=restarts))
    first = operational(host)
    host.heartbeat(Control.NONE, first.at_ns + 700_000)
    for s in host.run(0.1):
        if s.state == DriveState.OPERATIONAL:
            break
    assert s.at_ns > first.at_ns
    assert host.drive.zero_ns == (s.at_ns if restarts else first.at_ns)


def test_no_current_unless_operational_and_no_kick_on_enable() -> None:
    host = HandMadeHost(SimulatedDrive(rig_with(), paper_load(0)))
    kick = [s.current for s in host.run(0.003)]
    assert max(map(abs, kick)) * CURRENT_LSB_A < 2.0e-3


def test_estop_takes_the_current_away_at_the_next_sample() -> None:
    host = HandMadeHost(SimulatedDrive(rig_with(), piecewise_linear([0.0], [2.0e-3])))
    last = list(host.run(0.5))[-1]
    assert abs(last.current) * CURRENT_LSB_A > 0.1
    host.send(codec.encode(Estop(0)), last.at_ns + 700_000)
    latched, after = host.step(), host.step()
    assert latched is not None
    assert after is not None
    assert (latched.state, latched.fault) == (DriveState.FAULT, FaultReason.ESTOP)
    assert latched.current != 0  # what was held until then
    assert after.current == 0


def test_silent_host_trips_the_watchdog() -> None:
    host = HandMadeHost(SimulatedDrive(rig_with(), paper_load(0)))
    operational(host)
    faults = [s for s in (host.step() for _ in range(40)) if s is not None and s.fault == FaultReason.WATCHDOG]
    assert len(faults) > 10
    assert host.drive.machine.reference_raw is None


def test_current_in_a_sample_is_the_one_held_before_it() -> None:
    """The loop sees a reference at the sample that follows it; the measured current shows it one sample later."""
    host = HandMadeHost(SimulatedDrive(rig_with(drive__ki_A_per_rad_s=0.0, drive__kd_A_s_per_rad=0.0), paper_load(0)))
    s = operational(host)
    jump = angle_raw_from_rad(0.05)
    host.send(codec.encode_setpoint(1, s.theta_m + jump, host.setpoints + 1, s.sequence), s.at_ns + 900_000)
    currents = [x.current * CURRENT_LSB_A for x in (host.step(), host.step()) if x is not None]
    assert currents[0] == pytest.approx(0.0, abs=1.0e-3)
    assert currents[1] == pytest.approx(1.2 * 0.05, abs=1.0e-3)


@pytest.mark.parametrize("ppm", [-200.0, 0.0, 20_000.0])
def test_stamps_run_on_the_drive_clock(ppm: float) -> None:
    host = HandMadeHost(SimulatedDrive(rig_with(bench__drive_clock_ppm=ppm), paper_load(0)))
    samples = [s for s in (host.step() for _ in range(3000)) if s is not None]
    assert [s.stamp_us for s in samples] == [1000 * k for k in range(3000)]
    elapsed_ns = samples[-1].at_ns - samples[0].at_ns
    assert elapsed_ns == pytest.approx(2999 * MS / (1.0 + ppm * 1.0e-6), abs=1.0)


def test_feedback_divider_thins_the_frames_and_not_the_loop() -> None:
    rig = rig_with(drive__sample_time_s=1.0e-4, bench__feedback_divider=10)
    host = HandMadeHost(SimulatedDrive(rig, paper_load(2), truth_duration_s=25.0))
    samples = list(host.run(12.0))
    assert {b.at_ns - a.at_ns for a, b in pairwise(samples)} == {MS}
    assert [s.sequence for s in samples[:300]] == [k % 256 for k in range(300)]
    assert host.drive.truth.rows == len(samples)
    assert math.degrees(samples[-1].bench.theta_j * ANGLE_LSB_RAD) - 10.0 == pytest.approx(-2.249, abs=0.01)


def test_slow_drive_is_still_polled_every_millisecond() -> None:
    drive = SimulatedDrive(rig_with(drive__sample_time_s=2.5e-3), paper_load(0))
    wakes, feedback = [], 0
    for _ in range(30):
        wakes.append(drive.next_wake_ns())
        drive.wake(wakes[-1])
        feedback += sum(frame.arbitration_id >> 5 == 0x04 for frame in drive.take_outbox())
    assert max(np.diff(wakes)) <= MS
    assert feedback == 10


def test_frame_that_overtakes_a_late_wake_never_turns_time_back() -> None:
    """In real time a frame may come while a sample is due: the sample is taken first, and the watchdog stays fed."""
    host = HandMadeHost(SimulatedDrive(rig_with(), paper_load(0)))
    s = operational(host)
    host.send(codec.encode_setpoint(1, s.theta_m, host.setpoints + 1, s.sequence), s.at_ns + 5 * MS + 1)
    host.drive.wake(s.at_ns + 6 * MS)
    assert host.drive.machine.state == DriveState.OPERATIONAL
    assert host.drive.machine.counters["setpoints_accepted"] >= 2


def test_late_wake_makes_up_for_every_sample_at_its_own_time() -> None:
    late, punctual = (SimulatedDrive(rig_with(), paper_load(0), truth_duration_s=1.0) for _ in range(2))
    late.wake(10 * MS)
    for k in range(11):
        punctual.wake(k * MS)
    assert late.take_outbox() == punctual.take_outbox()
    assert late.truth.columns()["bus_time_ns"].tolist() == [k * MS for k in range(11)]


def test_outbox_is_bounded_and_says_what_it_dropped() -> None:
    drive = SimulatedDrive(rig_with(), paper_load(0))
    drive.wake(100 * MS)
    frames = drive.take_outbox()
    assert len(frames) == OUTBOX_LIMIT
    assert drive.counters["outbox_full"] > 200


def test_truth_log_keeps_its_length_and_counts_the_rest() -> None:
    drive = SimulatedDrive(rig_with(), paper_load(0), truth_duration_s=0.01)
    drive.wake(20 * MS)
    assert (drive.truth.rows, drive.truth.dropped) == (10, 11)
    columns = drive.truth.columns()
    assert columns["theta_j_rad"] == pytest.approx(math.pi / 2.0)
    assert columns["theta_m_rad"] == pytest.approx(0.7 * math.pi / 2.0)


def trace(seed: int) -> list[Frame]:
    noise = {"current_A": 1.0e-3, "theta_j_rad": 2.0e-4, "tau_w_N_m": 1.0e-5}
    drive = SimulatedDrive(rig_with(noise=noise, encoder__counts_per_rev=16384), paper_load(0), seed)
    frames: list[Frame] = []
    for k in range(200):
        drive.wake(k * MS)
        frames += drive.take_outbox()
    return frames


def test_same_seed_same_frames() -> None:
    assert trace(3) == trace(3)
    assert trace(3) != trace(4)


def test_quantised_encoder_shows_in_the_feedback() -> None:
    host = HandMadeHost(SimulatedDrive(rig_with(encoder__counts_per_rev=4096), paper_load(0)))
    angles = {s.theta_m for s in host.run(0.5)}
    assert len(angles) > 10
    assert all(angle % 4096 == 0 for angle in angles)


def test_jaw_starts_where_it_is_told() -> None:
    host = HandMadeHost(SimulatedDrive(rig_with(), paper_load(0), jaw_start_rad=-1.0))
    s = host.step()
    assert s is not None
    assert wrap_int32(s.theta_m) * ANGLE_LSB_RAD == pytest.approx(-0.7, abs=1.0e-6)
    assert s.bench.theta_j * ANGLE_LSB_RAD == pytest.approx(-1.0, abs=1.0e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {"limits__speed_max_rad_per_s": 1.0e6, "bench__host_period_s": 0.1},
        {"limits__speed_max_rad_per_s": 1.0e-9, "limits__acceleration_max_rad_per_s2": 1.0e-6},
        {"limits__position_min_rad": -800.0, "limits__position_max_rad": 800.0},
        {"drive__sample_time_s": 1.0e-6, "encoder__counts_per_rev": 4},
        {"motor__torque_constant_N_m_per_A": 10.0},
    ],
)
def test_extremes_of_a_valid_rig_still_fit_the_parameters_of_the_wire(changes: dict[str, object]) -> None:
    drive = SimulatedDrive(rig_with(**changes), paper_load(0))
    drive.wake(0)
    assert len(drive.take_outbox()) >= 3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"drive": None}, "drive"),
        ({"effects": {"wire_damping": {"damping_N_s_per_m": 500.0}}}, "too coarse for the effects"),
        ({"forceps__wire_stiffness_N_per_m": "unknown"}, "wire_stiffness_N_per_m"),
        ({"bench__plant_step_s": 1.0e-3}, r"bench\.plant_step_s: .*too coarse"),
    ],
)
def test_rig_that_can_not_be_simulated_is_refused_in_words(changes: dict[str, object], words: str) -> None:
    make: Callable[[Rig, LoadProfile], SimulatedDrive] = SimulatedDrive
    with pytest.raises(UserError, match=words):
        make(rig_with(**changes), paper_load(0))
