"""Likely causes of the end of a run, the most likely first, and what to check.

First come causes that the recording shows: a late host, samples that were too old, references that the drive did not
confirm. Then come the usual causes of the stop reason or of the drive's fault.
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

LATE_WINDOW_NS = 50_000_000  # before the end; longer than the watchdog of a drive with references at 1 kHz


class Cause(NamedTuple):
    """A likely cause, and what to check."""

    cause: str
    check: str


_WATCHDOG = Cause(
    "fresh references did not reach the drive in its watchdog's time",
    "the wiring, the bus load (hil-forceps check RIG.yaml), and whether the watchdog is long enough for "
    "bench.host_period_s",
)
# By words in the fault message of a drive, of the makers and of the project's protocol.
_BY_WORDS: tuple[tuple[str, Cause], ...] = (
    ("watchdog|timeout|heard nothing|heartbeat", _WATCHDOG),
    (
        "overcurrent|current limit|over current|phase current|overload",
        Cause(
            "the motor needed more current than the drive allows: the jaw is blocked, or the gains of the position "
            "loop are too high",
            "whether the jaw moves freely by hand; whether current limit and gains of the drive agree with drive: "
            "of the rig",
        ),
    ),
    (
        "supply|voltage|brownout",
        Cause(
            "the supply voltage left its range: the supply is too weak, or the braking motor feeds energy back",
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
            "the drive lost the angle of the motor",
            "the encoder's cable and magnet, and the drive's calibration",
        ),
    ),
    (
        "REFERENCE_POSITION|REFERENCE_RATE|following error|limit",
        Cause(
            "the drive's own limits are narrower than those of the rig",
            "whether limits: of the rig are within those of the drive; hil-forceps check RIG.yaml",
        ),
    ),
    (
        "ESTOP|emergency stop",
        Cause("the drive was stopped by a button or by another program on the bus", "the emergency stop's circuit"),
    ),
    ("BUS_OFF", Cause("the bus controller of the drive is bus-off", "bit rate, termination and cable of the bus")),
)
_REVERSED = Cause(
    "encoder and motor have opposite directions",
    "the first motion without load: hil-forceps conformance --allow-motion",
)
_BY_REASON: dict[str, tuple[Cause, ...]] = {
    "no_drive": (
        Cause(
            "the drive has no power, or another node id, bit rate or port",
            "hil-forceps scan lists the drives on the line",
        ),
        Cause(
            "the cable or the termination",
            "the wiring; whether bus.log has frames of other devices (hil-forceps decode)",
        ),
    ),
    "version_refused": (
        Cause("drive and host have different protocol versions", "the drive's firmware, and motor_driver:"),
    ),
    "enable_failed": (
        Cause("the angle at rest is outside limits:", "theta_m_rad in the table, compared with limits: of the rig"),
        Cause("the drive does not accept references", "the answers of the drive in bus.log (hil-forceps decode)"),
    ),
    "drive_lost": (
        Cause("the drive lost power or restarted", "its supply, and whether its counters begin at zero again"),
        Cause("a cable is disconnected", "connectors and termination"),
        Cause("the bus adapter of this host failed", "the system's log (dmesg); try another port"),
    ),
    "drive_stopped": (
        Cause("another program or a person disabled the drive", "other devices on the bus; the drive's enable input"),
    ),
    "reference_denied": (
        Cause("the trajectory or the compensation exceeds limits:", "the columns asked and passed in the table"),
        Cause("the loop paused for longer than the gate allows", "other load on this host"),
    ),
    "feedback_implausible": (
        Cause(
            "a fault of the encoder, its cable or its coupling to the motor", "theta_m_rad and current_A in the table"
        ),
        Cause("the motor is blocked, by the jaw or by a wire off its pulley", "whether it turns freely without torque"),
        Cause(
            "the rig file has too small a value for the motor, such as its friction or inertia",
            "the values that each check uses (docs/safety-gate.md)",
        ),
    ),
    "gate_latched": (
        Cause("the load or friction needs more than limits: allow", "the check above, and the load on the jaw"),
    ),
    "following_error": (
        Cause(
            "a load for which the drive's position loop is too soft", "the load on the jaw, and current_A in the table"
        ),
        _REVERSED,
        Cause("the reference is faster than the drive", "the trajectory, and the current limit of the drive"),
    ),
    "runaway": (
        _REVERSED,
        Cause("a load that is larger than the motor's torque", "current_A in the table, and the load on the jaw"),
    ),
    "bus_down": (
        Cause("the adapter was unplugged, or its interface is down", "cable and `ip -details link show`"),
        Cause("the controller is bus-off after too many errors", "bit rate, termination, and other senders"),
    ),
    "recording_failed": (
        Cause("the disk is full or was removed", "the free space (df) and the state of the file system"),
    ),
    "reference_lost": (
        Cause("the sender of references stopped, or the network lost them", "the sender, and `outside` in run.json"),
        Cause("another program uses the port or sends to the axis", "other_sender and wrong_session in run.json"),
    ),
    "emergency_stop": (
        Cause(
            "an operator pressed the emergency stop of the live page", "the reason for the stop, before the next run"
        ),
    ),
    "other_axis": (Cause("another axis failed, and then all axes are stopped", "hil-forceps explain of that axis"),),
    "crashed": (Cause("an error of this program", "please report it, with fault.json"),),
    "": (
        Cause(
            "the program was killed, or the power failed, before it could end the recording",
            "hil-forceps recover lists what is missing; `dmesg` shows whether memory ran out",
        ),
    ),
}
_DAMAGED = Cause(
    "the file was damaged after the run: its end was written, but can't be read any more",
    "hil-forceps recover lists the damage and reads the data after it; then the disk, and how the file was copied",
)
_WELL = frozenset(reason.value for reason in AS_MEANT)
_UNKNOWN_FAULT = Cause("as the maker describes this fault", "the message above in the drive's manual")


def causes_of(evidence: Evidence, events: list[Event]) -> list[Cause]:
    """Return the likely causes; none for a run that ended normally."""
    if evidence.reason in _WELL:
        return []
    found = list(_seen(evidence, events))
    if evidence.reason == "drive_fault":
        matching = [cause for words, cause in _BY_WORDS if re.search(words, evidence.message, re.IGNORECASE)]
        found += matching[:1] or [_UNKNOWN_FAULT]
    found += [_DAMAGED] if not evidence.reason and evidence.is_damaged else _BY_REASON.get(evidence.reason, ())
    return list(dict.fromkeys(found))


def _seen(evidence: Evidence, events: list[Event]) -> Iterator[Cause]:
    """Yield causes that the data shortly before the end show."""
    late_s = evidence.time_s(evidence.ended_ns - LATE_WINDOW_NS)
    if any(event.kind == "overruns" and event.time_s >= late_s for event in events):
        yield Cause(
            "the loop on this host paused just before the end",
            "other load on this computer; start hil-forceps run with chrt and on an isolated core",
        )
    references = evidence.references[evidence.references["tick_ns"] >= evidence.ended_ns - LATE_WINDOW_NS]
    takes_samples = evidence.reason in {"drive_fault", "enable_failed", "reference_denied"}
    if takes_samples and len(references) and np.mean(references["verdict"] == Verdict.STALE) > 0.5:
        yield Cause(
            "samples were too old, so that most of the last references were not sent",
            "whether limits.max_sample_age_s exceeds bench.latency_s, the delay of the adapter and the drive's "
            "sample period",
        )
    gaps = {code for code, name in evidence.verdicts.items() if name == "DENIED_GAP"}
    if np.isin(references["verdict"], list(gaps)).any():
        yield Cause(
            "no reference was sent for longer than the gate allows: samples were missing, or the loop paused",
            "missing samples and skipped ticks just before the end; then the wiring, or other load on this host",
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
                f"{unheard[0]} references were sent, but the samples of the drive confirm none of them",
                "the path from host to drive: bus load, arbitration ids of other devices, the adapter",
            )
