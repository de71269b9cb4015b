"""What shows without torque: who it is, how its samples come, and what they say at rest."""

from itertools import pairwise
from statistics import fmean, median, pstdev
from typing import Final

from firmware_protocol.conformance.findings import Violation, expect
from firmware_protocol.conformance.port import MS
from hil_forceps.bridge.drive_conformance.registry import Need, check
from hil_forceps.bridge.drive_conformance.session import Session
from hil_forceps.drives.promises import damage

LISTEN_NS: Final = 500 * MS
MIN_SAMPLE_PERIODS: Final = 50  # however slow the samples
MAX_RATE_ERROR_SHARE: Final = 0.02  # a few lost samples, and a clock: oscillators are better than 1 %
MAX_CLOCK_ERROR_SHARE: Final = 0.01  # between stamps and arrivals


@check(10, Need.LISTENING)
def is_identified(s: Session) -> None:
    """The service's own time counts; a drive of another kind, firmware or mode is refused by its machine."""
    if s.refusal:
        raise Violation(s.refusal)
    assert s.identified_ns is not None
    s.bound("identified within", s.identified_ns / 1e9, "s", most=s.service.connect_timeout_ns / 1e9)


def _listen(s: Session) -> None:
    s.run(max(LISTEN_NS, round(MIN_SAMPLE_PERIODS * s.sample_period_s * 1e9)))
    expect(len(s.samples) > 1, f"{len(s.samples)} samples arrived in {LISTEN_NS // MS} ms")


@check(20, Need.LISTENING)
def rate(s: Session) -> None:
    """A gap counts by arrival: two of the longest must not trip the watchdog."""
    _listen(s)
    period_ms = s.sample_period_s * 1e3
    arrivals = [seen.received_ns for seen in s.samples]
    gaps_ms = [(later - earlier) / MS for earlier, later in pairwise(arrivals)]
    allowed = MAX_RATE_ERROR_SHARE + 2.0 / len(gaps_ms)
    s.bound(
        "mean period",
        (arrivals[-1] - arrivals[0]) / MS / len(gaps_ms),
        "ms",
        least=period_ms * (1.0 - allowed),
        most=period_ms * (1.0 + allowed),
    )
    s.tell("median period", median(gaps_ms), "ms")
    silence_s = max(s.service.silence_timeout_ns * 1e-9, 20.0 * s.service.period_ns * 1e-9)
    longest_s = min(silence_s, s.watchdog_s / 2.0) if s.watchdog_s else silence_s
    s.bound("worst gap", max(gaps_ms), "ms", most=max(longest_s * 1e3, 3.0 * period_ms))


@check(21, Need.LISTENING)
def stamps(s: Session) -> None:
    """Stamps are the host's time, or mapped to it by the profile: so they go as fast as arrivals do."""
    _listen(s)
    pairs = list(pairwise(s.samples))
    s.bound("stamps that do not increase", sum(b.stamp_ns <= a.stamp_ns for a, b in pairs), "", most=0)
    arrived_ns = s.samples[-1].received_ns - s.samples[0].received_ns
    share = (s.samples[-1].stamp_ns - s.samples[0].stamp_ns) / arrived_ns
    allowed = MAX_CLOCK_ERROR_SHARE + 2.0 * (s.margins.line_ns + s.period_ns) / arrived_ns
    s.bound("stamps against arrivals", share, "", least=1.0 - allowed, most=1.0 + allowed)
    s.bound("stamps ahead of the arrival", sum(seen.stamp_ns > seen.received_ns for seen in s.samples), "", most=0)


@check(22, Need.LISTENING)
def nothing_is_damaged(s: Session) -> None:
    """The machine counts what it can't understand, can't pair, or finds too old."""
    before = damage(s.machine.counters, s.promises)
    _listen(s)
    grown = {name: n - before.get(name, 0) for name, n in damage(s.machine.counters, s.promises).items()}
    told = ", ".join(f"{name} {n}" for name, n in grown.items() if n)
    expect(not told, f"of {len(s.samples)} samples: {told}")
    s.tell("samples whole", len(s.samples), "")


@check(30, Need.LISTENING)
def rests(s: Session) -> None:
    """The offset of the current is judged by the share of the load's that it would be taken for."""
    _listen(s)
    angles, currents = [seen.theta_rad for seen in s.samples], [seen.current_A for seen in s.samples]
    bounds = s.bounds
    s.bound("current", fmean(currents) * 1e3, "mA", least=-bounds.no_current_A * 1e3, most=bounds.no_current_A * 1e3)
    s.tell("its noise", pstdev(currents) * 1e3, "mA rms")
    s.tell("its peak", max(map(abs, currents)) * 1e3, "mA")
    s.bound("range of the angle", s.degrees(max(angles) - min(angles)), "deg", most=s.degrees(bounds.rest_rad))
