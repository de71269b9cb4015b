"""What may be behind the end of a run, the likeliest first, and what to check.

What the recording shows goes first: a host that was late, samples that were too old, references that the drive's echo
doesn't show. Then what the reason, or the drive's own words, may come from.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hil_forceps.bench.explanation.events import MIN_UNHEARD_REFERENCES, Event, unheard_references
from hil_forceps.bench.explanation.evidence import Evidence
from hil_forceps.bridge.logs.flight_recorder import RECORDED_BEFORE_FAULT_NS
from hil_forceps.bridge.pipeline import Verdict
from hil_forceps.bridge.results import AS_MEANT

LATE_WINDOW_NS = 50_000_000  # before the end: longer than a watchdog waits that is fed at 1 kHz


class Cause(NamedTuple):
    """One that is likely, and what to look at."""

    cause: str
    check: str


_WATCHDOG = Cause(
    "fresh references did not reach the drive in its watchdog's time",
    "the wiring and the bus load (hil-forceps check RIG.yaml), and the drive's watchdog against bench.host_period_s",
)
# By words in what the drive says of its fault: the makers' and the project's own.
_BY_WORDS: tuple[tuple[str, Cause], ...] = (
    ("watchdog|timeout|heard nothing|heartbeat", _WATCHDOG),
    (
        "overcurrent|current limit|over current|phase current|overload",
        Cause(
            "the motor drew more current than the drive allows: the jaw is blocked, or the loop is set too stiff",
            "whether the jaw moves freely by hand; the drive's current limit and gains against drive: of the rig",
        ),
    ),
    (
        "supply|voltage|brownout",
        Cause(
            "the supply's voltage left its range, by a weak supply or by what a braking motor feeds back",
            "the supply's voltage under load, its current limit, and the drive's limits for both",
        ),
    ),
    (
        "temperature|overheat|overtemperature",
        Cause("the drive or the motor became too hot", "cooling, the mean current, and the drive's limits"),
    ),
    (
        "encoder|estimator|spinout|commutation|hall",
        Cause(
            "the drive no longer knows the motor's angle",
            "the encoder's cable and magnet, and the drive's calibration",
        ),
    ),
    (
        "REFERENCE_POSITION|REFERENCE_RATE|following error|limit",
        Cause(
            "the drive's own limits are narrower than those of the rig",
            "limits: of the rig against the drive's; hil-forceps check RIG.yaml",
        ),
    ),
    (
        "ESTOP|emergency stop",
        Cause("somebody stopped the drive: a button, or another program on the bus", "the emergency stop's circuit"),
    ),
    ("BUS_OFF", Cause("the drive's bus controller gave up", "bit rate, termination and cable of the bus")),
)
_BY_REASON: dict[str, tuple[Cause, ...]] = {
    "no_drive": (
        Cause("the drive has no power, or another node id, bit rate or port", "hil-forceps scan tells who is there"),
        Cause("the cable or the termination", "the wiring; frames of others in bus.log (hil-forceps decode)"),
    ),
    "version_refused": (Cause("drive and host speak different versions", "the drive's firmware, and motor_driver:"),),
    "enable_failed": (
        Cause("the angle at rest lies outside limits:", "theta_m_rad in the table against limits: of the rig"),
        Cause("the drive does not accept references", "what it says in bus.log (hil-forceps decode)"),
    ),
    "drive_lost": (
        Cause("the drive lost power or restarted", "its supply, and whether it counts from zero again"),
        Cause("the cable came loose", "plugs and termination"),
        Cause("this host's adapter stopped", "the system's log (dmesg), and another port"),
    ),
    "drive_stopped": (
        Cause("another program or a person disabled the drive", "who else is on the bus; the drive's enable input"),
    ),
    "reference_denied": (
        Cause("the trajectory or the estimate asks for what limits: forbid", "requested and passed in the table"),
        Cause("the loop paused longer than the gate lets pass", "other load on this host"),
    ),
    "feedback_implausible": (
        Cause("the encoder, its cable or its coupling to the motor", "theta_m_rad and current_A in the table"),
        Cause("the motor is blocked, by the jaw or by a wire off its pulley", "whether it turns freely without torque"),
        Cause("the rig says less of the motor than is true", "docs/safety-gate.md: the numbers that a check takes"),
    ),
    "gate_latched": (
        Cause("the load, or friction, asks for more than limits: allow", "the check above, and what the jaw holds"),
    ),
    "bus_down": (
        Cause("the adapter was unplugged, or its interface went down", "cable and `ip -details link show`"),
        Cause("the controller went off the bus after too many errors", "bit rate, termination, and who else sends"),
    ),
    "recording_failed": (Cause("the disk is full, or gone", "df and the file system's state"),),
    "reference_lost": (
        Cause("the sender of references stopped, or the network lost them", "the sender, and `outside` in run.json"),
        Cause("another program has the port or the axis", "other_sender and wrong_session in run.json"),
    ),
    "emergency_stop": (
        Cause("an operator pressed the emergency stop of the live page", "what that was for, before the next run"),
    ),
    "other_axis": (Cause("another axis failed, and all are stopped then", "hil-forceps explain of that axis"),),
    "crashed": (Cause("a fault of this program", "please report it, with fault.json"),),
    "": (
        Cause("the program was killed, or the power failed, before it could end the recording",
              "hil-forceps recover says what is missing; `dmesg` whether memory ran out"),
    ),
}  # fmt: skip
_DAMAGED = Cause(
    "the file was changed after the run: it was ended as it should, and its end can't be reached any more",
    "hil-forceps recover tells what can't be read, and reads the end behind it; the disk, and how the file was copied",
)
_WELL = frozenset(reason.value for reason in AS_MEANT)
_UNKNOWN_FAULT = Cause("what the maker says of this fault", "the drive's manual, by the words above")


def causes_of(evidence: Evidence, events: list[Event]) -> list[Cause]:
    """Return them; none for a run that ended as it was meant to."""
    if evidence.reason in _WELL:
        return []
    found = list(_seen(evidence, events))
    if evidence.reason == "drive_fault":
        matching = [cause for words, cause in _BY_WORDS if re.search(words, evidence.message, re.IGNORECASE)]
        found += matching[:1] or [_UNKNOWN_FAULT]
    found += [_DAMAGED] if not evidence.reason and evidence.is_damaged else _BY_REASON.get(evidence.reason, ())
    return list(dict.fromkeys(found))


def _seen(evidence: Evidence, events: list[Event]) -> Iterator[Cause]:
    """Yield what the last moments before the end show."""
    late_s = evidence.time_s(evidence.ended_ns - LATE_WINDOW_NS)
    if any(event.kind == "overruns" and event.time_s >= late_s for event in events):
        yield Cause(
            "this host was late: the loop paused just before the end",
            "other load on this machine; chrt and a CPU of its own for hil-forceps run",
        )
    references = evidence.references[evidence.references["tick_ns"] >= evidence.ended_ns - LATE_WINDOW_NS]
    takes_samples = evidence.reason in {"drive_fault", "enable_failed", "reference_denied"}
    if takes_samples and len(references) and np.mean(references["verdict"] == Verdict.STALE) > 0.5:
        yield Cause(
            "samples came too late: most of the last references stayed away",
            "limits.max_sample_age_s against bench.latency_s, the adapter's own delay and the drive's rates",
        )
    gaps = {code for code, name in evidence.verdicts.items() if name == "DENIED_GAP"}
    if np.isin(references["verdict"], list(gaps)).any():
        yield Cause(
            "no reference passed for longer than the gate allows: samples stayed away, or the loop paused",
            "missing samples and ticks left out just before the end; then the wiring, or other load on this host",
        )
    unheard = unheard_references(evidence)
    if (
        evidence.profile == "native"
        and unheard is not None
        and unheard[0] >= MIN_UNHEARD_REFERENCES
        and len(evidence.samples)
    ):
        newest_ns = int(evidence.samples["received_ns"][-1])
        if newest_ns >= evidence.ended_ns - RECORDED_BEFORE_FAULT_NS and evidence.reason == "drive_fault":
            yield Cause(
                f"{unheard[0]} references left this host, and the drive's samples show none of them",
                "the way from host to drive: bus load, arbitration ids of others, the adapter's sending",
            )
