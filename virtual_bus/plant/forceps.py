"""A simulated forceps with its motor, load, sensors and position loop, moved from one drive sample to the next."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from virtual_bus.plant.forceps_kernels import (
    LOOP_AT,
    LOOP_NUMBERS_AT,
    SENSORS_AT,
    Truth,
    hold_and_move,
    latch,
    latch_and_move,
    move,
    truth_at,
)
from virtual_bus.plant.load import LoadProfile
from virtual_bus.plant.plant import TruthParameters, rest_state
from virtual_bus.plant.position_loop import LoopParameters, idle_loop
from virtual_bus.plant.sensors import Reading, SensorParameters, encoder_raw, noise_source

__all__ = ["NOT_STARTED_NS", "Sensed", "SimulatedForceps", "Truth"]

NOT_STARTED_NS = 1 << 62  # a zero so late that only the first torque of a load profile ever counts


class Sensed(NamedTuple):
    """What sensors without noise and rounding say at one instant."""

    theta_m_rad: float
    current_A: float
    theta_j_rad: float
    tau_w_N_m: float


class SimulatedForceps:
    """A forceps with its motor on a bench, sampled by a drive; knows neither protocol nor bus.

    Between two drive samples the current is constant, so the world moves a whole period at once: `read` what there
    is at the instant, then `run` to the next.
    """

    def __init__(
        self,
        plant: TruthParameters,
        loop: LoopParameters,
        sensors: SensorParameters,
        load: LoadProfile,
        max_step_s: float,
        jaw_start_rad: float,
        seed: int,
    ) -> None:
        self._numbers = np.array([*plant, *loop, *sensors])
        self._plant_numbers, self._loop_numbers, self._sensor_numbers = np.split(
            self._numbers, [LOOP_NUMBERS_AT, SENSORS_AT]
        )
        self._load = load
        self._max_step_s = max_step_s
        self._noise = noise_source(seed)
        at_rest = rest_state(plant, jaw_start_rad)
        idle = idle_loop(encoder_raw(float(at_rest[0]), sensors.counts_per_rev))
        self._moving = np.concatenate((at_rest, idle))
        self._state, self._loop_state = self._moving[:LOOP_AT], self._moving[LOOP_AT:]
        self._zero_ns = NOT_STARTED_NS
        self._current_A = 0.0

    def start_load(self, now_ns: int) -> None:
        """Let the load profile begin now."""
        self._zero_ns = now_ns

    def read(self, now_ns: int) -> Reading:
        """Latch all sensors at this instant, the end of the last `run`."""
        return latch(
            self._state,
            self._current_A,
            self._load.time_ns,
            self._load.torque_N_m,
            now_ns - self._zero_ns,
            self._sensor_numbers,
            next(self._noise),
        )

    def run(self, now_ns: int, until_ns: int, theta_raw: int, reference_raw: int | None) -> None:
        """Close the loop on `theta_raw`, read now, and move on; no current without a reference (raw, unwrapped)."""
        self._current_A = hold_and_move(
            self._state,
            self._loop_state,
            self._plant_numbers,
            self._loop_numbers,
            self._load.time_ns,
            self._load.torque_N_m,
            reference_raw is not None,
            theta_raw if reference_raw is None else reference_raw,
            theta_raw,
            now_ns - self._zero_ns,
            until_ns - self._zero_ns,
            self._max_step_s,
        )

    def hold(self, now_ns: int, until_ns: int, current_A: float) -> None:
        """Move on under a current that a drive outside asks for, without this world's own loop."""
        self._current_A = current_A
        move(
            self._state,
            self._plant_numbers,
            current_A,
            self._load.time_ns,
            self._load.torque_N_m,
            now_ns - self._zero_ns,
            until_ns - self._zero_ns,
            self._max_step_s,
        )

    def sample(self, now_ns: int, until_ns: int, reference_raw: int | None) -> tuple[int, int, int, int]:
        """Do `read` and then `run` on its angle, in half the time of both; return the fields of `Reading`."""
        zero_ns = self._zero_ns
        theta_m, current, theta_j, tau_w, self._current_A = latch_and_move(
            self._moving,
            self._numbers,
            self._load.time_ns,
            self._load.torque_N_m,
            self._current_A,
            *next(self._noise),
            reference_raw is not None,
            0 if reference_raw is None else reference_raw,
            now_ns - zero_ns,
            until_ns - zero_ns,
            self._max_step_s,
        )
        return theta_m, current, theta_j, tau_w

    def memory(self) -> NDArray[np.float64]:
        """Return all that it remembers but the load and the noise, for `forceps_kernels.follow_and_sense`."""
        return np.array([*self._moving, *self._numbers, self._current_A, self._moving[-1], self._max_step_s])

    def truth(self, now_ns: int) -> Truth:
        """Return what really is at this instant; the current is the one held until now."""
        return truth_at(
            self._state,
            self._current_A,
            self._load.time_ns,
            self._load.torque_N_m,
            now_ns - self._zero_ns,
            self._plant_numbers,
        )

    def sensed(self, now_ns: int) -> Sensed:
        """Return what sensors without noise and rounding would say now: the truth."""
        truth = self.truth(now_ns)
        return Sensed(truth.theta_m_rad, truth.current_A, truth.theta_j_rad, truth.tau_w_N_m)
