"""The parameter values a drive holds, and its answers to PARAM_REQUEST."""

from typing import Final

from firmware_protocol.drive.config import DriveConfig
from firmware_protocol.messages import ParamOp
from firmware_protocol.parameters import BY_INDEX, INT32_MAX, judge_write


class ParameterStore:
    """Values by index; writes are judged by the dictionary, so what is held is always within its bounds."""

    def __init__(self, config: DriveConfig) -> None:
        self._values: Final = config.parameter_values()

    def __getitem__(self, number: int) -> int:
        return self._values[number]

    def put(self, number: int, value: int) -> None:
        """Keep a value of the drive's own (a counter saturates at the largest the wire carries)."""
        self._values[number] = min(value, INT32_MAX)

    def execute(self, op: int, number: int, value: int, disabled: bool) -> tuple[ParamOp, int]:
        """Read or write; return the result and the value then in force (0 where there is no such parameter)."""
        result = ParamOp.OK if number in BY_INDEX else ParamOp.UNKNOWN_INDEX
        if op == ParamOp.WRITE:
            result = judge_write(number, value, self._values, disabled)
            if result is ParamOp.OK:
                self._values[number] = value
        elif op != ParamOp.READ:
            result = ParamOp.UNKNOWN_OP
        return result, self._values.get(number, 0)
