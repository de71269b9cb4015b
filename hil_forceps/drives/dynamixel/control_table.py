"""The entries of an X servo's control table that a position loop needs, its models, and errors in words.

ROBOTIS e-manual, XM430-W350, chapters Control Table of EEPROM Area and of RAM Area. Those below 64 are kept without
power and can't be written under torque.
"""

import struct
from typing import Final, NamedTuple

COUNTS_PER_REV: Final = 4096
MAX_GOAL_COUNTS: Final = 1_048_575  # of Goal Position (116) in current-based position mode: 256 turns either way
CURRENT_BASED_POSITION: Final = 5
WATCHDOG_UNIT_S: Final = 0.02
MAX_WATCHDOG_UNITS: Final = 127
WATCHDOG_TRIPPED: Final = 0xFF
STATUS_OF_ALL: Final = 2  # every instruction to the servo itself is answered
MIN_FIRMWARE: Final = 38  # Bus Watchdog (98) and Drive Mode (10) are there from then on
MIN_STARTUP_FIRMWARE: Final = 45  # Startup Configuration (60)


class Item(NamedTuple):
    """An entry."""

    name: str
    address: int
    size: int

    def __str__(self) -> str:
        return f"{self.name} ({self.address})"


RETURN_DELAY_TIME: Final = Item("Return Delay Time", 9, 1)
DRIVE_MODE: Final = Item("Drive Mode", 10, 1)
OPERATING_MODE: Final = Item("Operating Mode", 11, 1)
HOMING_OFFSET: Final = Item("Homing Offset", 20, 4)
CURRENT_LIMIT: Final = Item("Current Limit", 38, 2)
STARTUP_CONFIGURATION: Final = Item("Startup Configuration", 60, 1)
TORQUE_ENABLE: Final = Item("Torque Enable", 64, 1)
STATUS_RETURN_LEVEL: Final = Item("Status Return Level", 68, 1)
HARDWARE_ERROR_STATUS: Final = Item("Hardware Error Status", 70, 1)
BUS_WATCHDOG: Final = Item("Bus Watchdog", 98, 1)
GOAL_CURRENT: Final = Item("Goal Current", 102, 2)
PROFILE_ACCELERATION: Final = Item("Profile Acceleration", 108, 4)
PROFILE_VELOCITY: Final = Item("Profile Velocity", 112, 4)
GOAL_POSITION: Final = Item("Goal Position", 116, 4)
PRESENT_CURRENT: Final = Item("Present Current", 126, 2)
PRESENT_POSITION: Final = Item("Present Position", 132, 4)
INDIRECT_ADDRESSES: Final = Item("Indirect Address 1 to 10", 168, 20)
INDIRECT_DATA: Final = Item("Indirect Data 1 to 10", 224, 10)

_OF_FEEDBACK: Final = (
    STATUS_RETURN_LEVEL,
    TORQUE_ENABLE,
    HARDWARE_ERROR_STATUS,
    BUS_WATCHDOG,
    PRESENT_CURRENT,
    PRESENT_POSITION,
)
MAPPING: Final = struct.pack(
    "<10H", *(address for item in _OF_FEEDBACK for address in range(item.address, item.address + item.size))
)
"""What Indirect Address 1 to 10 are set to, so that one read of ten bytes brings `Feedback`."""

_FEEDBACK: Final = struct.Struct("<BBBBhi")


class Feedback(NamedTuple):
    """What a servo answers in every tick, all from one read.

    A servo that was restarted has lost the mapping, and answers nothing but zeros: its `status_return_level` tells.
    """

    status_return_level: int
    torque_enable: int
    hardware_error: int
    bus_watchdog: int
    current: int
    position: int


def parse_feedback(data: bytes) -> Feedback | None:
    """Return the feedback, None for another length."""
    return Feedback(*_FEEDBACK.unpack(data)) if len(data) == _FEEDBACK.size else None


class Model(NamedTuple):
    """A servo: what Model Number (0) says, its name, and the unit of its currents."""

    number: int
    name: str
    current_unit_A: float


CURRENT_UNIT_A: Final = 2.69e-3
MODELS: Final[dict[int, Model]] = {
    model.number: model
    for model in (
        Model(1020, "XM430-W350", CURRENT_UNIT_A),
        Model(1030, "XM430-W210", CURRENT_UNIT_A),
        Model(1120, "XM540-W270", CURRENT_UNIT_A),
    )
}
"""Those that were looked up in the e-manual; others of the X series with a current sensor differ in number and unit."""

HARDWARE_ERRORS: Final[dict[int, str]] = {
    0x01: "input voltage",
    0x04: "overheating",
    0x08: "motor encoder",
    0x10: "electrical shock, or too little power",
    0x20: "overload",
}


def hardware_error_words(error: int) -> str:
    """Return the bits of Hardware Error Status (70) in words, unknown ones by their value."""
    words = [HARDWARE_ERRORS.get(1 << bit, f"0x{1 << bit:x}") for bit in range(8) if error >> bit & 1]
    return f"hardware error 0x{error:02x} ({', '.join(words)})"
