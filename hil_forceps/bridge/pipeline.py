"""From raw samples to the reference that may leave: estimate, compensate (10), gate. Pure: time comes in.

Every sample goes through the estimator, in order; at most one reference comes out of a tick, from the newest sample,
and none twice from the same one: a drive's watchdog is to be fed by fresh control output only.

Fresh means taken no longer ago than `max_sample_age_s`. Where the drive's stamps are the host's own clock that is
exact. Elsewhere it counts from the arrival: a clock that steps can't be told from a path that holds frames back, and
the drive itself refuses a reference whose sample has become too old.

Before the drive is OPERATIONAL the reference is the measured angle itself, so enabling moves nothing. The zero of the
experiment is the stamp of the first OPERATIONAL sample, and trajectory time is the newest sample's stamp less that.

Approach: where the motor angle at the zero is more than `tolerance_rad` away from the first reference, the difference
is added to the reference and fades out along 10s³ − 15s⁴ + 6s⁵, as long as it takes to stay below `speed_rad_per_s`.
The trajectory runs on underneath, so the zero stays what it is; a jaw that is already where the trajectory begins
(the paper's bench) has no approach at all. A first reference further away than the gate's bounds lie apart can't be
meant: it is denied, and the approach begins with the next, or one wild estimate would shift all that follow.
"""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import Final, NamedTuple

from firmware_protocol.frames import make
from firmware_protocol.host.machine import RawSample
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A, angle_raw_from_rad
from hil_forceps.bridge.gate_tally import GateTally
from hil_forceps.bridge.statistics import StampMap
from hil_forceps.control.compensator import motor_reference_rad
from hil_forceps.control.gate import Gate, GateState, GateTrip, GateVerdict
from hil_forceps.data.recording.writer import Reference
from hil_forceps.estimation.interface import Estimate, Estimator, Sample, State
from hil_forceps.rig.plant import PlantParameters

GATE_VERDICT_BASE: Final = 16
PEAK_TO_MEAN_SPEED_RATIO: Final = 1.875  # of 10s³ − 15s⁴ + 6s⁵, at s = 1/2
NOWHERE_NS: Final = -1
_OPERATIONAL: Final = int(DriveState.OPERATIONAL)


class Verdict(IntEnum):
    """Why a tick had nothing for the gate; the gate's own verdicts follow from `GATE_VERDICT_BASE` on."""

    NOTHING_NEW = 0  # no sample since the tick before
    STALE = 1  # the newest sample is older than allowed
    DENIED_TOO_FAR = 2  # the first reference is further from the motor's angle than the gate's bounds lie apart


GATE_CODES: Final = {verdict: GATE_VERDICT_BASE + place for place, verdict in enumerate(GateVerdict)}
_PASSED: Final = GateVerdict.PASSED
_FROZEN: Final = GateVerdict.FROZEN
PASSED_CODE: Final = GATE_CODES[GateVerdict.PASSED]  # apart, since hashing an Enum takes its time
VERDICT_NAMES: Final = {int(verdict): verdict.name for verdict in Verdict} | {
    code: verdict.name for verdict, code in GATE_CODES.items()
}


class Approach(NamedTuple):
    """How to get from where the jaw is to where the trajectory begins; angle and speed of the motor pulley."""

    speed_rad_per_s: float = 0.5
    tolerance_rad: float = 0.01


DEFAULT_APPROACH: Final = Approach()


