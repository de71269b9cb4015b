"""Whether the motor's angle and current can be what they are told to be. No clock: stamps come with the samples.

Each sample: a jump. Each block of eight: the rest, from the mean current of a block without its least and greatest, so
that no single sample trips anything.

A motor that stands still is no fault, and neither is one that pushes against its load. Frozen means: not a bit of the
angle has changed for `still_s`, and since then the reference has moved by many counts while the current has changed by
half of what the drive has, the way of the reference; or the reference has moved so far that any drive would have given
all its torque.
"""

from collections.abc import Callable
from typing import Final, NamedTuple

from hil_forceps.control.gate.bounds import FeedbackBounds
from hil_forceps.control.gate.kernel import Vector, kernel
from hil_forceps.control.gate.trip import AGAINST, CURRENT, JUMP, STILL, TENSION, GateTrip
from hil_forceps.rig.plant import PlantParameters

# 8 ms at 1 kHz, well within the 60 ms that the shipped drives' loops take for a load step.
BLOCK_SAMPLES: Final = 8


class Block(NamedTuple):
    """Eight samples, and what came before them."""

    speed_rad_per_s: float  # mean
    acceleration_rad_per_s2: float  # between the middle of the block before and of this one
    current_A: float  # mean
    still_s: float  # for how long the angle has been the same; 0 where it changed in this block
    reference_travel_rad: float  # since then
    current_change_A: float  # since then
    against_rad: float  # travel against a strong current, without a break


Finding = tuple[str, float, float, str]  # check, value, limit, unit


def tension_N(block: Block, plant: PlantParameters) -> float:
    """Return the tension that the motor's torque is left for: (K_t i − I_m α − D_m ω − τ_Fm sgn ω) / r_m."""
    speed = block.speed_rad_per_s
    direction = (speed > 0.0) - (speed < 0.0)
    torque = (
        plant.torque_constant_N_m_per_A * block.current_A
        - plant.motor_inertia_kg_m2 * block.acceleration_rad_per_s2
        - plant.motor_viscous_N_m_s_per_rad * speed
        - plant.motor_coulomb_N_m * direction
    )
    return torque / plant.motor_pulley_radius_m


def _still(block: Block, bounds: FeedbackBounds) -> Finding | None:
    travel = block.reference_travel_rad
    if block.still_s < bounds.still_s:
        return None
    if abs(travel) > bounds.still_travel_alone_rad:
        return STILL, abs(travel), bounds.still_travel_alone_rad, "rad"
    pushed = block.current_change_A if travel > 0.0 else -block.current_change_A
    if abs(travel) > bounds.still_travel_rad and pushed > bounds.strong_A:
        return STILL, abs(travel), bounds.still_travel_rad, "rad"
    return None


def _against(block: Block, bounds: FeedbackBounds) -> Finding | None:
    if block.against_rad > bounds.against_travel_rad:
        return AGAINST, block.against_rad, bounds.against_travel_rad, "rad"
    return None


def _current(block: Block, bounds: FeedbackBounds) -> Finding | None:
    if abs(block.current_A) > bounds.current_max_A:
        return CURRENT, abs(block.current_A), bounds.current_max_A, "A"
    return None


def _tension(block: Block, bounds: FeedbackBounds) -> Finding | None:
    tension = abs(tension_N(block, bounds.plant))
    return (TENSION, tension, bounds.tension_max_N, "N") if tension > bounds.tension_max_N else None


def is_jump(turned_rad: float, furthest_rad: float) -> bool:
    """Tell whether the angle turns further than it can; NaN is a jump, too."""
    return not abs(turned_rad) <= furthest_rad


_is_jump: Final = kernel(is_jump)


@kernel
def samples_without_jump(before_rad: float, theta_rad: Vector, furthest_rad: float) -> int:
    """Return how many samples in a row turn by `furthest_rad` at most from one to the next."""
    for sample in range(theta_rad.shape[0]):
        turned = theta_rad[sample] - before_rad
        if turned != 0.0 and _is_jump(turned, furthest_rad):
            return sample
        before_rad = theta_rad[sample]
    return len(theta_rad)


CHECKS: Final[tuple[Callable[[Block, FeedbackBounds], Finding | None], ...]] = (_still, _against, _current, _tension)


def judge(block: Block, bounds: FeedbackBounds) -> Finding | None:
    """Return the first check that a block does not pass."""
    for check in CHECKS:
        found = check(block, bounds)
        if found is not None:
            return found
    return None


