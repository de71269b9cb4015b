"""What is judged over a whole motion, or over all that has been done so far: limits and freshness."""

from collections.abc import Iterator
from typing import Final

from firmware_protocol.conformance.findings import Inconclusive, expect
from firmware_protocol.conformance.port import MS
from hil_forceps.bridge.drive_conformance.registry import Need, check
from hil_forceps.bridge.drive_conformance.session import Session

REQUESTED_STEPS: Final = 10.0  # the gate lets one pass
MOVE_NS: Final = 300 * MS
HOLD_NS: Final = 500 * MS
SPEED_WINDOW_NS: Final = 10 * MS  # a difference over less is noise of stamps
MIN_REFERENCES_PER_PERIOD: Final = 0.95


def _judge_extremes(s: Session) -> None:
    limits, seen, allowed = s.limits, s.extremes, s.bounds.still_rad + s.noise_rad
    expect(
        limits.position_min_rad <= seen.reference_low_rad and seen.reference_high_rad <= limits.position_max_rad,
        f"a reference of this suite left `limits:`: {seen}",
    )
    s.bound("lowest angle under torque", seen.theta_low_rad, "rad", least=limits.position_min_rad - allowed)
    s.bound("highest angle under torque", seen.theta_high_rad, "rad", most=limits.position_max_rad + allowed)


def _speeds(s: Session) -> Iterator[float]:
    """Yield speeds over windows, less what noise makes."""
    first = 0
    for last, each in enumerate(s.samples):
        while first < last and each.stamp_ns - s.samples[first + 1].stamp_ns >= SPEED_WINDOW_NS:
            first += 1
        span_ns = each.stamp_ns - s.samples[first].stamp_ns
        if span_ns >= SPEED_WINDOW_NS:
            yield (abs(each.theta_rad - s.samples[first].theta_rad) - s.noise_rad) / span_ns * 1e9


@check(90, Need.MOTION)
def within_limits(s: Session) -> None:
    """What the whole run has reached; then far more is asked for, there and back."""
    _judge_extremes(s)
    s.enable()
    s.hold(50 * MS)
    far_rad = s.step_sign() * REQUESTED_STEPS * s.bounds.step_rad
    s.begin_evidence()
    s.move(far_rad, MOVE_NS)
    s.move(0.0, MOVE_NS)
    _judge_extremes(s)
    s.bound("highest speed", max(_speeds(s), default=0.0), "rad/s", most=s.limits.speed_max_rad_per_s)


@check(100, Need.TORQUE)
def fresh_enough(s: Session) -> None:
    """The age counts from the sample's stamp to the reference's leaving."""
    s.enable()
    s.hold(50 * MS)
    s.begin()
    began_ns = s.now_ns()
    s.hold(HOLD_NS)
    if not s.references:
        raise Inconclusive("no reference was sent")
    ages_ms = sorted((each.at_ns - each.stamp_ns) / MS for each in s.references)
    s.tell("age of the sample, median", ages_ms[len(ages_ms) // 2], "ms")
    s.bound("worst", ages_ms[-1], "ms", most=s.limits.max_sample_age_s * 1e3)
    pace_ns = max(s.period_ns, round(s.sample_period_s * 1e9))
    share = len(s.references) / ((s.now_ns() - began_ns) / pace_ns)
    s.tell("ticks whose sample was too old", s.stale, "")
    s.bound("references a period", share, "", least=MIN_REFERENCES_PER_PERIOD)
