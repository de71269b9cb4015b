"""The simulated drives that speak makers' protocols, by the name in a rig's `motor_driver.profile`."""

from collections.abc import Mapping
from typing import Final, Protocol

from hil_forceps.rig import Rig
from virtual_bus.bus.node import Node
from virtual_bus.bus.wire import LineCodec
from virtual_bus.drives.cia402 import SimulatedCia402
from virtual_bus.drives.dynamixel import SimulatedDynamixel
from virtual_bus.drives.dynamixel_packets import CODEC
from virtual_bus.drives.mit import SimulatedMit
from virtual_bus.drives.moteus import SimulatedMoteus
from virtual_bus.drives.odrive import SimulatedODrive
from virtual_bus.plant.load import LoadProfile
from virtual_bus.truth_log import TruthLog


class SimulatedMotorDriver(Node, Protocol):
    """A drive with a forceps behind it, on the virtual bus."""

    @property
    def truth(self) -> TruthLog:
        """What the forceps did."""

    @property
    def zero_ns(self) -> int | None:
        """When the load began; None before."""

    @property
    def counters(self) -> Mapping[str, int]:
        """What was not understood, by name."""

    def trip(self) -> None:
        """Fail as a drive does whose controller has left the bus."""


class _Maker(Protocol):
    def __call__(
        self, rig: Rig, load: LoadProfile, seed: int = 0, truth_duration_s: float = 0.0
    ) -> SimulatedMotorDriver:
        """Make the drive of a rig; UserError when that doesn't say enough."""


SIMULATED_DRIVES: Final[dict[str, _Maker]] = {
    "odrive": SimulatedODrive,
    "cia402": SimulatedCia402,
    "mit": SimulatedMit,
    "moteus": SimulatedMoteus,
    "dynamixel": SimulatedDynamixel,
}
SERIAL_LINES: Final[dict[str, LineCodec]] = {"dynamixel": CODEC}
"""How those that hang on a serial line pack their frames; the others hang on a CAN bus."""
