"""A forceps with effects on a bench, sampled by a drive: `SimulatedForceps` where the rig has any."""

import numpy as np
from numpy.typing import NDArray

from virtual_bus.effects.command import Queue, acting_command, empty_queue, push_command
from virtual_bus.effects.composition import EffectNumbers, encoder_angle
from virtual_bus.effects.motion import advance_with_effects
from virtual_bus.effects.physics import Environment, elongation_of
from virtual_bus.effects.start import rest_with_effects
from virtual_bus.kernel import kernel
from virtual_bus.plant.forceps import NOT_STARTED_NS, Sensed, Truth
from virtual_bus.plant.forceps_kernels import unpacked_loop, unpacked_plant
from virtual_bus.plant.load import LoadProfile
from virtual_bus.plant.plant import TruthParameters
from virtual_bus.plant.position_loop import LoopParameters, LoopState, idle_loop, loop_step
from virtual_bus.plant.sensors import Reading, SensorParameters, encoder_raw, noise_source, read_sensors

NO_ENVIRONMENT = Environment(0.0, 0.0)


@kernel
def hold_and_move_with_effects(
    state: NDArray[np.float64],
    queue: Queue,
    loop: NDArray[np.float64],
    plant_numbers: NDArray[np.float64],
    e: EffectNumbers,
    loop_numbers: NDArray[np.float64],
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    counts_per_rev: float,
    active: bool,
    reference_raw: int,
    start_ns: int,
    end_ns: int,
    max_step_s: float,
    rest_ns: NDArray[np.int64],
    taps: NDArray[np.float64],
) -> None:
    """Run the loop on the encoder at `start_ns` and move on to `end_ns`; `taps` as they were `rest_ns` before that."""
    theta_raw = encoder_raw(encoder_angle(e, state[0]), counts_per_rev)
    memory = LoopState(loop[0], loop[1], loop[2])
    memory, command = loop_step(memory, unpacked_loop(loop_numbers), active, reference_raw, theta_raw)
    loop[0], loop[1], loop[2] = memory.integral_rad_s, memory.speed_rad_per_s, memory.theta_raw
    push_command(queue, acting_command(command, e), round(e.actuation_delay_delay_s * 1.0e9))
    p = unpacked_plant(plant_numbers)
    advance_with_effects(
        state, queue, p, e, NO_ENVIRONMENT, load_time_ns, load_N_m, start_ns, end_ns, max_step_s, end_ns - rest_ns, taps
    )


@kernel
def move_with_effects(
    state: NDArray[np.float64],
    queue: Queue,
    plant_numbers: NDArray[np.float64],
    e: EffectNumbers,
    current_A: float,
    load_time_ns: NDArray[np.int64],
    load_N_m: NDArray[np.float64],
    start_ns: int,
    end_ns: int,
    max_step_s: float,
    rest_ns: NDArray[np.int64],
    taps: NDArray[np.float64],
) -> None:
    """Ask for `current_A` from `start_ns` to `end_ns`; `taps` as they were `rest_ns` before that."""
    push_command(queue, acting_command(current_A, e), round(e.actuation_delay_delay_s * 1.0e9))
    p = unpacked_plant(plant_numbers)
    advance_with_effects(
        state, queue, p, e, NO_ENVIRONMENT, load_time_ns, load_N_m, start_ns, end_ns, max_step_s, end_ns - rest_ns, taps
    )


