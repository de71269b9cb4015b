"""A moteus in the house: from the rig to the machine, what doesn't go together, who is there, and frames in words."""

import math
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from firmware_protocol.frames import Frame
from hil_forceps.drives.line_use import most_bits
from hil_forceps.drives.moteus import messages as wire
from hil_forceps.drives.moteus.inquiry import MoteusInquiry
from hil_forceps.drives.moteus.machine import Moteus, MoteusConfig
from hil_forceps.drives.moteus.subframes import parse_subframes
from hil_forceps.drives.moteus.words import register_values
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.profile import (
    Decoded,
    Finding,
    Found,
    Profile,
    check_node,
    float_quantum,
    too_old_by_polling,
    torque_constant_N_m_per_A,
)
from hil_forceps.drives.promises import Promises
from hil_forceps.rig import Rig
from hil_forceps.rig.sections import MotorDriver

BITRATE, DATA_BITRATE = 1_000_000, 5_000_000  # of a moteus; they can't be set
MIN_ANSWERS: Final = 2  # one frame may be anybody's
MIN_SILENCE_S: Final = 0.1
SILENT_PERIODS: Final = 20  # of the host, at least, until a moteus that doesn't answer is gone
REFERENCE_BITS, ANSWER_BITS = most_bits(48, True, True), most_bits(32, True, True)  # by rate
REPORT_PERIODS: Final = 5  # a mode comes with every answer


def _machine(rig: Rig, settings: MotorDriver) -> DriveMachine:
    check_node(settings, 1, wire.MAX_NODE)
    ratio = settings.encoder_rev_per_pulley_rev
    return Moteus(
        MoteusConfig(
            node=settings.node_id,
            rev_per_pulley_rev=ratio,
            zero_rev=settings.encoder_zero_rev,
            max_torque_N_m=settings.current_limit_A * torque_constant_N_m_per_A(rig) / abs(ratio),
            watchdog_s=settings.watchdog_s,
            silence_ns=round(max(MIN_SILENCE_S, SILENT_PERIODS * rig.bench.host_period_s) * 1e9),
        )
    )


def _wire_s(rig: Rig, bits: tuple[int, int]) -> float:
    return bits[0] / rig.bench.bitrate_bit_per_s + bits[1] / rig.bench.data_bitrate_bit_per_s


def _findings(rig: Rig, settings: MotorDriver) -> Iterator[Finding]:
    del settings
    bench, period_s = rig.bench, rig.bench.host_period_s
    if bench.transport != "fd":
        yield Finding("problem", "bench.transport", f"is {bench.transport}, but a moteus supports only CAN FD; set fd")
    for key, found, wanted in (
        ("bitrate_bit_per_s", bench.bitrate_bit_per_s, BITRATE),
        ("data_bitrate_bit_per_s", bench.data_bitrate_bit_per_s, DATA_BITRATE),
    ):
        if found != wanted:
            yield Finding(
                "problem", f"bench.{key}", f"is {found}, but a moteus has the fixed value {wanted}; set it here"
            )
    yield from too_old_by_polling(rig)
    trip_s = 2.0 * (bench.latency_s + bench.latency_jitter_s) + _wire_s(rig, REFERENCE_BITS) + _wire_s(rig, ANSWER_BITS)
    if trip_s > period_s:
        yield Finding(
            "note",
            "bench.host_period_s",
            f"is {period_s:g} s, shorter than the longest time of a reference and its answer ({trip_s:.2g} s): "
            "samples are "
            "older than their stamps, and a moteus drops an answer when the next request arrives first; lengthen it",
        )


def _bus_load(rig: Rig, settings: MotorDriver) -> float:
    del settings
    return (_wire_s(rig, REFERENCE_BITS) + _wire_s(rig, ANSWER_BITS)) / rig.bench.host_period_s


def _ids(settings: MotorDriver) -> frozenset[tuple[int, bool]]:
    ids = (wire.request_id(settings.node_id), wire.reply_id(settings.node_id))
    return frozenset((each, wire.is_extended(each)) for each in ids)


class _Heard(NamedTuple):
    answers: int
    mode: int
    fault: int


class _Listener:
    """Tells a moteus by its answers, to whomever: by itself it says nothing."""

    def __init__(self) -> None:
        self._heard: dict[int, _Heard] = {}

    def receive(self, frame: Frame) -> bool:
        """Take one frame; its ids may be others' too."""
        node, is_wide = frame.arbitration_id >> 8, wire.is_extended(frame.arbitration_id)
        if not frame.is_fd or frame.is_extended != is_wide or not 1 <= node <= wire.MAX_NODE:
            return False
        subframes = parse_subframes(frame.data)
        if not subframes or any(each.kind != "reply" for each in subframes):
            return False
        values = {each.register + place: value for each in subframes for place, value in enumerate(each.values)}
        mode, known = values.get(wire.Register.MODE), self._heard.get(node)
        if mode is None or mode not in set(wire.Mode):
            return False
        fault = values.get(wire.Register.FAULT, 0.0)
        answers = 1 if known is None else known.answers + 1
        self._heard[node] = _Heard(answers, int(mode), int(fault) if math.isfinite(fault) else 0)
        return False

    def found(self) -> list[Found]:
        """Return the drives heard so far, by node."""
        return [
            Found("moteus", node, f"{_mode_words(said)}; answers, and sends nothing unasked")
            for node, said in sorted(self._heard.items())
            if said.answers >= MIN_ANSWERS
        ]


def _mode_words(said: _Heard) -> str:
    if said.mode in {wire.Mode.FAULT, wire.Mode.TIMEOUT}:
        return wire.fault_words(said.mode, said.fault)
    return wire.Mode(said.mode).name.lower().replace("_", " ")


def decode(frame: Frame) -> Decoded | None:
    """Return a frame in words; None for an id or subframes that are no moteus'."""
    identifier = frame.arbitration_id
    if identifier > 0xFFFF or frame.is_extended != wire.is_extended(identifier):
        return None
    subframes = parse_subframes(frame.data)
    if not subframes:
        return None
    source, destination = identifier >> 8 & 0x7F, identifier & 0x7F
    kinds = {each.kind for each in subframes}
    values: dict[str, Any] = {"from": source, "to": destination}
    for each in subframes:
        values |= register_values(each)
    if kinds <= {"reply", "read error", "write error"}:
        return Decoded("REPLY", values)
    if kinds <= {"read"}:
        return Decoded("QUERY", values)
    if kinds <= {"read", "write"}:
        mode = values.get("mode")
        name = {wire.Mode.STOPPED.name: "STOP", wire.Mode.POSITION.name: "POSITION"}.get(str(mode), "WRITE")
        return Decoded(name, values)
    return None


def _promises(rig: Rig, _settings: MotorDriver) -> Promises:
    return Promises(state_report_s=REPORT_PERIODS * rig.bench.host_period_s, starved="braked")


PROFILE: Final = Profile(
    name="moteus",
    link="can",
    machine=_machine,
    sample_period_s=lambda rig, _: rig.bench.host_period_s,
    findings=_findings,
    bus_load=_bus_load,
    quantum=float_quantum,
    listener=_Listener,
    decode=decode,
    promises=_promises,
    ids=_ids,
    has_extended_ids=True,
    tells_current_limit=True,
    inquiry=lambda settings: MoteusInquiry(settings.node_id),
    speaks_fd=True,
    ask=(wire.ask_all(),) * MIN_ANSWERS,
)
