"""CiA 402 in the house: from the rig to the machine, what doesn't go together, who is there, and frames in words."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from firmware_protocol.frames import Frame
from hil_forceps.drives.cia402 import messages as wire
from hil_forceps.drives.cia402.inquiry import Cia402Inquiry
from hil_forceps.drives.cia402.machine import Cia402
from hil_forceps.drives.cia402.objects import HOST_NODE, Cia402Config
from hil_forceps.drives.cia402.sync_cycle import SharedSync
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.profile import (
    Decoded,
    Finding,
    Found,
    Profile,
    check_node,
    frames_load,
    host_ids,
    member_name,
    too_old_by_polling,
)
from hil_forceps.drives.promises import Promises
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver

MAX_COUNTS: Final = 1 << 31
HOST_NODES: Final = range(HOST_NODE, HOST_NODE - 8, -1)  # that the host may have, one for each drive on a bus
MAX_REPORT_SYNCS: Final = 5  # within which the statusword shows a change: some may be withheld on a slow path
_NMT_WORDS: Final[dict[int, str]] = {
    wire.NmtState.BOOT_UP: "just booted",
    wire.NmtState.STOPPED: "stopped",
    wire.NmtState.OPERATIONAL: "operational",
    wire.NmtState.PRE_OPERATIONAL: "pre-operational",
}


def _machines(rigs: Sequence[tuple[Rig, MotorDriver]]) -> list[DriveMachine]:
    shared = SharedSync()
    hosts = host_ids(HOST_NODES, (settings.node_id for _, settings in rigs), len(rigs))
    return [_machine(rig, settings, host, shared) for (rig, settings), host in zip(rigs, hosts, strict=True)]


def _machine(
    rig: Rig, settings: MotorDriver, host_node: int = HOST_NODE, shared: SharedSync | None = None
) -> DriveMachine:
    check_node(settings, 1, HOST_NODE - 1)  # 127 is the host's
    counts = rig.encoder.counts_per_rev
    if counts is None:
        raise UserError("encoder.counts_per_rev: is ideal, but a CiA 402 drive sends angles in counts; give a number")
    period_ns = round(rig.bench.host_period_s * 1e9)
    if period_ns % 1_000_000:
        raise UserError(
            f"bench.host_period_s: {rig.bench.host_period_s:g} s is not a whole number of ms, as SYNC and the "
            "interpolation (60C2h) of a CiA 402 drive require; change it"
        )
    reach_rad = max(abs(rig.limits.position_min_rad), abs(rig.limits.position_max_rad))
    ratio = settings.encoder_rev_per_pulley_rev
    largest = counts * (abs(settings.encoder_zero_rev) + abs(ratio) * reach_rad / (2.0 * math.pi))
    if largest >= MAX_COUNTS:
        raise UserError(
            f"motor_driver.encoder_zero_rev: is {settings.encoder_zero_rev:g}; with limits: the position reaches "
            f"{largest:.3g} counts, but the position (6064h) of a CiA 402 drive has 32 bits; set the zero of the "
            "drive nearer to the limits"
        )
    index, subindex = settings.current_object.split("h:")
    return Cia402(
        Cia402Config(
            node=settings.node_id,
            counts_per_pulley_rev=counts * settings.encoder_rev_per_pulley_rev,
            zero_counts=counts * settings.encoder_zero_rev,
            period_ns=period_ns,
            host_timeout_ns=round(settings.watchdog_s * 1e9),
            current_object=(int(index, 16), int(subindex, 16)),
            current_bits=settings.current_object_bits,
            current_lsb_A=settings.current_lsb_A,
            host_node=host_node,
        ),
        shared,
    )


def _findings(rig: Rig, settings: MotorDriver) -> Iterator[Finding]:
    del settings
    yield from too_old_by_polling(rig)


def _promises(rig: Rig, settings: MotorDriver) -> Promises:
    del settings
    return Promises(
        state_report_s=MAX_REPORT_SYNCS * rig.bench.host_period_s,
        harmless_counters=frozenset({"syncs_withheld", "emergencies"}),
    )


def _shared_load(rig: Rig) -> float:
    return frames_load(rig, [(0, 1.0 / rig.bench.host_period_s)])  # SYNC


def _bus_load(rig: Rig, settings: MotorDriver) -> float:
    del settings
    cyclic = (0, 7, 4, 6)  # bytes of SYNC, the drive's two frames, a reference
    heartbeats_per_s = 60.0  # of both
    return frames_load(rig, [*((length, 1.0 / rig.bench.host_period_s) for length in cyclic), (1, heartbeats_per_s)])


def _ids(settings: MotorDriver) -> frozenset[tuple[int, bool]]:
    of_node = (wire.EMCY_ID, *wire.TPDO_IDS, wire.RPDO1_ID, wire.SDO_ANSWER_ID, wire.SDO_REQUEST_ID, wire.HEARTBEAT_ID)
    return frozenset((function + settings.node_id, False) for function in of_node)


class _Listener:
    """Tells a CANopen node by its heartbeat or boot-up message."""

    def __init__(self) -> None:
        self._states: dict[int, int] = {}

    def receive(self, frame: Frame) -> bool:
        """Take one frame."""
        node, data = frame.arbitration_id & 0x7F, frame.data
        is_ours = frame.arbitration_id == wire.HEARTBEAT_ID + node and len(data) == 1 and data[0] in _NMT_WORDS
        if is_ours and node and not frame.is_extended:
            self._states[node] = data[0]
            return True
        return False

    def found(self) -> list[Found]:
        """Return the nodes heard so far."""
        return [
            Found("cia402", node, f"{_NMT_WORDS[state]}; a CANopen node, possibly not a drive")
            for node, state in sorted(self._states.items())
        ]


def decode(frame: Frame) -> Decoded | None:
    """Return a CANopen frame by the predefined connection set; PDOs as this project maps them."""
    function, node, data = frame.arbitration_id & 0x780, frame.arbitration_id & 0x7F, frame.data
    if frame.is_extended:
        return None
    if frame.arbitration_id == wire.NMT_ID:
        if len(data) != 2:
            return None
        return Decoded("NMT", {"node": data[1], "command": member_name(wire.Nmt, data[0])})
    if frame.arbitration_id == wire.SYNC_ID:
        return Decoded("SYNC", {})
    read = _READERS.get(function)
    found = None if read is None else read(data)
    return None if found is None else Decoded(found.name, {"node": node, **found.values})


def _emergency(data: bytes) -> Decoded | None:
    code = wire.parse_emergency(data)
    return None if code is None else Decoded("EMCY", {"error_code": f"0x{code:04x}"})


def _heartbeat(data: bytes) -> Decoded | None:
    return Decoded("HEARTBEAT", {"state": member_name(wire.NmtState, data[0])}) if len(data) == 1 else None


def _sdo_answer(data: bytes) -> Decoded | None:
    answer = wire.parse_sdo(data)
    if answer is None:
        return None
    values: dict[str, Any] = {"object": f"{answer.object_index:04X}h:{answer.subindex:02X}"}
    if answer.value is not None:
        values["value"] = answer.value
    if answer.abort is not None:
        values["abort"] = wire.abort_words(answer.abort)
    return Decoded("SDO_ANSWER", values)


def _sdo_request(data: bytes) -> Decoded | None:
    if len(data) != 8:
        return None
    values: dict[str, Any] = {"object": f"{int.from_bytes(data[1:3], 'little'):04X}h:{data[3]:02X}"}
    if data[0] == 0x40:
        return Decoded("SDO_READ", values)
    if data[0] == 0x80:  # the client's own
        return Decoded("SDO_ABORT", {**values, "abort": wire.abort_words(int.from_bytes(data[4:], "little"))})
    return Decoded("SDO_WRITE", {**values, "value": int.from_bytes(data[4:], "little")})


def _position(data: bytes) -> Decoded | None:
    if len(data) != 7:
        return None
    statusword = int.from_bytes(data[4:6], "little")
    state = wire.state_of(statusword)
    return Decoded(
        "TPDO1",
        {
            "position_counts": int.from_bytes(data[:4], "little", signed=True),
            "statusword": f"0x{statusword:04x}",
            "state": "unknown" if state is None else state.name,
            "mode": int.from_bytes(data[6:], "little", signed=True),
        },
    )


def _current(data: bytes) -> Decoded | None:
    if len(data) not in {2, 4}:
        return None
    return Decoded("TPDO2", {"current_counts": int.from_bytes(data, "little", signed=True)})  # the unit is the rig's


def _reference(data: bytes) -> Decoded | None:
    if len(data) != 6:
        return None
    controlword = int.from_bytes(data[:2], "little")
    target = int.from_bytes(data[2:], "little", signed=True)
    return Decoded("RPDO1", {"controlword": f"0x{controlword:04x}", "target_counts": target})


_READERS: Mapping[int, Callable[[bytes], Decoded | None]] = {
    wire.EMCY_ID: _emergency,
    wire.TPDO_IDS[0]: _position,
    wire.TPDO_IDS[1]: _current,
    wire.RPDO1_ID: _reference,
    wire.SDO_ANSWER_ID: _sdo_answer,
    wire.SDO_REQUEST_ID: _sdo_request,
    wire.HEARTBEAT_ID: _heartbeat,
}

PROFILE: Final = Profile(
    name="cia402",
    link="can",
    machine=_machine,
    sample_period_s=lambda rig, _: rig.bench.host_period_s,  # that of SYNC
    findings=_findings,
    bus_load=_bus_load,
    quantum=lambda _rig, _settings: None,  # counts
    listener=_Listener,
    decode=decode,
    promises=_promises,
    ids=_ids,
    inquiry=lambda settings: Cia402Inquiry(settings.node_id),
    machines=_machines,
    bus_ids=frozenset((each, False) for each in (wire.SYNC_ID, *(wire.HEARTBEAT_ID + node for node in HOST_NODES))),
    shared_load=_shared_load,
)