class ForcepsWithEffects:
    """A forceps with its motor on a bench and a rig's effects in it; same use as `SimulatedForceps`.

    What drifts counts from the start of the load. The loop works on what the encoder says now; a channel that is late
    is late in what is read alone. Nothing can be read before it happens: where a channel should be early, the others
    are late by as much.
    """

    def __init__(
        self,
        plant: TruthParameters,
        effects: EffectNumbers,
        loop: LoopParameters,
        sensors: SensorParameters,
        load: LoadProfile,
        max_step_s: float,
        jaw_start_rad: float,
        seed: int,
    ) -> None:
        self._plant, self._effects = plant, effects
        self._plant_numbers = np.array(plant)
        self._loop_numbers = np.array(loop)
        self._sensors = sensors
        self._load = load
        self._max_step_s = max_step_s
        self._noise = noise_source(seed)
        self._state = rest_with_effects(plant, effects, jaw_start_rad)
        self._queue = empty_queue(effects.actuation_delay_delay_s, loop.sample_time_s)
        start = encoder_angle(effects, float(self._state[0]))
        self._loop_state = idle_loop(encoder_raw(start, sensors.counts_per_rev))
        self._zero_ns = NOT_STARTED_NS
        self._set_up_skew(round(loop.sample_time_s * 1.0e9))

    def _set_up_skew(self, period_ns: int) -> None:
        e = self._effects
        skews = np.array(
            [e.channel_skew_theta_m_s, e.channel_skew_current_s, e.channel_skew_theta_j_s, e.channel_skew_tau_w_s]
        )
        late_ns = np.rint((skews - min(0.0, float(skews.min()))) * 1.0e9).astype(np.int64)
        periods, self._rest_ns = np.divmod(late_ns, period_ns)
        self._late = [int(number) for number in periods]
        self._load_late_ns = int(late_ns[3])
        # The last taps of each period, the newest at `_newest`; before the start all stood still.
        self._history = np.tile([self._state[0], 0.0, self._state[2], self._state[2]], (max(self._late) + 1, 1))
        self._newest = 0

    def start_load(self, now_ns: int) -> None:
        """Let the load profile begin now, and what drifts."""
        self._zero_ns = now_ns

    def sensed(self, now_ns: int) -> Sensed:
        """Return what sensors without noise and rounding would say now, the end of the last `run`."""
        e, history = self._effects, self._history
        theta_m, current, theta_j = (
            float(history[(self._newest - late) % len(history), channel]) for channel, late in enumerate(self._late[:3])
        )
        return Sensed(
            encoder_angle(e, theta_m),
            (1.0 + e.current_gain_relative_error) * current + e.current_offset_offset_A,
            theta_j,
            self._load.torque_at(now_ns - self._zero_ns - self._load_late_ns),
        )

    def read(self, now_ns: int) -> Reading:
        """Latch all sensors at this instant, the end of the last `run`."""
        return read_sensors(*self.sensed(now_ns), self._sensors, next(self._noise))

    def run(self, now_ns: int, until_ns: int, _theta_raw: int, reference_raw: int | None) -> None:
        """Close the loop on the encoder as it is now and move on; no current without a reference (raw, unwrapped)."""
        self._newest = (self._newest + 1) % len(self._history)
        hold_and_move_with_effects(
            self._state,
            self._queue,
            self._loop_state,
            self._plant_numbers,
            self._effects,
            self._loop_numbers,
            self._load.time_ns,
            self._load.torque_N_m,
            self._sensors.counts_per_rev,
            reference_raw is not None,
            reference_raw or 0,
            now_ns - self._zero_ns,
            until_ns - self._zero_ns,
            self._max_step_s,
            self._rest_ns,
            self._history[self._newest],
        )

    def hold(self, now_ns: int, until_ns: int, current_A: float) -> None:
        """Move on under a current that a drive outside asks for, without this world's own loop."""
        self._newest = (self._newest + 1) % len(self._history)
        move_with_effects(
            self._state,
            self._queue,
            self._plant_numbers,
            self._effects,
            current_A,
            self._load.time_ns,
            self._load.torque_N_m,
            now_ns - self._zero_ns,
            until_ns - self._zero_ns,
            self._max_step_s,
            self._rest_ns,
            self._history[self._newest],
        )

    def sample(self, now_ns: int, until_ns: int, reference_raw: int | None) -> tuple[int, int, int, int]:
        """Do `read` and then `run`; return the fields of `Reading`."""
        reading = self.read(now_ns)
        self.run(now_ns, until_ns, reading.theta_m, reference_raw)
        return reading.theta_m, reading.current, reading.theta_j, reading.tau_w

    def truth(self, now_ns: int) -> Truth:
        """Return what really is at this instant; the current is what it was until now."""
        theta_m, theta_j = float(self._state[0]), float(self._state[2])
        x = elongation_of(theta_m - float(self._state[11]), theta_j, self._plant, self._effects)
        return Truth(theta_m, theta_j, self._load.torque_at(now_ns - self._zero_ns), x, float(self._state[10]))
