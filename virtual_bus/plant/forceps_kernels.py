"""Motor, wire, jaw, load, sensors and position loop together: what one drive sample does to the world, as kernels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from virtual_bus.kernel import kernel, subroutine
from virtual_bus.plant.load import load_at, segment_of
from virtual_bus.plant.plant import TruthParameters, advance, elongation
from virtual_bus.plant.position_loop import LoopParameters, LoopState, loop_step
from virtual_bus.plant.sensors import Reading, SensorParameters, read_sensors

# Where the parts of an array of all numbers begin.
LOOP_AT = 4  # behind the plant's state
LOOP_NUMBERS_AT = len(TruthParameters._fields)
SENSORS_AT = LOOP_NUMBERS_AT + len(LoopParameters._fields)
# Where the parts of all that a forceps remembers begin: what moves, its numbers, then the current that was held, the
# angle that was latched, and the longest step of the plant.
NUMBERS_AT = LOOP_AT + len(LoopState._fields)
MORE_AT = NUMBERS_AT + SENSORS_AT + len(SensorParameters._fields)


class Truth(NamedTuple):
    """What really was at one instant."""

    theta_m_rad: float
    theta_j_rad: float
    tau_w_N_m: float
    elongation_m: float
    current_A: float


@subroutine
def unpacked_plant(v: NDArray[np.float64]) -> TruthParameters:
    """Give an array the names of `TruthParameters`, in its order."""
    return TruthParameters(v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10])


@subroutine
def unpacked_loop(v: NDArray[np.float64]) -> LoopParameters:
    """Give an array the names of `LoopParameters`, in its order."""
    return LoopParameters(v[0], v[1], v[2], v[3], v[4], v[5], v[6])


@subroutine
def unpacked_sensors(v: NDArray[np.float64]) -> SensorParameters:
    """Give an array the names of `SensorParameters`, in its order."""
    return SensorParameters(v[0], v[1], v[2], v[3])


@kernel
def hold_and_move(
    state: NDArray[np.float64],
    loop: NDArray[np.float64],
    plant_numbers: NDArray[np.float64],
    loop_numbers: NDArray[np.float64],
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    active: bool,
    reference_raw: int,
    theta_raw: int,
    start_ns: int,
    end_ns: int,
    max_step_s: float,
) -> float:
    """Run the loop on the angle latched at `start_ns` and hold its current, returned in A, until `end_ns`.

    Times are those of the load. Changes `state` and `loop` in place. Parameters come as arrays, which cross from
    Python into compiled code ten times faster than tuples.
    """
    memory = LoopState(loop[0], loop[1], loop[2])
    memory, current = loop_step(memory, unpacked_loop(loop_numbers), active, reference_raw, theta_raw)
    loop[0], loop[1], loop[2] = memory.integral_rad_s, memory.speed_rad_per_s, memory.theta_raw
    advance(state, unpacked_plant(plant_numbers), current, load_time_ns, load_N_m, start_ns, end_ns, max_step_s)
    return current


@kernel
def move(
    state: NDArray[np.float64],
    plant_numbers: NDArray[np.float64],
    current_A: float,
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    start_ns: int,
    end_ns: int,
    max_step_s: float,
) -> None:
    """Hold `current_A` from `start_ns` to `end_ns`, times of the load. Changes `state` in place."""
    advance(state, unpacked_plant(plant_numbers), current_A, load_time_ns, load_N_m, start_ns, end_ns, max_step_s)


@kernel
def latch(
    state: NDArray[np.float64],
    current_A: float,
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    time_ns: int,
    sensor_numbers: NDArray[np.float64],
    noise: tuple[float, float, float],
) -> Reading:
    """Read all sensors at `time_ns` of the load, `current_A` being what was held until now."""
    tau_w = load_at(load_time_ns, load_N_m, segment_of(load_time_ns, time_ns), time_ns)
    return read_sensors(state[0], current_A, state[2], tau_w, unpacked_sensors(sensor_numbers), noise)


@kernel
def latch_and_move(
    moving: NDArray[np.float64],
    numbers: NDArray[np.float64],
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    current_A: float,
    noise_0: float,
    noise_1: float,
    noise_2: float,
    active: bool,
    reference_raw: int,
    start_ns: int,
    end_ns: int,
    max_step_s: float,
) -> tuple[int, int, int, int, float]:
    """Do `latch`, then `hold_and_move`: one way into compiled code a drive sample. Return the reading, the current.

    `moving`: state and loop; `numbers`: of plant, loop and sensors. Two arrays instead of five, since each costs time
    on the way in; and a plain tuple, since building a named one costs more on the way out than all else.
    """
    state, loop = moving[:LOOP_AT], moving[LOOP_AT:]
    plant_numbers, loop_numbers = numbers[:LOOP_NUMBERS_AT], numbers[LOOP_NUMBERS_AT:SENSORS_AT]
    sensor_numbers = numbers[SENSORS_AT:]
    noise = (noise_0, noise_1, noise_2)
    reading = latch(state, current_A, load_time_ns, load_N_m, start_ns, sensor_numbers, noise)
    held_A = hold_and_move(
        state,
        loop,
        plant_numbers,
        loop_numbers,
        load_time_ns,
        load_N_m,
        active,
        reference_raw,
        reading.theta_m,
        start_ns,
        end_ns,
        max_step_s,
    )
    return reading.theta_m, reading.current, reading.theta_j, reading.tau_w, held_A


@kernel
def truth_at(
    state: NDArray[np.float64],
    current_A: float,
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    time_ns: int,
    plant_numbers: NDArray[np.float64],
) -> Truth:
    """Collect what really is at `time_ns` of the load."""
    tau_w = load_at(load_time_ns, load_N_m, segment_of(load_time_ns, time_ns), time_ns)
    x = elongation(state[0], state[2], unpacked_plant(plant_numbers))
    return Truth(state[0], state[2], tau_w, x, current_A)


@kernel
def follow_and_sense(
    memory: NDArray[np.float64],
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    noise: NDArray[np.float64],
    start_ns: int,
    end_ns: int,
    reference_rad: float,
    sensed: NDArray[np.float64],
) -> None:
    """Follow a reference from one sample to the next, and write to `sensed` what the sensors say then, in SI.

    That is θ_m, current, θ_j and τ_w, as `virtual_bus.direct.DirectSample` has them. `start_ns` equal to `end_ns` takes
    the first sample. `memory` is that of `SimulatedForceps.memory`, changed in place.
    """
    moving, numbers, more = memory[:NUMBERS_AT], memory[NUMBERS_AT:MORE_AT], memory[MORE_AT:]
    state, loop = moving[:LOOP_AT], moving[LOOP_AT:]
    plant_numbers, sensor_numbers = numbers[:LOOP_NUMBERS_AT], numbers[SENSORS_AT:]
    if start_ns < end_ns:
        more[0] = hold_and_move(
            state,
            loop,
            plant_numbers,
            numbers[LOOP_NUMBERS_AT:SENSORS_AT],
            load_time_ns,
            load_N_m,
            True,
            round(reference_rad / ANGLE_LSB_RAD),
            int(more[1]),
            start_ns,
            end_ns,
            more[2],
        )
    normals = (noise[0], noise[1], noise[2])
    reading = latch(state, more[0], load_time_ns, load_N_m, end_ns, sensor_numbers, normals)
    more[1] = reading.theta_m
    truth = truth_at(state, more[0], load_time_ns, load_N_m, end_ns, plant_numbers)
    sensed[0] = truth.theta_m_rad if sensor_numbers[0] <= 0.0 else reading.theta_m * ANGLE_LSB_RAD
    sensed[1] = truth.current_A if sensor_numbers[1] == 0.0 else reading.current * CURRENT_LSB_A
    sensed[2] = truth.theta_j_rad
    sensed[3] = truth.tau_w_N_m
