"""The control table of a simulated X servo: what may be read and written, and what it is at power on.

ROBOTIS e-manual, XM430-W350. Entries that matter to no one here are left out: reading one is an access error.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

SIZE: Final = 662
EEPROM_END: Final = 64

RESULT_FAIL, INSTRUCTION, CRC, DATA_RANGE, DATA_LENGTH, DATA_LIMIT, ACCESS = range(1, 8)


class Entry(NamedTuple):
    """One entry; `low` and `high` bound what may be written, None: it is read only."""

    address: int
    size: int
    initial: int
    low: int | None = None
    high: int | None = None


_ENTRIES: Final = (
    Entry(0, 2, 1020),  # Model Number: XM430-W350
    Entry(2, 4, 0),
    Entry(6, 1, 45),  # Firmware Version
    Entry(7, 1, 1, 0, 252),  # ID
    Entry(8, 1, 1, 0, 7),  # Baud Rate
    Entry(9, 1, 250, 0, 254),  # Return Delay Time, 2 µs
    Entry(10, 1, 0, 0, 13),  # Drive Mode
    Entry(11, 1, 3, 0, 16),  # Operating Mode
    Entry(12, 1, 255, 0, 255),
    Entry(13, 1, 2, 1, 2),  # Protocol Type
    Entry(20, 4, 0, -1_044_479, 1_044_479),  # Homing Offset
    Entry(31, 1, 80, 0, 100),
    Entry(32, 2, 160, 95, 160),
    Entry(34, 2, 95, 95, 160),
    Entry(36, 2, 885, 0, 885),  # PWM Limit
    Entry(38, 2, 1193, 0, 1193),  # Current Limit
    Entry(44, 4, 200, 0, 1023),  # Velocity Limit
    Entry(48, 4, 4095, 0, 4095),
    Entry(52, 4, 0, 0, 4095),
    Entry(60, 1, 0, 0, 3),  # Startup Configuration
    Entry(63, 1, 52, 0, 61),  # Shutdown
    Entry(64, 1, 0, 0, 1),  # Torque Enable
    Entry(65, 1, 0, 0, 1),  # LED
    Entry(68, 1, 2, 0, 2),  # Status Return Level
    Entry(69, 1, 0),  # Registered Instruction
    Entry(70, 1, 0),  # Hardware Error Status
    Entry(76, 2, 1920, 0, 16383),
    Entry(78, 2, 100, 0, 16383),
    Entry(80, 2, 0, 0, 16383),
    Entry(82, 2, 0, 0, 16383),
    Entry(84, 2, 800, 0, 16383),
    Entry(88, 2, 0, 0, 16383),
    Entry(90, 2, 0, 0, 16383),
    Entry(98, 1, 0, 0, 127),  # Bus Watchdog, 20 ms
    Entry(100, 2, 885, -885, 885),  # Goal PWM
    Entry(102, 2, 1193, -1193, 1193),  # Goal Current
    Entry(104, 4, 0, -1023, 1023),  # Goal Velocity
    Entry(108, 4, 0, 0, 32767),  # Profile Acceleration
    Entry(112, 4, 0, 0, 32767),  # Profile Velocity
    Entry(116, 4, 0, -1_048_575, 1_048_575),  # Goal Position
    Entry(120, 2, 0),  # Realtime Tick
    Entry(122, 1, 0),  # Moving
    Entry(123, 1, 0),
    Entry(124, 2, 0),  # Present PWM
    Entry(126, 2, 0),  # Present Current
    Entry(128, 4, 0),  # Present Velocity
    Entry(132, 4, 0),  # Present Position
    Entry(136, 4, 0),
    Entry(140, 4, 0),
    Entry(144, 2, 120),  # Present Input Voltage
    Entry(146, 1, 35),  # Present Temperature
)
INDIRECT: Final = 28  # of them: addresses from 168 on, data from 224 on
INDIRECT_ADDRESS, INDIRECT_DATA = 168, 224
GOALS: Final = frozenset({100, 102, 104, 116})
CURRENT_LIMIT, BUS_WATCHDOG, GOAL_CURRENT = 38, 98, 102
TRIPPED: Final = 0xFF

_BY_ADDRESS: Final = {
    entry.address: entry
    for entry in (
        *_ENTRIES,
        *(Entry(INDIRECT_ADDRESS + 2 * n, 2, INDIRECT_DATA + n, EEPROM_END, SIZE - 1) for n in range(INDIRECT)),
        *(Entry(INDIRECT_DATA + n, 1, 0, 0, 255) for n in range(INDIRECT)),
    )
}
_DEFINED: Final = frozenset(
    at for entry in _BY_ADDRESS.values() for at in range(entry.address, entry.address + entry.size)
)


@dataclass(slots=True)
class ControlTable:
    """The bytes, with the rules of access; errors are the numbers of a status packet."""

    data: bytearray

    def __init__(self) -> None:
        self.data = bytearray(SIZE)
        for entry in _BY_ADDRESS.values():
            self.put(entry.address, entry.initial)

    def restart(self) -> None:
        """Forget what isn't kept without power."""
        for entry in _BY_ADDRESS.values():
            if entry.address >= EEPROM_END:
                self.put(entry.address, entry.initial)

    def get(self, address: int) -> int:
        """Return the value of an entry; those that may be negative are."""
        entry = _BY_ADDRESS[address]
        signed = entry.low is not None and entry.low < 0
        return int.from_bytes(self.data[address : address + entry.size], "little", signed=signed)

    def put(self, address: int, value: int) -> None:
        """Set an entry, by the servo itself."""
        size = _BY_ADDRESS[address].size
        self.data[address : address + size] = (value & (1 << 8 * size) - 1).to_bytes(size, "little")

    def read(self, address: int, size: int) -> tuple[bytes, int]:
        """Return what a host reads, and the error."""
        places = [self._place(at) for at in range(address, address + size)]
        if not places or not _DEFINED.issuperset(places):
            return b"", ACCESS
        return bytes(self.data[place] for place in places), 0

    def write(self, address: int, data: bytes) -> tuple[list[int], int]:
        """Take what a host writes, whole or not at all; return the entries' addresses and the error."""
        entries: list[tuple[Entry, bytes]] = []
        at = address
        while at < address + len(data):
            entry = _BY_ADDRESS.get(self._place(at))
            if entry is None or entry.low is None:
                return [], ACCESS
            part = data[at - address : at - address + entry.size]
            error = self._refuses(entry, part)
            if error:
                return [], error
            entries.append((entry, part))
            at += entry.size
        for entry, part in entries:
            self.data[entry.address : entry.address + entry.size] = part
        return [entry.address for entry, _ in entries], 0 if entries else DATA_LENGTH

    def _refuses(self, entry: Entry, part: bytes) -> int:
        if len(part) < entry.size:
            return DATA_LENGTH
        if entry.address < EEPROM_END and self.get(64):
            return ACCESS
        if entry.address in GOALS and self.data[BUS_WATCHDOG] == TRIPPED:
            return DATA_RANGE
        assert entry.low is not None
        assert entry.high is not None
        value = int.from_bytes(part, "little", signed=entry.low < 0)
        if not entry.low <= value <= entry.high:
            return DATA_RANGE
        return DATA_LIMIT if entry.address == GOAL_CURRENT and abs(value) > self.get(CURRENT_LIMIT) else 0

    def _place(self, address: int) -> int:
        """Return where an address leads: indirect data to what its address says."""
        index = address - INDIRECT_DATA
        if not 0 <= index < INDIRECT:
            return address
        at = INDIRECT_ADDRESS + 2 * index
        return int.from_bytes(self.data[at : at + 2], "little")
