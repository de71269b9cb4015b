"""Drives broken in: faults, parameters."""

from collections.abc import Callable
from typing import Any

from firmware_protocol.drive.parameter_values import ParameterStore
from firmware_protocol.frames import Frame, arbitration_id, split_id
from firmware_protocol.messages import (
    DriveState,
    FaultReason,
    Function,
    HostHeartbeat,
    ParamOp,
    ParamRequest,
)
from firmware_protocol.parameters import Index
from firmware_protocol.states import DriveEvent
from tests.conformance.broken.table import (
    ENABLE,
    RESET,
    Break,
    Frames,
    Handler,
    breaks,
    executes,
    wrap,
)
from tests.conformance.devices import Device

# -- faults ------------------------------------------------------------------------------------------------------------


@breaks(130)
def enable_resets(d: Device) -> None:
    def beat(old: Handler, message: HostHeartbeat, *rest: Any) -> Frames:
        rises = message.control & ENABLE and not d.machine._levels & ENABLE
        resets = rises and d.machine.state is DriveState.FAULT and message.protocol_major == 1
        frames = old(message, *rest)
        if resets and not message.control & RESET and d.machine.fault is FaultReason.ESTOP:
            d.machine._fire(DriveEvent.RESET)
        return frames

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(131)
def a_later_reason_wins(d: Device) -> None:
    def fire(old: Any, event: DriveEvent, *reason: Any) -> None:
        old(event, *reason)
        if event is DriveEvent.HOST_LOST and d.machine.state is DriveState.FAULT:
            d.machine.fault = FaultReason.HOST_HEARTBEAT_LOST

    wrap(d.machine, "_fire", fire)


@breaks(132)
def reset_and_enable_at_once(d: Device) -> None:
    def beat(old: Handler, message: HostHeartbeat, now_us: int, theta: int) -> Frames:
        both = message.control & ~d.machine._levels & 3 == 3 and d.machine.state is DriveState.FAULT
        frames = old(message, now_us, theta)
        if both:
            d.machine._armed_us = now_us
            d.machine._fire(DriveEvent.ENABLE)
        return frames

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(133)
def a_reset_forgets_enable(d: Device) -> None:
    def beat(old: Handler, message: HostHeartbeat, *rest: Any) -> Frames:
        fault = d.machine.state is DriveState.FAULT
        frames = old(message, *rest)
        if fault and d.machine.state is DriveState.DISABLED:
            d.machine._levels &= ~ENABLE
        return frames

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(134)
def reset_by_level(d: Device) -> None:
    def beat(old: Handler, *a: Any) -> Frames:
        if d.machine._host_present:
            d.machine._levels &= ~RESET
        return old(*a)

    wrap(d.machine, "_on_host_heartbeat", beat)


@breaks(140)
def estop_without_payload_only(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        full = split_id(frame.arbitration_id)[0] == Function.ESTOP and len(frame.data) > 7
        return [] if full else old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(140)
def no_estop_to_all_while_operational(d: Device) -> None:
    def receive(old: Handler, frame: Frame, now_ns: int) -> Frames:
        to_all = frame.arbitration_id == arbitration_id(Function.ESTOP, 0)
        return [] if to_all and d.machine.state is DriveState.OPERATIONAL else old(frame, now_ns)

    wrap(d, "receive", receive)


@breaks(141)
def estop_overwrites_the_reason(d: Device) -> None:
    def estop(old: Handler, *a: Any) -> Frames:
        frames = old(*a)
        d.machine.fault = FaultReason.ESTOP
        return frames

    wrap(d.machine, "_on_estop", estop)


@breaks(142)
def estop_from_a_host_that_is_there_only(d: Device) -> None:
    wrap(d.machine, "_on_estop", lambda old, *a: old(*a) if d.machine._host_present else [])


# -- parameters --------------------------------------------------------------------------------------------------------


@breaks(150)
def answers_twice(d: Device) -> None:
    def request(old: Handler, message: ParamRequest, *rest: Any) -> Frames:
        return old(message, *rest) * (2 if message.parameter == Index.COUNTS_PER_REV else 1)

    wrap(d.machine, "_on_param_request", request)


def result_for(op: int, index: int, result: int, when: Callable[[Device], bool] = lambda _: True) -> Break:
    """Return a mutation that answers one request otherwise, and changes nothing else."""

    def mutate(d: Device) -> None:
        def execute(old: Any, store: ParameterStore, asked: int, number: int, value: int, disabled: bool) -> Any:
            if (asked, number) == (op, index) and when(d):
                return ParamOp(result), store._values.get(number, 0)
            return old(asked, number, value, disabled)

        executes(d, execute)

    return mutate


@breaks(151)
def one_parameter_not_read_in_fault(d: Device) -> None:
    fault = DriveState.FAULT
    mutate = result_for(ParamOp.READ, Index.TORQUE_CONSTANT, ParamOp.WRONG_STATE, lambda d: d.machine.state is fault)
    mutate(d)


@breaks(151)
def reads_a_default(d: Device) -> None:
    def execute(old: Any, _: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        result, held = old(op, index, value, disabled)
        return result, 1 << 18 if op == ParamOp.READ and index == Index.MAX_STEP and held == (1 << 18) - 1 else held

    executes(d, execute)


@breaks(152)
def has_a_parameter_too_many(d: Device) -> None:
    result_for(ParamOp.READ, 0x0207, ParamOp.OK)(d)


@breaks(153)
def lets_counts_per_rev_be_written(d: Device) -> None:
    result_for(ParamOp.WRITE, Index.COUNTS_PER_REV, ParamOp.OK)(d)


@breaks(154)
def lets_a_limit_be_written_in_fault(d: Device) -> None:
    fault = DriveState.FAULT
    result_for(ParamOp.WRITE, Index.MAX_STEP, ParamOp.OK, lambda d: d.machine.state is fault)(d)


@breaks(155)
def lets_the_limits_cross(d: Device) -> None:
    def execute(old: Any, store: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        if op == ParamOp.WRITE and index == Index.THETA_MIN and disabled:
            store.put(index, value)
            return ParamOp.OK, value
        return old(op, index, value, disabled)

    executes(d, execute)


@breaks(155)
def upper_bound_not_included(d: Device) -> None:
    def execute(old: Any, store: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        if op == ParamOp.WRITE and index == Index.MAX_STEP and value == 1 << 24 and disabled:
            return ParamOp.OUT_OF_RANGE, store[index]
        return old(op, index, value, disabled)

    executes(d, execute)


@breaks(156)
def reads_for_any_even_op(d: Device) -> None:
    def execute(old: Any, _: ParameterStore, op: int, *rest: Any) -> Any:
        return old(ParamOp.READ if op in (0x10, 0x80) else op, *rest)

    executes(d, execute)


@breaks(157)
def state_before_access(d: Device) -> None:
    def execute(old: Any, _: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        result, held = old(op, index, value, disabled)
        return (ParamOp.WRONG_STATE if result is ParamOp.READ_ONLY and not disabled else result), held

    executes(d, execute)


@breaks(158)
def refuses_with_the_value_asked_for(d: Device) -> None:
    def execute(old: Any, _: ParameterStore, op: int, index: int, value: int, disabled: bool) -> Any:
        result, held = old(op, index, value, disabled)
        return result, value if result is ParamOp.OUT_OF_RANGE else held

    executes(d, execute)


@breaks(159)
def heartbeat_period_after_a_restart(d: Device) -> None:
    def adopt(old: Any) -> None:
        old()
        d.machine._heartbeat_period_us = d.machine.config.heartbeat_period_us

    wrap(d.machine, "_adopt_parameters", adopt)
