"""What stopped the gate, as plain data."""

from typing import NamedTuple


class GateTrip(NamedTuple):
    """The check that stopped the gate, and what it compared."""

    check: str
    value: float
    limit: float
    unit: str
    time_ns: int  # host's clock