class Pipeline:
    """One estimator with its compensation and gate, running over one stream of samples."""

    def __init__(
        self,
        estimator: Estimator,
        trajectory: Callable[[float], float],
        plant: PlantParameters,
        gate: Gate,
        compensate: bool,
        max_sample_age_s: float,
        approach: Approach = DEFAULT_APPROACH,
        same_clock: bool = False,
    ) -> None:
        """`trajectory`: jaw angle [rad] over time [s]; uncompensated means the elongation is taken as zero in (10).

        `same_clock`: the drive's stamps are the host's own clock (see `StampMap`).
        """
        if not max_sample_age_s > 0.0 or not approach.speed_rad_per_s > 0.0:
            raise ValueError("the greatest sample age and the approach speed must be positive")
        self.zero_ns: int | None = None
        self.is_waiting = False  # for other axes: an operational drive holds the angle at which it became so
        self._waits_at_rad: float | None = None
        self.gate = gate
        self._see, self._pass = gate.see, gate.step
        self.gate_trip: GateTrip | None = None  # what closed or latched the gate
        self.is_latched = False  # and it wants to be cleared
        self.denied_in_a_row = 0
        self.passed_stamp_ns = 0  # of the sample that the last reference came from
        self.verdict = int(Verdict.NOTHING_NEW)  # of the last reference asked for; NOTHING_NEW before it
        self.newest: RawSample | None = None
        self.sample = Sample(0, math.nan, math.nan)  # the newest, in SI
        self.estimate = Estimate(math.nan, math.nan)  # after it
        self.counters = {"samples": 0, "not_increasing": 0, "nothing_new": 0, "stale": 0, "denied": 0, "passed": 0}
        self.gate_tally = GateTally()
        self._start, self._step, self._estimate = estimator.start, estimator.step, estimator.estimate
        self._trajectory = trajectory
        self._plant = plant
        self._torque_lsb_N_m = plant.torque_constant_N_m_per_A * CURRENT_LSB_A
        self._compensate = compensate
        self._max_age_ns = round(max_sample_age_s * 1e9)
        self._approach = approach
        self._stamps = StampMap(same_clock=same_clock)
        self.host_time_ns = self._stamps.host_time_ns  # of a drive stamp; ValueError before the first sample
        self._same_clock = same_clock
        self._state: State | None = None
        self._is_new = False
        self._was_opened = False
        self._fade: _Fade | None = None

    def warm_up(self) -> None:
        """Run the estimator once for nothing: its kernels are compiled, or loaded, now and not in a tick."""
        state = self._step(self._start(Sample(0, 0.0, 0.0)), Sample(1_000_000, 0.0, 0.0))
        self._estimate(state)

    def feed(self, raw: RawSample) -> bool:
        """Take the next sample; False when its stamp does not increase: then it is counted and dropped."""
        stamp_ns = raw.stamp_ns
        if self.newest is not None and stamp_ns <= self.newest.stamp_ns:
            self.counters["not_increasing"] += 1
            return False
        self.counters["samples"] += 1
        torque_N_m = raw.current * self._torque_lsb_N_m
        self.sample = sample = make(Sample, (stamp_ns, raw.theta_m * ANGLE_LSB_RAD, torque_N_m))
        state = self._state
        self._state = state = self._start(sample) if state is None else self._step(state, sample)
        self.estimate = self._estimate(state)
        self._see(stamp_ns, raw.received_ns, sample.theta_m_rad, raw.current * CURRENT_LSB_A)
        self._stamps.see(stamp_ns, raw.received_ns)
        if self.zero_ns is None and raw.state == _OPERATIONAL and not self.is_waiting:
            self.zero_ns = stamp_ns
        self.newest = raw
        self._is_new = True
        return True

    def reference(self, now_ns: int) -> Reference:
        """Compute what may leave at this tick; `reference_raw` is None when nothing may, `verdict` says why."""
        newest = self.newest
        if newest is None:
            self.counters["nothing_new"] += 1
            return Reference(
                now_ns, 0, NOWHERE_NS, None, math.nan, math.nan, math.nan, math.nan, Verdict.NOTHING_NEW, 0
            )
        verdict: Verdict | None = None
        taken_ns = newest.received_ns
        if self._same_clock:  # by a clock that was set back a sample may be stamped later than it arrived: it wasn't
            taken_ns = min(taken_ns, self._stamps.host_time_ns(newest.stamp_ns))
        if now_ns - taken_ns > self._max_age_ns:
            verdict = Verdict.STALE
            self.counters["stale"] += 1
        elif not self._is_new:
            verdict = Verdict.NOTHING_NEW
            self.counters["nothing_new"] += 1
        if verdict is not None:
            t_ns = NOWHERE_NS if self.zero_ns is None else newest.stamp_ns - self.zero_ns
            nan = math.nan
            return Reference(now_ns, newest.stamp_ns, t_ns, None, nan, nan, nan, nan, verdict, newest.sequence)
        self._is_new = False
        if newest.state != _OPERATIONAL:
            return self._hold(newest, now_ns)
        if self.zero_ns is None:
            return self._wait(newest, now_ns)
        return self._follow(newest, newest.stamp_ns - self.zero_ns, now_ns)

    def _hold(self, newest: RawSample, now_ns: int) -> Reference:
        """Ask for the measured angle: the first reference of the enable handshake."""
        theta_m_rad = self.sample.theta_m_rad
        self._open(now_ns)
        return self._through_gate(newest, NOWHERE_NS, now_ns, math.nan, 0.0, theta_m_rad)

    def _wait(self, newest: RawSample, now_ns: int) -> Reference:
        """Ask for the angle at which the drive became operational, whatever the load does meanwhile."""
        if self._waits_at_rad is None:
            self._waits_at_rad = self.sample.theta_m_rad
        return self._through_gate(newest, NOWHERE_NS, now_ns, math.nan, 0.0, self._waits_at_rad)

    def _follow(self, newest: RawSample, t_ns: int, now_ns: int) -> Reference:
        theta_j_rad = self._trajectory(t_ns * 1e-9)
        elongation_m = self.estimate.elongation_m if self._compensate else 0.0
        requested_rad = motor_reference_rad(theta_j_rad, elongation_m, self._plant)
        fade = self._fade
        if fade is None and math.isfinite(requested_rad):
            begin_rad = self.sample.theta_m_rad if self._waits_at_rad is None else self._waits_at_rad
            offset_rad = begin_rad - requested_rad
            if abs(offset_rad) > self.gate.range_rad:
                return self._deny(newest, t_ns, now_ns, theta_j_rad, elongation_m, requested_rad)
            fade = self._fade = _fade(offset_rad, t_ns, self._approach)
        if fade is not None and t_ns < fade.end_ns:
            requested_rad += fade.offset_rad * (1.0 - _smooth((t_ns - fade.begin_ns) / (fade.end_ns - fade.begin_ns)))
        return self._through_gate(newest, t_ns, now_ns, theta_j_rad, elongation_m, requested_rad)

    def _open(self, now_ns: int) -> None:
        self._was_opened = True
        self.gate.open(now_ns)

    def _deny(
        self, newest: RawSample, t_ns: int, now_ns: int, theta_j_rad: float, elongation_m: float, requested_rad: float
    ) -> Reference:
        self.verdict = code = int(Verdict.DENIED_TOO_FAR)
        self._count_denied()
        return Reference(
            now_ns, newest.stamp_ns, t_ns, None, theta_j_rad, elongation_m, requested_rad, math.nan, code,
            newest.sequence,
        )  # fmt: skip

    def _count_denied(self) -> None:
        self.denied_in_a_row += 1
        self.counters["denied"] += 1

    def _through_gate(
        self, newest: RawSample, t_ns: int, now_ns: int, theta_j_rad: float, elongation_m: float, requested_rad: float
    ) -> Reference:
        if not self._was_opened:  # the drive was OPERATIONAL before we came: begin where it is
            self._open(now_ns)
        passed_rad, verdict = self._pass(requested_rad, now_ns)
        if passed_rad is None:
            self._count_denied()
            self.gate_trip, self.is_latched = self.gate.trip, self.gate.state is GateState.LATCHED
            raw, passed_rad = None, math.nan
        else:
            self.denied_in_a_row = 0
            self.passed_stamp_ns = newest.stamp_ns
            self.counters["passed"] += 1
            raw = angle_raw_from_rad(passed_rad)
        if verdict is _PASSED:
            self.verdict = code = PASSED_CODE
        else:
            self.verdict = code = GATE_CODES[verdict]
            trip = self.gate.trip
            held_by = trip.check if verdict is _FROZEN and trip is not None else ""
            self.gate_tally.add(verdict, now_ns, abs(requested_rad - passed_rad), held_by)
        return make(Reference, (
            now_ns, newest.stamp_ns, t_ns, raw, theta_j_rad, elongation_m, requested_rad, passed_rad, code,
            newest.sequence,
        ))  # fmt: skip


class _Fade(NamedTuple):
    offset_rad: float
    begin_ns: int
    end_ns: int


def _fade(offset_rad: float, begin_ns: int, approach: Approach) -> _Fade:
    if abs(offset_rad) <= approach.tolerance_rad:
        return _Fade(0.0, begin_ns, begin_ns)
    duration_ns = round(PEAK_TO_MEAN_SPEED_RATIO * abs(offset_rad) / approach.speed_rad_per_s * 1e9)
    return _Fade(offset_rad, begin_ns, begin_ns + duration_ns)


def _smooth(s: float) -> float:
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))
