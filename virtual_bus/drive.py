"""The simulated drive: firmware_protocol's drive machine on a simulated forceps, as a node of the virtual bus."""

import math
from typing import Final

from firmware_protocol import codec
from firmware_protocol.drive.machine import DriveConfig, DriveMachine
from firmware_protocol.frames import Frame
from firmware_protocol.messages import DriveState, FaultReason
from firmware_protocol.parameters import INT32_MAX, INT32_MIN
from firmware_protocol.scales import ANGLE_LSB_PER_REV, ANGLE_LSB_RAD, SEQUENCE_MODULUS, STAMP_LSB_NS
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from virtual_bus.effects.forceps import ForcepsWithEffects
from virtual_bus.effects.numbers import effect_numbers
from virtual_bus.effects.start import check_step
from virtual_bus.plant.forceps import SimulatedForceps
from virtual_bus.plant.load import LoadProfile
from virtual_bus.plant.plant import truth_parameters
from virtual_bus.plant.position_loop import LoopParameters
from virtual_bus.plant.sensors import IDEAL_ENCODER, SensorParameters
from virtual_bus.truth_log import TruthLog

PAPER_JAW_START_RAD: Final = math.pi / 2.0
SERIAL_NUMBER: Final = 0x5F0C_0000_0000  # plus the node id: simulated drives differ as real ones do
OUTBOX_LIMIT: Final = 64  # frames; the mailboxes of a controller are bounded too
POLL_PERIOD_S: Final = 1.0e-3  # the drive machine wants to be polled at least that often
WATCHDOG_US: Final = 20_000
WATCHDOG_HOST_PERIODS: Final = 5  # a slow host gets a slower watchdog

_OPERATIONAL: Final = DriveState.OPERATIONAL  # looked up for every sample


def loop_of(rig: Rig) -> LoopParameters:
    """Return the numbers of a rig's position loop; UserError when it has none."""
    law = rig.require_drive()
    return LoopParameters(
        law.sample_time_s,
        law.kp_A_per_rad,
        law.ki_A_per_rad_s,
        law.kd_A_s_per_rad,
        law.derivative_cutoff_Hz,
        law.current_limit_A,
        law.cascade_time_s,
    )


def forceps_of(
    rig: Rig, load: LoadProfile, seed: int, jaw_start_rad: float = PAPER_JAW_START_RAD
) -> SimulatedForceps | ForcepsWithEffects:
    """Build the forceps that a rig describes; UserError when the rig does not say enough, or asks for what can't be."""
    loop, step_s = loop_of(rig), rig.bench.plant_step_s
    effects = effect_numbers(rig.effects)
    try:
        plant = truth_parameters(rig.plant(), step_s)
        check_step(plant, effects, loop.current_limit_A, step_s)
    except ValueError as error:
        raise UserError(f"bench.plant_step_s: {error}") from error
    counts = rig.encoder.counts_per_rev
    sensors = SensorParameters(
        IDEAL_ENCODER if counts is None else float(counts),
        rig.noise.current_A,
        rig.noise.theta_j_rad,
        rig.noise.tau_w_N_m,
    )
    if effects == effect_numbers({}):
        return SimulatedForceps(plant, loop, sensors, load, step_s, jaw_start_rad, seed)
    return ForcepsWithEffects(plant, effects, loop, sensors, load, step_s, jaw_start_rad, seed)


def drive_config_of(rig: Rig, node: int, fd: bool) -> DriveConfig:
    """Set up a drive as its rig asks: limits a little wider than the host's gate, so that the gate acts first.

    Sequence numbers count feedback, so the age of a sample and the sample period are in units of feedback. A
    reference may move twice what the gate lets pass in a host period, or between two samples where these are rarer;
    whatever does not fit the wire saturates.
    """
    feedback_s = rig.require_drive().sample_time_s * rig.bench.feedback_divider
    watchdog_us = min(max(WATCHDOG_US, round(WATCHDOG_HOST_PERIODS * rig.bench.host_period_s * 1e6)), 500_000)
    step_rad = 2.0 * rig.limits.speed_max_rad_per_s * max(rig.bench.host_period_s, feedback_s)
    return DriveConfig(
        node=node,
        serial_number=SERIAL_NUMBER + node,
        fd=fd,
        theta_min_raw=max(math.floor(rig.limits.position_min_rad / ANGLE_LSB_RAD) - 1, INT32_MIN),
        theta_max_raw=min(math.ceil(rig.limits.position_max_rad / ANGLE_LSB_RAD) + 1, INT32_MAX),
        max_step_raw=min(math.ceil(step_rad / ANGLE_LSB_RAD), 1 << 24),
        watchdog_timeout_us=watchdog_us,
        max_sample_age=min(max(math.ceil(watchdog_us * 1e-6 / feedback_s), 2), 127),
        sample_period_us=max(round(feedback_s * 1e6), 1),
        counts_per_rev=rig.encoder.counts_per_rev or ANGLE_LSB_PER_REV,
        torque_constant_nN_m_per_A=min(max(round(rig.plant().torque_constant_N_m_per_A * 1e9), 1), INT32_MAX),
    )


