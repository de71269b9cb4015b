"""The forceps without protocol and bus: for rates that no CAN carries, and for estimators fed without its rounding."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A, angle_raw_from_rad
from hil_forceps.rig import Rig
from virtual_bus.drive import forceps_of
from virtual_bus.plant.forceps import SimulatedForceps
from virtual_bus.plant.forceps_kernels import follow_and_sense
from virtual_bus.plant.load import paper_load
from virtual_bus.plant.sensors import noise_streams


class DirectSample(NamedTuple):
    """What the sensors say at one instant, in SI."""

    time_ns: int
    theta_m_rad: float
    current_A: float  # held over the interval that ended at `time_ns`
    theta_j_rad: float
    tau_w_N_m: float


class CompiledWorld(NamedTuple):
    """The world as a kernel and what that takes, for a loop that runs compiled; see `follow_and_sense`."""

    kernel: Callable[..., None]
    memory: NDArray[np.float64]
    load_time_ns: NDArray[np.int64]
    load_N_m: NDArray[np.float64]
    noise: Callable[[int], NDArray[np.float64]]  # of the next n samples, (n, 3)


class DirectWorld:
    """A simulated forceps with the rig's own position loop, stepped one drive sample at a time.

    Encoder and current sensor round and scatter as the rig says; an ideal encoder and a current sensor without noise
    are taken as they are, without the rounding of the wire. The bench's sensors neither round nor scatter.
    """

    def __init__(self, rig: Rig, simulation: int, seed: int) -> None:
        """`simulation`: load of the paper's simulation 1 or 2, or 0 for none; it begins at time 0."""
        self._load, self._seed = paper_load(simulation), seed
        self._forceps = forceps_of(rig, self._load, seed)
        self._forceps.start_load(0)
        self._period_ns = round(rig.require_drive().sample_time_s * 1e9)
        self._is_ideal_angle = rig.encoder.counts_per_rev is None
        self._is_ideal_current = rig.noise.current_A == 0.0
        self._theta_raw = 0
        self._now_ns = 0

    def sample(self) -> DirectSample:
        """Latch all sensors now; once between two calls of `advance`."""
        now_ns = self._now_ns
        reading, sensed = self._forceps.read(now_ns), self._forceps.sensed(now_ns)
        self._theta_raw = reading.theta_m
        theta_m_rad = sensed.theta_m_rad if self._is_ideal_angle else reading.theta_m * ANGLE_LSB_RAD
        current_A = sensed.current_A if self._is_ideal_current else reading.current * CURRENT_LSB_A
        return DirectSample(now_ns, theta_m_rad, current_A, sensed.theta_j_rad, sensed.tau_w_N_m)

    def advance(self, reference_rad: float) -> None:
        """Run the position loop on what was latched and this reference, and move on by one sample."""
        end_ns = self._now_ns + self._period_ns
        self._forceps.run(self._now_ns, end_ns, self._theta_raw, angle_raw_from_rad(reference_rad))
        self._now_ns = end_ns

    def compiled(self) -> CompiledWorld | None:
        """Return this world as it is at its start, to be stepped elsewhere; None where it has effects."""
        forceps = self._forceps
        if not isinstance(forceps, SimulatedForceps):
            return None
        load, streams = self._load, noise_streams(self._seed)  # its own: this world stays at its start
        return CompiledWorld(
            follow_and_sense,
            forceps.memory(),
            load.time_ns.copy(),
            load.torque_N_m.copy(),
            lambda samples: np.column_stack([stream.standard_normal(samples) for stream in streams]),
        )
