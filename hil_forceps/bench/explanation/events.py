"""Events of a run in the order of time: one sentence for each stretch of ticks or samples of one kind."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.messages import DriveState, fault_words
from hil_forceps.bench.explanation.evidence import Evidence
from hil_forceps.bridge.pipeline import Verdict
from hil_forceps.control.gate import GateVerdict
from hil_forceps.data.recording.writer import Outcome

MAX_JOINED_GAP_NS = 50_000_000  # stretches of one kind with a shorter gap between them are joined
MIN_QUIET_TICKS = 3  # ticks in a row without a new sample that are an event; drift of the clocks causes one or two
MIN_APPROACH_RAD = 1e-9  # difference between reference and trajectory, far above rounding errors
MIN_UNHEARD_REFERENCES = 3  # references not confirmed by the drive; one or two are always in transit
STATE_WORDS = {
    DriveState.DISABLED: "DISABLED, without torque",
    DriveState.ARMED: "ARMED, waiting for the first reference",
    DriveState.OPERATIONAL: "OPERATIONAL, following references",
    DriveState.FAULT: "FAULT",
}
Mask = NDArray[np.bool_]


class Event(NamedTuple):
    """An event; time in s since the start of the run."""

    time_s: float
    kind: str
    text: str


def events_of(evidence: Evidence) -> list[Event]:
    """Return all events, oldest first."""
    sources: tuple[Callable[[Evidence], Iterator[Event]], ...] = (
        _stages, _states, _zero, _gate, _approach, _missing_samples, _ticks, _skipped_ticks, _unheard,
    )  # fmt: skip
    found = [event for source in sources for event in source(evidence)]
    return sorted(found, key=lambda event: event.time_s)


def unheard_references(evidence: Evidence) -> tuple[int, int] | None:
    """Return the number of references sent since the drive last confirmed one, and that time; None before the first."""
    samples = evidence.samples[evidence.samples["received_ns"] <= evidence.ended_ns]
    moved = np.flatnonzero(np.diff(samples["setpoint_sequence"].astype(np.int16)))
    if not moved.size:
        return None
    heard_ns = int(samples["received_ns"][moved[-1] + 1])
    sent = evidence.references[evidence.references["outcome"] == Outcome.SENT]["sent_ns"]
    return int(np.count_nonzero((sent > heard_ns) & (sent <= evidence.ended_ns))), heard_ns


def stretches(mask: Mask, times: NDArray[np.int64]) -> Iterator[tuple[int, int, int]]:
    """Yield first row, last row and number of rows of each stretch where `mask` is true; near stretches are joined."""
    rows = np.flatnonzero(mask)
    if not rows.size:
        return
    breaks = np.flatnonzero(np.diff(times[rows]) > MAX_JOINED_GAP_NS) + 1
    for part in np.split(rows, breaks):
        yield int(part[0]), int(part[-1]), len(part)


def _stages(evidence: Evidence) -> Iterator[Event]:
    words = {
        "connecting": "the service looks for the drive",
        "enabling": "the drive answers, and torque is requested",
        "running": "references follow the trajectory",
        "stopping": "the drive is requested to remove torque",
    }
    for time_ns, stage in evidence.stages:
        if stage in words:
            yield Event(evidence.time_s(time_ns), "stage", words[stage])


def _gate(evidence: Evidence) -> Iterator[Event]:
    """Yield the failed check of the gate that ended the run."""
    if evidence.gate_trip_ns is not None and evidence.fault is not None:
        check, unit = evidence.fault["check"], evidence.fault["unit"]
        value, limit = (evidence.fault[key] for key in ("value", "limit"))
        compared = "" if value is None or limit is None else f": {value:.4g} {unit}, the limit is {limit:.4g} {unit}"
        yield Event(evidence.time_s(evidence.gate_trip_ns), "gate", f"the gate's check {check} fails{compared}")


def _states(evidence: Evidence) -> Iterator[Event]:
    samples = evidence.samples
    if not len(samples):
        return
    both = samples["state"].astype(np.int64) * 256 + samples["fault"]
    changes = np.flatnonzero(both[1:] != both[:-1])
    for place, row in enumerate([0, *(changes + 1).tolist()]):
        state, fault = int(samples["state"][row]), int(samples["fault"][row])
        words = STATE_WORDS.get(DriveState(state), "") if state in set(DriveState) else f"state {state}"
        if state == DriveState.FAULT:
            words += f": {_fault_words(evidence, fault)}"
        first = "the first sample that was kept" if evidence.is_second else "the first sample arrives"
        begin = "state of the drive:" if place else f"{first}; state of the drive:"
        yield Event(evidence.time_s(int(samples["received_ns"][row])), "state", f"{begin} {words}")


def _fault_words(evidence: Evidence, fault: int) -> str:
    """Return the name of a fault, in the maker's words if fault.json has them."""
    if evidence.profile == "native":
        return fault_words(fault)
    if evidence.fault is not None:
        return str(evidence.fault["drive"].get("fault", ""))
    return f"see the message below, and the documents of {evidence.profile}"


def _zero(evidence: Evidence) -> Iterator[Event]:
    rows = np.flatnonzero(evidence.samples["stamp_ns"] == (-1 if evidence.zero_ns is None else evidence.zero_ns))
    if rows.size:
        time_s = evidence.time_s(int(evidence.samples["received_ns"][rows[0]]))
        yield Event(time_s, "zero", "zero: the time of trajectory and load counts from here")