class SimulatedDrive:
    """A drive that closes the rig's position loop and speaks the protocol; a `Node`.

    At each of its samples, on its own clock: time-outs, all sensors latched, feedback and bench sensors sent (every
    `bench.feedback_divider`-th sample), the loop run on the newest reference, its current held to the next sample.
    So the current measured in a sample is the one that was held up to it, and a frame takes effect at the sample that
    follows it. The load begins with the first feedback that says OPERATIONAL; with `load_restarts`, for a drive that
    outlives its hosts, anew with each first one after another state. `truth_duration_s` of truth is kept in `truth`.
    """

    def __init__(
        self,
        rig: Rig,
        load: LoadProfile,
        seed: int = 0,
        node: int | None = None,
        fd: bool | None = None,
        truth_duration_s: float = 0.0,
        jaw_start_rad: float = PAPER_JAW_START_RAD,
        load_restarts: bool = False,
    ) -> None:
        self._forceps = forceps_of(rig, load, seed, jaw_start_rad)
        self.machine = DriveMachine(
            drive_config_of(
                rig,
                rig.bench.node_id if node is None else node,
                rig.bench.transport == "fd" if fd is None else fd,
            )
        )
        sample_time_s = rig.require_drive().sample_time_s
        self._polls_per_sample = math.ceil(sample_time_s / POLL_PERIOD_S - 1.0e-9)
        self._polls_per_feedback = self._polls_per_sample * rig.bench.feedback_divider
        self._drive_ns_per_ns = 1.0 + rig.bench.drive_clock_ppm * 1.0e-6
        self._ns_per_poll = sample_time_s * 1.0e9 / self._polls_per_sample / self._drive_ns_per_ns
        self.truth = TruthLog(math.ceil(truth_duration_s / (sample_time_s * rig.bench.feedback_divider)))
        self.counters = {"outbox_full": 0}
        self.zero_ns: int | None = None  # bus time at which the load began
        self._load_restarts = load_restarts
        self._was_operational = False
        self._outbox: list[Frame] = []
        self._polls = 0  # made so far
        self._next_poll_ns = 0
        self._sequence = 0  # of the next feedback; the drive machine numbers from nought, too
        self._theta_raw = self._forceps.read(0).theta_m

    def trip(self) -> None:
        """Fail as one whose controller has left the bus."""
        self.machine.trip(FaultReason.BUS_OFF)

    def receive(self, frame: Frame, now_ns: int) -> None:
        """Take a frame from the bus at bus time `now_ns`, after all that was due before."""
        if self._next_poll_ns < now_ns:
            self.wake(now_ns)
        answers = self.machine.receive(frame, self._drive_us(now_ns), self._theta_raw)
        if answers:
            self._send(answers)

    def next_wake_ns(self) -> int:
        """Return the bus time of the next poll for time-outs and heartbeats; each sample begins with one."""
        return self._next_poll_ns

    def wake(self, now_ns: int) -> None:
        """Do all that is due, each at its own time, also when called late."""
        machine, per_sample = self.machine, self._polls_per_sample
        while self._next_poll_ns <= now_ns:
            at_ns, poll = self._next_poll_ns, self._polls
            at_us = self._drive_us(at_ns)
            self._polls = poll + 1
            self._next_poll_ns = next_ns = self._poll_time_ns(poll + 1)
            frames = machine.poll(at_us)
            if frames:
                self._send(frames)
            if poll % per_sample == 0:
                self._sample(at_ns, at_us, next_ns if per_sample == 1 else self._poll_time_ns(poll + per_sample), poll)

    def take_outbox(self) -> list[Frame]:
        """Hand over the frames to send, oldest first, and forget them."""
        frames, self._outbox = self._outbox, []
        return frames

    def _sample(self, at_ns: int, at_us: int, next_ns: int, poll: int) -> None:
        is_feedback, machine = poll % self._polls_per_feedback == 0, self.machine
        if is_feedback:
            if (machine.state is _OPERATIONAL) is not self._was_operational:
                self._look_for_zero(at_ns)
            if self.truth.capacity:
                self.truth.append(at_ns, at_us * STAMP_LSB_NS, self._forceps.truth(at_ns))
        theta_m, current, theta_j, tau_w = self._forceps.sample(at_ns, next_ns, machine.reference_raw)
        self._theta_raw = theta_m
        if is_feedback:
            sequence = self._sequence
            frames = machine.sample(at_us, theta_m, current)
            frames.append(codec.encode_bench_sensor(machine.node, theta_j, tau_w, sequence))
            self._sequence = (sequence + 1) % SEQUENCE_MODULUS
            self._send(frames)

    def _look_for_zero(self, at_ns: int) -> None:
        operational = self.machine.state is _OPERATIONAL
        if operational and not self._was_operational and (self.zero_ns is None or self._load_restarts):
            self.zero_ns = at_ns
            self._forceps.start_load(at_ns)
        self._was_operational = operational

    def _send(self, frames: list[Frame]) -> None:
        outbox = self._outbox
        outbox += frames
        if len(outbox) > OUTBOX_LIMIT:
            self.counters["outbox_full"] += len(outbox) - OUTBOX_LIMIT
            del outbox[OUTBOX_LIMIT:]

    def _poll_time_ns(self, poll: int) -> int:
        """Return the bus time of a poll; from the first one on, so that rounding does not add up."""
        return round(poll * self._ns_per_poll)

    def _drive_us(self, now_ns: int) -> int:
        """Return the drive's own clock, µs, at this bus time."""
        return round(now_ns * self._drive_ns_per_ns * 1.0e-3)
