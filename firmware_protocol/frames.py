"""The frame as everything in the house passes it on: below it only bits, above it only messages."""

from typing import Final, NamedTuple

NODE_BITS = 5
BROADCAST_NODE = 0
MAX_NODE = 30
MAX_BASE_ID: Final = 0x7FF
MAX_EXTENDED_ID: Final = 0x1FFF_FFFF

# `make(Frame, (id, data, is_fd, is_extended))`: any NamedTuple out of all its fields, for what is built every tick. It
# takes half the time of the class's own constructor, which is not compiled, and fills in no defaults.
make: Final = tuple.__new__


class Frame(NamedTuple):
    """One CAN data frame, its id of 11 bits, or of 29 where `is_extended`; `is_fd` is sent with bit-rate switch."""

    arbitration_id: int
    data: bytes
    is_fd: bool = False
    is_extended: bool = False


def arbitration_id(function: int, node: int) -> int:
    """Compose an id: six bits of function (lower wins arbitration), five bits of node."""
    return function << NODE_BITS | node


def split_id(value: int) -> tuple[int, int]:
    """Return (function, node) of an arbitration id."""
    return value >> NODE_BITS, value & ((1 << NODE_BITS) - 1)