def _approach(evidence: Evidence) -> Iterator[Event]:
    """Yield the approach: how far the reference is from the compensated trajectory (10), and for how long."""
    references = evidence.references
    rows = np.flatnonzero((references["trajectory_ns"] >= 0) & np.isfinite(references["requested_rad"]))
    if evidence.rig is None or not rows.size:
        return
    plant = evidence.rig.plant()
    jaw_m = plant.jaw_pulley_radius_m * references["theta_j_ref_rad"][rows]
    wanted = (jaw_m + references["elongation_used_m"][rows]) / plant.motor_pulley_radius_m  # (10)
    added = references["requested_rad"][rows] - wanted
    moving = np.abs(added) > MIN_APPROACH_RAD
    if not moving[0]:
        return
    end = int(np.argmin(moving)) if not moving.all() else len(rows) - 1
    begin_ns, end_ns = (int(references["tick_ns"][rows[row]]) for row in (0, end))
    over = "" if not moving.all() else ", and the approach is not over at the end"
    yield Event(
        evidence.time_s(begin_ns),
        "approach",
        f"approach: the motor is {float(added[0]):+.4f} rad from the trajectory; "
        f"the difference is removed in {(end_ns - begin_ns) / 1e9:.3f} s{over}",
    )


def _missing_samples(evidence: Evidence) -> Iterator[Event]:
    samples = evidence.samples
    if len(samples) < 2:
        return
    times = samples["received_ns"]
    sequences = samples["sequence"].astype(np.int64)
    jumps = (sequences[1:] - sequences[:-1] - 1) % 256
    for first, last, _ in stretches(jumps > 0, times[:-1]):
        count = int(jumps[first : last + 1].sum())
        text = f"{_number(count, 'sample')} of the drive are missing, by their sequence numbers"
        yield Event(evidence.time_s(int(times[first])), "missing samples", text)


def _ticks(evidence: Evidence) -> Iterator[Event]:
    references = evidence.references
    running = references["trajectory_ns"] >= 0
    for code in np.unique(references["verdict"]).tolist():
        mask = running & (references["verdict"] == code)
        text = _verdict_words(code, evidence.verdicts.get(code, f"verdict {code}"))
        if text:
            yield from _told(evidence, mask, text, MIN_QUIET_TICKS if code == Verdict.NOTHING_NEW else 1)
    for outcome, text in ((Outcome.QUEUE_FULL, "with a full send queue, so that {its} was not sent"),
                          (Outcome.BUS_DOWN, "with the bus down, so that {its} was not sent")):  # fmt: skip
        yield from _told(evidence, references["outcome"] == outcome, text, 1)


def _told(evidence: Evidence, mask: Mask, text: str, least: int) -> Iterator[Event]:
    """Yield an event for each stretch; in `text` `{its}` means the references of its ticks, `{lasts}` its time."""
    times = evidence.references["tick_ns"]
    for first, last, count in stretches(mask, times):
        if count >= least:
            its = "its reference" if count == 1 else "their references"
            lasts = f"{(times[last] - times[first]) / 1e9:.3f} s"
            told = f"{_number(count, 'tick')} {text.format(its=its, lasts=lasts)}"
            yield Event(evidence.time_s(int(times[first])), "ticks", told)


def _verdict_words(code: int, name: str) -> str:
    """Return the text for ticks with this verdict; empty if they are no event."""
    if name == GateVerdict.FROZEN.name:
        return "with {its} held at the last value for {lasts}, because a check of the gate fails"
    if name == GateVerdict.DENIED_LATCHED.name:
        return "with {its} denied: the gate has latched, because the check failed for longer than the gate holds"
    if code == Verdict.NOTHING_NEW:
        return "without a new sample, so that no reference was sent"
    if code == Verdict.STALE:
        return "without a sample younger than limits.max_sample_age_s, so that no reference was sent"
    if name.startswith("LIMITED_"):
        return f"with {{its}} limited by the gate ({name[8:].lower()})"
    return f"with {{its}} denied ({name})" if name.startswith("DENIED_") else ""


def _skipped_ticks(evidence: Evidence) -> Iterator[Event]:
    times = evidence.references["tick_ns"]
    if len(times) < 3:
        return
    steps = np.diff(times)
    period = float(np.median(steps))
    if period <= 0.0:
        return
    for first, last, _ in stretches(steps > 1.5 * period, times[:-1]):
        skipped = int(np.round(steps[first : last + 1] / period - 1.0).sum())
        longest_ms = float(steps[first : last + 1].max()) / 1e6
        text = f"this host was late: {_number(skipped, 'tick')} skipped, longest pause {longest_ms:.1f} ms"
        yield Event(evidence.time_s(int(times[first])), "overruns", text)


def _unheard(evidence: Evidence) -> Iterator[Event]:
    found = unheard_references(evidence)
    if found is not None and found[0] >= MIN_UNHEARD_REFERENCES and evidence.profile == "native":
        text = f"the drive accepts its last reference; the {found[0]} sent after it did not arrive, or were refused"
        yield Event(evidence.time_s(found[1]), "unheard", text)


def _number(count: int, what: str) -> str:
    return f"1 {what}" if count == 1 else f"{count} {what}s"
