"""What shows under torque: enabling, holding, and one step of a degree at most."""

import math
from collections.abc import Sequence
from itertools import pairwise
from statistics import fmean, pstdev
from typing import Final

from firmware_protocol.conformance.findings import Inconclusive, Violation, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.states import HostPhase
from hil_forceps.bridge.drive_conformance.loop import Certain, Seen
from hil_forceps.bridge.drive_conformance.registry import Need, check
from hil_forceps.bridge.drive_conformance.session import Session
from hil_forceps.drives.supervision.direction import Direction, DirectionProbe

HOLD_NS: Final = 500 * MS
STEP_NS: Final = 500 * MS  # ten times what the reference takes
MAX_STEP_ERROR_SHARE: Final = 0.2  # of the step, short of it or beyond
MAX_OVERSHOOT_SHARE: Final = 0.5  # of the step
MIN_WORK_DEVIATIONS: Final = 4.0  # 3 of 100,000 by chance
MAX_STROKES: Final = 8  # out and back, until the sign is clear
STROKE_NS: Final = 300 * MS
CURRENT_LSB_A: Final = 2.0e-4


@check(40, Need.TORQUE)
def enabling_moves_nothing(s: Session) -> None:
    """From the request until a moment into operation."""
    begin_ns = s.now_ns()
    s.enable()
    s.tell("torque after", (s.now_ns() - begin_ns) / MS, "ms")
    s.hold(100 * MS)
    seen = s.since(begin_ns)
    furthest = max(seen, key=lambda each: abs(each.theta_rad - s.home_rad))
    s.bound(
        "angle moved by",
        s.degrees(abs(furthest.theta_rad - s.home_rad)),
        "deg",
        most=s.degrees(s.bounds.still_rad + s.noise_rad),
    )
    peak_A = max(abs(each.current_A) for each in seen)
    s.bound("peak current", peak_A * 1e3, "mA", most=s.bounds.load_current_A * 1e3)


@check(41, Need.TORQUE)
def holds(s: Session) -> None:
    """With references that stay where torque began."""
    s.enable()
    s.begin()
    s.hold(HOLD_NS)
    angles = [seen.theta_rad for seen in s.last(len(s.samples))]
    furthest_rad = max(abs(angle - s.home_rad) for angle in angles)
    s.bound("furthest", s.degrees(furthest_rad), "deg", most=s.degrees(s.bounds.still_rad + s.noise_rad))
    s.tell("noise of the current", pstdev(seen.current_A for seen in s.samples) * 1e3, "mA rms")


@check(50, Need.MOTION)
def goes_the_right_way(s: Session) -> None:
    """The probe ends the step at once where it goes wrong."""
    s.enable()
    s.hold(50 * MS)
    sign = s.step_sign()
    probe = DirectionProbe(s.bounds.step_rad, s.noise_rad)
    s.begin()

    def decided() -> bool:
        if s.newest is None or not s.references:
            return False
        return probe.see(s.references[-1].reference_rad, s.newest.theta_rad) is not Direction.UNDECIDED

    s.run(s.period_ns * 3, decided)  # where both start
    s.target_rad = s.home_rad + sign * s.bounds.step_rad
    s.run(STEP_NS, lambda: decided() or s.phase is not HostPhase.RUNNING)
    if probe.direction is not Direction.WITH:
        s.is_dangerous = True
        s.off_at_once()
        raise Certain(probe.words())
    s.note(
        f"{probe.words()}; if the jaw moved against the direction of `limits:`, change the sign of "
        "motor_driver.encoder_rev_per_pulley_rev"
    )


@check(51, Need.MOTION)
def follows_a_step(s: Session) -> None:
    """Out and back, each with time to settle."""
    s.enable()
    s.hold(50 * MS)
    sign, step_rad = s.step_sign(), s.bounds.step_rad
    allowed = s.degrees(max(MAX_STEP_ERROR_SHARE * step_rad, s.bounds.still_rad))
    s.begin()
    s.move(sign * step_rad, STEP_NS)
    off_rad = s.angle() - s.home_rad - sign * step_rad
    s.bound("off the step", s.degrees(off_rad), "deg", least=-allowed, most=allowed)
    beyond_rad = max(sign * (seen.theta_rad - s.home_rad) for seen in s.samples) - step_rad
    s.bound("beyond it", s.degrees(beyond_rad), "deg", most=s.degrees(MAX_OVERSHOOT_SHARE * step_rad))
    s.move(0.0, STEP_NS)
    s.bound("off the start", s.degrees(s.angle() - s.home_rad), "deg", least=-allowed, most=allowed)


@check(52, Need.MOTION)
def current_has_the_sign_of_the_torque(s: Session) -> None:
    """Over a closed way the motor does work against friction alone: the sum of i dθ can't be negative."""
    s.enable()
    s.hold(100 * MS)
    sign = s.step_sign()
    noise_A = max(pstdev(seen.current_A for seen in s.last(50)), s.noise_A, CURRENT_LSB_A)
    s.begin()
    deviations = 0.0
    for _ in range(MAX_STROKES):
        s.move(sign * s.bounds.step_rad, STROKE_NS)
        s.move(0.0, STROKE_NS)
        deviations = _work(s.samples, noise_A)
        if abs(deviations) >= MIN_WORK_DEVIATIONS:
            break
    if len({seen.current_A for seen in s.samples}) == 1:
        step_mA, friction_mA = s.promises.current_step_A * 1e3, s.bounds.friction_A * 1e3
        require(
            step_mA <= friction_mA, f"steps of {step_mA:.3g} mA are coarser than the {friction_mA:.2g} mA of friction"
        )
        raise Violation("the current is the same in every sample of a motion")
    s.bound("work against friction, in deviations of its noise", deviations, "", least=-MIN_WORK_DEVIATIONS)
    require(deviations >= MIN_WORK_DEVIATIONS, f"friction is too small: {s.evidence()}")


def _work(samples: Sequence[Seen], noise_A: float) -> float:
    """Return the sum of i dθ, in deviations of what noise makes of it."""
    offset_A = fmean(seen.current_A for seen in samples[-50:])
    ways = [(0.5 * (a.current_A + b.current_A) - offset_A, b.theta_rad - a.theta_rad) for a, b in pairwise(samples)]
    noise = noise_A * math.sqrt(sum(way * way for _, way in ways))
    return sum(current * way for current, way in ways) / noise if noise else 0.0


@check(101, Need.MOTION)
def takes_effect(s: Session) -> None:
    """How far the angle is behind the reference, at half a step."""
    s.enable()
    s.hold(50 * MS)
    sign = s.step_sign()
    s.begin()
    s.move(sign * s.bounds.step_rad, STEP_NS)
    half_rad = 0.5 * s.bounds.step_rad
    asked_ns = next((each.at_ns for each in s.references if sign * (each.reference_rad - s.home_rad) >= half_rad), None)
    done_ns = next((each.stamp_ns for each in s.samples if sign * (each.theta_rad - s.home_rad) >= half_rad), None)
    if asked_ns is None or done_ns is None:
        raise Inconclusive("half of the step was not reached")
    s.bound("angle behind the reference", (done_ns - asked_ns) / MS, "ms", most=s.service.silence_timeout_ns / MS)
