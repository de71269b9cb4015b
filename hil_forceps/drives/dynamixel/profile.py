"""Dynamixel's protocol 2.0 in the house: from the rig to the machine, what doesn't go together, who answers, words."""

import math
from collections.abc import Iterator
from typing import Any, Final

from firmware_protocol.frames import Frame
from hil_forceps.drives.dynamixel import control_table as table
from hil_forceps.drives.dynamixel import packets as wire
from hil_forceps.drives.dynamixel.inquiry import DynamixelInquiry
from hil_forceps.drives.dynamixel.machine import (
    FEEDBACK_BYTES,
    GOAL_BYTES,
    READ_BYTES,
    SILENCE_NS,
    Dynamixel,
    DynamixelConfig,
)
from hil_forceps.drives.dynamixel.packets import Instruction
from hil_forceps.drives.dynamixel.set_up import PING_SIZE
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
    too_old_by_polling,
)
from hil_forceps.drives.promises import Promises
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.sections import MotorDriver

MAX_STUFFED_BYTES: Final = 4  # in a goal and in the feedback
_ITEMS: Final = {item.address: item for item in vars(table).values() if isinstance(item, table.Item)}


def _machine(rig: Rig, settings: MotorDriver) -> DriveMachine:
    check_node(settings, 0, wire.MAX_ID)
    low, high = (counts / table.COUNTS_PER_REV for counts in (-table.MAX_GOAL_COUNTS, table.MAX_GOAL_COUNTS))
    reached = _reach_rev(rig, settings)
    if not low <= min(reached) <= max(reached) <= high:
        raise UserError(
            f"motor_driver.encoder_zero_rev: with `limits:` the servo's range is {min(reached):g} to "
            f"{max(reached):g} turns, but it supports {low:.0f} to {high:.0f}; change it"
        )
    watchdog = round(settings.watchdog_s / table.WATCHDOG_UNIT_S)
    is_whole = math.isclose(watchdog * table.WATCHDOG_UNIT_S, settings.watchdog_s, abs_tol=1e-9)
    if not is_whole or watchdog > table.MAX_WATCHDOG_UNITS:
        longest_s = table.MAX_WATCHDOG_UNITS * table.WATCHDOG_UNIT_S
        raise UserError(
            f"motor_driver.watchdog_s: is {settings.watchdog_s:g} s, but the bus watchdog of a servo has steps of "
            f"{table.WATCHDOG_UNIT_S:g} s up to {longest_s:g} s; use a multiple"
        )
    if settings.current_limit_A < table.CURRENT_UNIT_A:
        raise UserError(
            f"motor_driver.current_limit_A: is {settings.current_limit_A:g} A, less than the servo's resolution of "
            f"{table.CURRENT_UNIT_A:g} A; raise it"
        )
    return Dynamixel(
        DynamixelConfig(
            node=settings.node_id,
            counts_per_pulley_rev=table.COUNTS_PER_REV * settings.encoder_rev_per_pulley_rev,
            zero_counts=table.COUNTS_PER_REV * settings.encoder_zero_rev,
            current_limit_A=settings.current_limit_A,
            watchdog=watchdog,
            period_ns=round(rig.bench.host_period_s * 1e9),
            baudrate_bit_per_s=settings.baudrate_bit_per_s,
        )
    )


def _reach_rev(rig: Rig, settings: MotorDriver) -> tuple[float, float]:
    """Return what the servo's position is at both ends of the limits, in turns."""
    ratio, zero = settings.encoder_rev_per_pulley_rev, settings.encoder_zero_rev
    ends = rig.limits.position_min_rad, rig.limits.position_max_rad
    first, second = (zero + angle / (2.0 * math.pi) * ratio for angle in ends)
    return first, second


def _findings(rig: Rig, settings: MotorDriver) -> Iterator[Finding]:
    yield from too_old_by_polling(rig)
    counts = rig.encoder.counts_per_rev
    if counts != table.COUNTS_PER_REV:
        has = "ideal" if counts is None else counts
        yield Finding(
            "note",
            "encoder.counts_per_rev",
            f"is {has}, but a servo of the X series has {table.COUNTS_PER_REV}; correct it",
        )
    low, high = sorted(_reach_rev(rig, settings))
    if low < 0.0 or high >= 1.0:
        yield Finding(
            "note",
            "motor_driver.encoder_zero_rev",
            f"the limits are {low:.2f} to {high:.2f} turns of the servo, but at power-on it reports 0 to 1: an angle "
            "outside "
            "of this is then wrong by a whole turn",
        )
    yield from _current_step(rig)


def _current_step(rig: Rig) -> Iterator[Finding]:
    try:
        plant = rig.plant()
    except UserError:
        return
    at_jaw = plant.jaw_pulley_radius_m / plant.motor_pulley_radius_m
    step_N_m = table.CURRENT_UNIT_A * plant.torque_constant_N_m_per_A * at_jaw
    if step_N_m > MAX_QUANTUM_SHARE * LOAD_N_M:
        yield Finding(
            "note",
            "motor.torque_constant_N_m_per_A",
            f"the resolution of the current is {table.CURRENT_UNIT_A * 1e3:g} mA, {step_N_m * 1e3:.2g} mN m at the "
            "jaw, "
            f"{100.0 * step_N_m / LOAD_N_M:.0f} % of a load of {LOAD_N_M * 1e3:g} mN m",
        )


