"""Time and measurements: HFP-050 to HFP-052, HFP-055, HFP-056."""

from itertools import pairwise

from firmware_protocol.conformance.checks.frames import walk
from firmware_protocol.conformance.findings import Inconclusive, expect, require
from firmware_protocol.conformance.port import MS
from firmware_protocol.conformance.probe import Sample
from firmware_protocol.conformance.registry import Need, check
from firmware_protocol.conformance.session import Session
from firmware_protocol.frames import Frame, arbitration_id
from firmware_protocol.messages import DriveState
from firmware_protocol.scales import unwrap

MEASURED_SAMPLES = 200
NOBODY = arbitration_id(0x01, 31)  # more urgent than any measurement, and nobody's
MAX_CLOCK_ERROR_PPM = 100  # HFP-052
MIN_RATE_SHARE = 0.9  # of the measurements that should come, on a line that may lose some


def stamps_us(samples: list[Sample]) -> list[int]:
    """Return the stamps without their wrap."""
    stamps = [samples[0].stamp_us]
    for sample in samples[1:]:
        stamps.append(unwrap(sample.stamp_us, stamps[-1], 1 << 32))
    return stamps


def _collect(s: Session, duration_ns: int) -> list[Sample]:
    begin = len(s.samples)
    s.run(duration_ns)
    samples = s.samples[begin:]
    require(len(samples) > MEASURED_SAMPLES // 4, f"{len(samples)} measurements only")
    return samples


@check(50)
def stamps_keep_their_grid_under_load(s: Session) -> str:
    begin = len(s.samples)
    for _ in range(MEASURED_SAMPLES):
        s.send(Frame(NOBODY, bytes(8)))
        s.run(s.period_ns)
    samples = s.samples[begin:]
    require(len(samples) > MEASURED_SAMPLES // 2, "too few measurements")
    stamps = stamps_us(samples)
    numbers = [0]
    for before, after in pairwise(samples):
        numbers.append(numbers[-1] + ((after.sequence - before.sequence) & 0xFF))
    period_us = (stamps[-1] - stamps[0]) / numbers[-1]
    off = sorted(abs(t - stamps[0] - n * period_us) for t, n in zip(stamps, numbers, strict=True))
    typical_us = off[len(off) * 9 // 10]
    return s.timing("stamp off its grid, 90 %", round(typical_us * 1000), 0, s.margins.stamp_ns)


@check(51, last=True)
def stamps_count_us_and_never_jump(s: Session) -> str:
    walk(s)
    samples = _collect(s, 1_000 * MS)
    stamps = stamps_us(samples)
    passed_us = (samples[-1].time_ns - samples[0].time_ns) / 1000
    share = (stamps[-1] - stamps[0]) / passed_us
    expect(abs(share - 1.0) < 0.02, f"the stamps count {share:.4f} for each us")
    findings = s.monitor.findings(51)
    expect(not findings, findings)
    return "no jump in any state, through faults and changes of node"


@check(52)
def clock_accuracy(s: Session) -> str:
    """Earliest arrival of each tenth of the run against its stamp: what the line delays only ever adds."""
    samples = _collect(s, 2_000 * MS if s.virtual else 12_000 * MS)
    stamps = stamps_us(samples)
    size = len(samples) // 10
    points = []
    for begin in range(0, size * 10, size):
        late = [(samples[i].time_ns / 1000 - stamps[i], stamps[i]) for i in range(begin, begin + size)]
        points.append(min(late))
    slopes = sorted((b[0] - a[0]) / (b[1] - a[1]) * -1e6 for i, a in enumerate(points) for b in points[i + 5 :])
    middle, spread = slopes[len(slopes) // 2], (slopes[-1] - slopes[0]) / 2
    said = f"{middle:+.1f} ppm, known to {spread:.1f} ppm, of the host's clock"
    if abs(middle) + spread <= MAX_CLOCK_ERROR_PPM:
        return said
    if abs(middle) - spread <= MAX_CLOCK_ERROR_PPM:
        raise Inconclusive(said)
    expect(False, said)
    return said


def _rate(s: Session, state: DriveState) -> None:
    begin = len(s.samples)
    duration_ns = 100 * s.period_ns
    s.run(duration_ns)
    got = len(s.samples) - begin
    wanted = 99 if s.virtual else round(100 * MIN_RATE_SHARE)
    expect(got >= wanted, f"{got} measurements in 100 periods in {state.name}")


@check(55)
def measurements_in_every_state(s: Session) -> str:
    s.run(20 * s.period_ns)
    _rate(s, DriveState.DISABLED)
    s.arm()
    _rate(s, DriveState.ARMED)
    s.disable()
    s.fail()
    _rate(s, DriveState.FAULT)
    s.reset()
    return "measured each period in DISABLED, ARMED and FAULT"


@check(55, Need.MOTION)
def measurements_in_operational(s: Session) -> str:
    s.operate()
    _rate(s, DriveState.OPERATIONAL)
    return "measured each period in OPERATIONAL"


@check(56)
def sent_within_a_period(s: Session) -> str:
    """The least delay can't be known from outside; what is later than that by more than a period is too late."""
    samples = _collect(s, MEASURED_SAMPLES * s.period_ns)
    delays = sorted(a.time_ns - 1000 * b for a, b in zip(samples, stamps_us(samples), strict=True))
    worst = delays[-1] if s.virtual else delays[len(delays) * 98 // 100]
    return s.timing("later than the promptest", worst - delays[0], 0, s.period_ns + s.margins.line_ns)
