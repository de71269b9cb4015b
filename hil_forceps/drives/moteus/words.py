"""moteus' registers in words: names with units, and the scales of integers.

Source: mjbots/moteus, `docs/protocol/registers.md`.
"""

import math
from typing import Any, Final, NamedTuple

from hil_forceps.drives.moteus.messages import Mode, version_words
from hil_forceps.drives.moteus.subframes import Subframe
from hil_forceps.drives.profile import member_name


class _Quantity(NamedTuple):
    """What one count of an int8, int16 and int32 is."""

    unit: str
    counts: tuple[float, float, float]


_FLOAT: Final = 3
_REV: Final = _Quantity("_rev", (1e-2, 1e-4, 1e-5))
_SPEED: Final = _Quantity("_rev_per_s", (0.1, 2.5e-4, 1e-5))
_ACCELERATION: Final = _Quantity("_rev_per_s2", (0.05, 1e-3, 1e-5))
_TORQUE: Final = _Quantity("_N_m", (0.5, 1e-2, 1e-3))
_CURRENT: Final = _Quantity("_A", (1.0, 0.1, 1e-3))
_VOLTAGE: Final = _Quantity("_V", (0.5, 0.1, 1e-3))
_TEMPERATURE: Final = _Quantity("_C", (1.0, 0.1, 1e-3))
_POWER: Final = _Quantity("_W", (10.0, 0.05, 1e-4))
_TIME: Final = _Quantity("_s", (1e-2, 1e-3, 1e-6))
_SCALE: Final = _Quantity("", (1.0 / 127.0, 1.0 / 32767.0, 1.0 / 2147483647.0))
_COUNT: Final = _Quantity("", (1.0, 1.0, 1.0))
_MODE, _VERSION = 0x000, 0x101
_NAMES: Final[dict[int, tuple[str, _Quantity]]] = {
    _MODE: ("mode", _COUNT),
    0x001: ("position", _REV),
    0x002: ("velocity", _SPEED),
    0x003: ("torque", _TORQUE),
    0x004: ("q_current", _CURRENT),
    0x005: ("d_current", _CURRENT),
    0x006: ("abs_position", _REV),
    0x007: ("power", _POWER),
    0x00A: ("motor_temperature", _TEMPERATURE),
    0x00B: ("trajectory_complete", _COUNT),
    0x00C: ("home_state", _COUNT),
    0x00D: ("voltage", _VOLTAGE),
    0x00E: ("temperature", _TEMPERATURE),
    0x00F: ("fault", _COUNT),
    0x020: ("command_position", _REV),
    0x021: ("command_velocity", _SPEED),
    0x022: ("feedforward_torque", _TORQUE),
    0x023: ("kp_scale", _SCALE),
    0x024: ("kd_scale", _SCALE),
    0x025: ("max_torque", _TORQUE),
    0x026: ("stop_position", _REV),
    0x027: ("watchdog", _TIME),
    0x028: ("velocity_limit", _SPEED),
    0x029: ("accel_limit", _ACCELERATION),
    0x070: ("clock_ms", _COUNT),
    0x100: ("model", _COUNT),
    _VERSION: ("firmware", _COUNT),
    0x102: ("register_map", _COUNT),
}
_WIDTHS: Final = ("int8", "int16", "int32", "float")


def register_values(subframe: Subframe) -> dict[str, Any]:
    """Return the registers of a subframe by name, values with their units; what is read, as a list of names."""
    registers = range(subframe.register, subframe.register + subframe.number)
    if subframe.kind in {"read error", "write error"}:
        return {subframe.kind.replace(" ", "_"): f"0x{subframe.register:03x}"}
    if subframe.kind == "read":
        names = " ".join(_NAMES.get(each, (f"0x{each:03x}", _COUNT))[0] for each in registers)
        return {f"read_{_WIDTHS[subframe.resolution]}_0x{subframe.register:03x}": names}
    return dict(
        _named(register, subframe.resolution, value) for register, value in zip(registers, subframe.values, strict=True)
    )


def _named(register: int, resolution: int, value: float) -> tuple[str, Any]:
    if register not in _NAMES:
        return f"0x{register:03x}", value
    name, quantity = _NAMES[register]
    if not math.isfinite(value):
        return name + quantity.unit, None
    if register == _MODE:
        return name, member_name(Mode, int(value))
    if register == _VERSION:
        return name, version_words(int(value))
    if quantity is _COUNT:
        return name, int(value)
    return name + quantity.unit, value if resolution == _FLOAT else value * quantity.counts[resolution]