def _bus_load(rig: Rig, settings: MotorDriver) -> float:
    tick_bytes = GOAL_BYTES + READ_BYTES + FEEDBACK_BYTES + MAX_STUFFED_BYTES
    return tick_bytes * wire.BITS_PER_BYTE / settings.baudrate_bit_per_s / rig.bench.host_period_s


class _Listener:
    """Tells servos by their answers to a ping."""

    def __init__(self) -> None:
        self._pinged: dict[int, str] = {}

    def receive(self, frame: Frame) -> bool:
        """Take one packet."""
        status = wire.parse_status(frame.data)
        if status is None or len(status.data) != PING_SIZE or frame.arbitration_id > wire.MAX_ID:
            return False
        number = int.from_bytes(status.data[:2], "little")
        model = table.MODELS.get(number)
        name = f"unknown model number {number}" if model is None else model.name
        alert = f"; alerts: {table.HARDWARE_ERROR_STATUS} has the error" if status.alert else ""
        self._pinged[frame.arbitration_id] = f"{name}, firmware {status.data[2]}{alert}"
        return True

    def found(self) -> list[Found]:
        """Return the servos that answered, by id."""
        return [Found("dynamixel", servo_id, says) for servo_id, says in sorted(self._pinged.items())]


def decode(frame: Frame) -> Decoded | None:
    """Return a packet; what a status packet holds is told by its length, as this profile asks."""
    data = frame.data
    try:
        instruction = Instruction(data[0])
    except (IndexError, ValueError):
        return None
    values = _status(data) if instruction is Instruction.STATUS else _instruction(instruction, data[1:])
    return None if values is None else Decoded(instruction.name, {"id": frame.arbitration_id, **values})


def _status(data: bytes) -> dict[str, Any] | None:
    status = wire.parse_status(data)
    if status is None:
        return None
    values: dict[str, Any] = {"error": wire.error_words(status.error)} if status.error else {}
    if status.alert:
        values["alert"] = True
    feedback = table.parse_feedback(status.data)
    if feedback is not None:
        return {
            **values,
            "position_counts": feedback.position,
            "current_A": feedback.current * table.CURRENT_UNIT_A,
            "torque_enable": feedback.torque_enable,
            "hardware_error": f"0x{feedback.hardware_error:02x}",
            "bus_watchdog": feedback.bus_watchdog,
        }
    if len(status.data) == PING_SIZE:
        return {**values, "model": int.from_bytes(status.data[:2], "little"), "firmware": status.data[2]}
    return {**values, "value": int.from_bytes(status.data, "little")} if status.data else values


def _instruction(instruction: Instruction, parameters: bytes) -> dict[str, Any] | None:
    if instruction in {Instruction.PING, Instruction.REBOOT}:
        return {}
    if len(parameters) < 4 and not (instruction is Instruction.WRITE and len(parameters) > 2):
        return None
    address, size = (int.from_bytes(parameters[at : at + 2], "little") for at in (0, 2))
    what = {"item": str(_ITEMS.get(address, address))}
    if instruction is Instruction.READ:
        return {**what, "size": size}
    if instruction is Instruction.WRITE:
        return {**what, "value": _value(address, parameters[2:])}
    if instruction is Instruction.SYNC_READ:
        return {**what, "size": size, "servos": list(parameters[4:])}
    return {**what, "size": size, **_by_servo(address, size, parameters[4:])}


def _by_servo(address: int, size: int, data: bytes) -> dict[str, Any]:
    parts = [data[at : at + 1 + size] for at in range(0, len(data), 1 + size)]
    return {f"servo_{part[0]}": _value(address, part[1:]) for part in parts}


def _value(address: int, data: bytes) -> int | str:
    if address == table.INDIRECT_ADDRESSES.address:
        return data.hex()
    return int.from_bytes(data, "little", signed=address == table.GOAL_POSITION.address)


def _promises(_rig: Rig, settings: MotorDriver) -> Promises:
    silent_s = 0.5 * settings.watchdog_s + SILENCE_NS * 1e-9  # the machine asks on for so long, and then waits
    fed_s = 0.5 * settings.watchdog_s  # by questions alone
    return Promises(state_report_s=silent_s, starved="lost", tells_watchdog=False, reaction_s=fed_s)


PROFILE: Final = Profile(
    name="dynamixel",
    link="serial",
    machine=_machine,
    sample_period_s=lambda rig, _: rig.bench.host_period_s,  # asked for in every tick
    findings=_findings,
    bus_load=_bus_load,
    quantum=lambda _, settings: Quantum(
        "motor_driver.encoder_rev_per_pulley_rev",
        1.0 / table.COUNTS_PER_REV / abs(settings.encoder_rev_per_pulley_rev),
    ),
    listener=_Listener,
    decode=decode,
    promises=_promises,
    framing=wire.FRAMING,
    ask=(wire.ping(wire.BROADCAST_ID),),
    tells_current_limit=True,
    inquiry=lambda settings: DynamixelInquiry(settings.node_id),
)
