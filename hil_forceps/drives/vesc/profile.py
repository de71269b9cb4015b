"""A VESC in the house: from the rig to the machine, what doesn't go together, who is there, and words."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from firmware_protocol.frames import Frame
from firmware_protocol.scales import ANGLE_LSB_PER_REV
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.profile import (
    LOAD_N_M,
    MAX_QUANTUM_SHARE,
    Decoded,
    Finding,
    Found,
    Profile,
    Quantum,
    check_node,
    frames_load,
    host_ids,
    too_old_by_polling,
)
from hil_forceps.drives.promises import Promises
from hil_forceps.drives.vesc import messages as wire
from hil_forceps.drives.vesc.inquiry import VescInquiry
from hil_forceps.drives.vesc.machine import Vesc, VescConfig
from hil_forceps.drives.vesc.messages import Command
from hil_forceps.drives.vesc.timeout_trial import THREAD_NS
from hil_forceps.drives.vesc.turns import Turns, TurnsConfig
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver

MAX_TIMEOUT_S: Final = 0.9  # it is tried before each run, twice at worst, within the time to connect
HOST_IDS: Final = range(wire.HOST_ID, wire.HOST_ID - 8, -1)  # that the host may have, one for each VESC on a bus
MIN_BROADCASTS: Final = 2  # one frame may be anybody's
_TICK_BYTES: Final = (7, 8, 8, 2, 6, 4)  # of a tick's frames: request, answer in four, reference
_BROADCASTS_PER_S: Final = 4 * 50  # STATUS 1 to 4 at 50 Hz, as VESC Tool's set-up leaves them
_FLOAT_STEP_REV: Final = 2.0**-15 / 360.0  # of a 32-bit float in degrees, near a whole turn


def _turns(rig: Rig, settings: MotorDriver) -> TurnsConfig:
    ratio, limits = settings.encoder_rev_per_pulley_rev, rig.limits
    ends = [
        settings.encoder_zero_rev + ratio * end_rad / (2.0 * math.pi)
        for end_rad in (limits.position_min_rad, limits.position_max_rad)
    ]
    return TurnsConfig(
        low_rev=min(ends),
        high_rev=max(ends),
        speed_rev_per_s=limits.speed_max_rad_per_s * abs(ratio) / (2.0 * math.pi),
        period_ns=round(rig.bench.host_period_s * 1e9),
        count_rev=1.0 / (rig.encoder.counts_per_rev or ANGLE_LSB_PER_REV),
    )


def _machines(rigs: Sequence[tuple[Rig, MotorDriver]]) -> list[DriveMachine]:
    """Return machines with a host's id each: fragments of an answer say to whom they go, and not from whom."""
    hosts = host_ids(HOST_IDS, (settings.node_id for _, settings in rigs), len(rigs))
    return [_machine(rig, settings, host) for (rig, settings), host in zip(rigs, hosts, strict=True)]


def _machine(rig: Rig, settings: MotorDriver, host_id: int = wire.HOST_ID) -> DriveMachine:
    check_node(settings, 0, wire.MAX_NODE)
    return Vesc(
        VescConfig(
            node=settings.node_id,
            rev_per_pulley_rev=settings.encoder_rev_per_pulley_rev,
            zero_rev=settings.encoder_zero_rev,
            timeout_ns=max(round(settings.watchdog_s * 1e9), 1),  # 0 is refused as a problem before
            turns=_turns(rig, settings),
            host_id=host_id,
        )
    )


def _findings(rig: Rig, settings: MotorDriver) -> Iterator[Finding]:
    if settings.watchdog_s > MAX_TIMEOUT_S:
        yield Finding(
            "problem",
            "motor_driver.watchdog_s",
            f"is {settings.watchdog_s:g} s, but the service tests the timeout before each run, and waits "
            f"{MAX_TIMEOUT_S:g} s at most; set a shorter one in the VESC and here",
        )
    turns = _turns(rig, settings)
    if turns.high_rev - turns.low_rev >= 1.0:
        yield Finding(
            "problem",
            "limits",
            f"span {turns.high_rev - turns.low_rev:.2f} turns of the VESC's angle, which wraps at each turn: the "
            "start of "
            "the motor is ambiguous; make them narrower than one turn, or divide the angle in the VESC",
        )
    if Turns(turns).is_lost(2 * turns.period_ns):  # where one answer is lost
        yield Finding(
            "problem",
            "limits.speed_max_rad_per_s",
            f"allows nearly half a turn of the VESC's angle ({turns.speed_rev_per_s:.3g} turns/s) between two answers, "
            "so that turns can't be counted; lower it, or bench.host_period_s",
        )
    yield from too_old_by_polling(rig)
    yield from _current_steps(rig)


def _current_steps(rig: Rig) -> Iterator[Finding]:
    try:
        plant = rig.plant()
    except UserError:
        return
    radii = plant.motor_pulley_radius_m / plant.jaw_pulley_radius_m
    needed_A = LOAD_N_M * radii / plant.torque_constant_N_m_per_A
    share = wire.CURRENT_LSB_A / needed_A
    if share > MAX_QUANTUM_SHARE:
        hidden = "the load is not visible" if share >= 1.0 else f"{100.0 * share:.0f} % of it"
        yield Finding(
            "note",
            "motor.torque_constant_N_m_per_A",
            f"a load of {LOAD_N_M * 1e3:g} mN m at the jaw needs {needed_A:.3g} A, but the current of a VESC has "
            f"steps of {wire.CURRENT_LSB_A:g} A: {hidden}",
        )