class FeedbackMonitor:
    """Collects samples into blocks; `finding` is what the last check said."""

    __slots__ = (
        "_against_rad", "_begin", "_bounds", "_currents", "_has_moved", "_rad_per_ns", "_slack_rad", "_speed", "_still",
        "_theta_rad", "_time_ns", "finding",
    )  # fmt: skip

    def __init__(self, bounds: FeedbackBounds) -> None:
        self._bounds = bounds
        self._rad_per_ns, self._slack_rad = bounds.jump_speed_rad_per_s * 1e-9, bounds.jump_slack_rad

    def restart(self, stamp_ns: int, theta_rad: float) -> None:
        """Begin, or begin anew, at a sample: forget all but where the motor is."""
        self.finding: Finding | None = None
        self._time_ns, self._theta_rad = stamp_ns, theta_rad
        self._begin = (stamp_ns, theta_rad)  # of the block
        self._currents: list[float] = []
        self._has_moved = True  # so that the first block says since when it stands still
        self._speed: tuple[float, float] | None = None  # mean, and duration, of the block before
        self._against_rad = 0.0

    def see(self, stamp_ns: int, theta_rad: float, current_A: float, reference_rad: float) -> bool:
        """Take the next sample, with a later stamp; True when `finding` has been decided anew."""
        turned = theta_rad - self._theta_rad
        if turned:
            self._has_moved = True
            furthest = self._rad_per_ns * (stamp_ns - self._time_ns) + self._slack_rad
            if is_jump(turned, furthest):
                self.finding = JUMP, abs(turned), furthest, "rad"
                return True
            self._theta_rad = theta_rad
        self._time_ns = stamp_ns
        currents = self._currents
        currents.append(current_A)
        if len(currents) < BLOCK_SAMPLES:
            return False
        self._end_block(reference_rad)
        return True

    def samples_without_jump(self, period_ns: int, theta_rad: Vector) -> int:
        """Return how many samples in a row, `period_ns` apart, are no jump."""
        return samples_without_jump(self._theta_rad, theta_rad, self._rad_per_ns * period_ns + self._slack_rad)

    def follow(self, period_ns: int, theta_rad: list[float], current_A: list[float], reference_rad: list[float]) -> int:
        """Take samples that are no jump, `period_ns` apart; return how many.

        The first that ends a block with a finding is the last. `reference_rad`: of each sample, as `see` has it.
        """
        taken = 0
        while taken < len(theta_rad):
            end = min(taken + BLOCK_SAMPLES - len(self._currents), len(theta_rad))
            angles = theta_rad[taken:end]
            self._has_moved = self._has_moved or angles.count(self._theta_rad) < len(angles)
            self._theta_rad = angles[-1]
            self._time_ns += period_ns * len(angles)
            self._currents += current_A[taken:end]
            taken = end
            if len(self._currents) == BLOCK_SAMPLES:
                self._end_block(reference_rad[end - 1])
                if self.finding is not None:
                    break
        return taken

    def _end_block(self, reference_rad: float) -> None:
        begin_ns, begin_rad = self._begin
        turned, duration_s = self._theta_rad - begin_rad, (self._time_ns - begin_ns) * 1e-9
        current = sum(sorted(self._currents)[1:-1]) / (BLOCK_SAMPLES - 2)
        speed = turned / duration_s
        acceleration = 0.0
        if self._speed is not None:
            before, before_s = self._speed
            acceleration = 2.0 * (speed - before) / (duration_s + before_s)
        if self._has_moved:
            self._still = (self._time_ns, reference_rad, current)  # since when, with the reference and current of then
        since_ns, reference_then, current_then = self._still
        is_against = turned * current < 0.0 and abs(current) > self._bounds.strong_A
        self._against_rad = self._against_rad + abs(turned) if is_against else 0.0
        block = Block(
            speed,
            acceleration,
            current,
            (self._time_ns - since_ns) * 1e-9,
            reference_rad - reference_then,
            current - current_then,
            self._against_rad,
        )
        self._begin, self._speed = (self._time_ns, self._theta_rad), (speed, duration_s)
        self._has_moved = False
        self._currents.clear()
        self.finding = judge(block, self._bounds)


def trip_of(finding: Finding, time_ns: int) -> GateTrip:
    """Return a finding with its time."""
    return GateTrip(*finding, time_ns)