def _quantum(rig: Rig, settings: MotorDriver) -> Quantum:
    del rig
    return Quantum(
        "motor_driver.encoder_rev_per_pulley_rev", _FLOAT_STEP_REV / abs(settings.encoder_rev_per_pulley_rev)
    )


def _bus_load(rig: Rig, settings: MotorDriver) -> float:
    del settings
    ticks = ((length, 1.0 / rig.bench.host_period_s) for length in _TICK_BYTES)
    return frames_load(rig, [*ticks, (8, _BROADCASTS_PER_S)], is_extended=True)


def _ids(settings: MotorDriver) -> frozenset[tuple[int, bool]]:
    return frozenset((wire.frame_id(settings.node_id, each), True) for each in Command)


class _Listener:
    """Tells a VESC by what it broadcasts."""

    def __init__(self) -> None:
        self._heard: dict[int, dict[Command, dict[str, Any]]] = {}
        self._count: dict[int, int] = {}

    def receive(self, frame: Frame) -> bool:
        """Take one frame; its ids may be others' too."""
        found = wire.node_and_command(frame)
        if found is not None and found[1] in wire.BROADCAST:
            node, command = found[0], Command(found[1])
            values = wire.parse_plain(command, frame.data)
            if values is not None:
                self._heard.setdefault(node, {})[command] = values
                self._count[node] = self._count.get(node, 0) + 1
        return False

    def found(self) -> list[Found]:
        """Return the VESCs heard so far, by node."""
        heard = sorted(self._heard.items())
        return [Found("vesc", node, _words(said)) for node, said in heard if self._count[node] >= MIN_BROADCASTS]


def _words(said: dict[Command, dict[str, Any]]) -> str:
    words = [f"broadcasts {', '.join(command.name for command in sorted(said))}"]
    if Command.STATUS in said:
        words.append(f"{abs(said[Command.STATUS]['current_without_direction_A']):g} A")
    if Command.STATUS_4 in said:
        words.append(f"{said[Command.STATUS_4]['position_deg']:g} degrees")
    return "; ".join([*words, "it reports its state only on request"])


def decode(frame: Frame) -> Decoded | None:
    """Return a VESC's frame; None for a command that isn't known here or has another length."""
    found = wire.node_and_command(frame)
    if found is None:
        return None
    node, number = found
    try:
        command = Command(number)
    except ValueError:
        return None
    values = wire.parse_plain(command, frame.data)
    if values is None:
        values = _buffer_values(command, frame.data)
    return None if values is None else Decoded(command.name, {"node": node, **values})


def _buffer_values(command: Command, data: bytes) -> dict[str, Any] | None:
    """Return what a frame says that carries a part of something, or who is there."""
    fewest, read = _READERS.get(command, (0, None))
    return None if read is None or len(data) < fewest else read(data)


def _end_of_answer(data: bytes) -> dict[str, Any]:
    length, crc = int.from_bytes(data[2:4], "big"), int.from_bytes(data[4:6], "big")
    return {"sender": data[0], "processing": data[1], "length": length, "crc": f"0x{crc:04x}"}


# By the fewest bytes that there must be.
_READERS: Final[Mapping[Command, tuple[int, Callable[[bytes], dict[str, Any]]]]] = {
    Command.NOTIFY_BOOT: (0, lambda data: {"hardware": data.decode("ascii", "replace")}),
    Command.PING: (1, lambda data: {"sender": data[0]}),
    Command.PONG: (1, lambda data: {"sender": data[0]}),
    Command.FILL_RX_BUFFER: (2, lambda data: {"offset": data[0], "bytes": data[1:].hex()}),
    Command.PROCESS_SHORT_BUFFER: (
        3,
        lambda data: {"sender": data[0], "processing": data[1], "packet": data[2], "bytes": data[3:].hex()},
    ),
    Command.PROCESS_RX_BUFFER: (6, _end_of_answer),
}

PROFILE: Final = Profile(
    name="vesc",
    link="can",
    machine=_machine,
    sample_period_s=lambda rig, _: rig.bench.host_period_s,  # that of the requests
    findings=_findings,
    bus_load=_bus_load,
    quantum=_quantum,
    listener=_Listener,
    decode=decode,
    ids=_ids,
    promises=lambda _rig, _settings: Promises(
        tells_state=False,
        tells_watchdog=False,
        reaction_s=THREAD_NS * 1e-9,
        current_step_A=wire.CURRENT_LSB_A,
        harmless_counters=frozenset({"broadcasts"}),
    ),
    machines=_machines,
    bus_ids=frozenset((wire.frame_id(host, each), True) for host in HOST_IDS for each in Command),
    has_extended_ids=True,
    inquiry=lambda settings: VescInquiry(settings.node_id),
)
