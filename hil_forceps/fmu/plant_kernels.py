"""What the plant's unit does at a sample of the drive: the project's own steps over one sample, nothing else.

`values` are the unit's variables in the order of `plant_variables`, `memory` is what it keeps from step to step.
"""

import math
from typing import Any

import numpy as np
from numba.np.unsafe import ndarray as fixed
from numpy.typing import NDArray

from hil_forceps.model.closed_loop import Counts, amplified, over_sample, record, rest_state, step_constants
from hil_forceps.model.composition import Physics, encoder_rad, motor_viscosity_N_m_s_per_rad
from hil_forceps.model.current import current_step
from hil_forceps.model.drive_law import DriveState, drive_sample, quantise
from hil_forceps.model.kernel import kernel
from hil_forceps.model.linear.gains import SHORT, SIZE, fill_all, fill_multiples
from hil_forceps.model.physics import State, kind_of
from hil_forceps.model.step.whole_step import decays, suits

Vector = NDArray[np.float64]
_tuple: Any = fixed.to_fixed_tuple

# Places among the values, behind those of `Physics`.
PHYSICS = len(Physics._fields)
SAMPLE_TIME, KP, KI, KD, CUTOFF, CASCADE, LIMIT, COUNTS, LOOP, STEPS = range(PHYSICS, PHYSICS + 10)
START_ANGLE, START_TENSION, START_CURRENT = range(STEPS + 1, STEPS + 4)
REFERENCE, CURRENT, LOAD = range(START_CURRENT + 1, START_CURRENT + 4)
# As `record` writes a row, and what is true beside what the sensors show.
OUTPUTS = LOAD + 1
SHOWN_ANGLE, SHOWN_CURRENT, JAW_ANGLE, ROW_LOAD, TENSION, ELONGATION, SPEED, JAW_SPEED = range(OUTPUTS, OUTPUTS + 8)
TRUE_ANGLE, TRUE_CURRENT, COMMAND = range(JAW_SPEED + 1, JAW_SPEED + 4)
VALUES = COMMAND + 1

MAX_STEPS = 16  # of the plant in a sample
MAX_DELAY_SAMPLES = 1000
STATE_FIELDS, DRIVE_FIELDS = len(State._fields), len(DriveState._fields)
_DRIVE = STATE_FIELDS
_SAMPLE, _PLACE, _LOAD_BEFORE = range(_DRIVE + DRIVE_FIELDS, _DRIVE + DRIVE_FIELDS + 3)
_GAINS = _LOAD_BEFORE + 1
_WHOLE = _GAINS + (SHORT + 2) * SIZE
_KEEPS = _WHOLE + MAX_STEPS * SIZE
_RING = _KEEPS + MAX_STEPS
MEMORY = _RING + MAX_DELAY_SAMPLES + 2

PROBLEMS = (
    "drive.sample_time_s and the plant's numbers must be positive",
    f"plant_steps_per_sample must be from 1 to {MAX_STEPS}",
    f"effects.actuation_delay.delay_s may be {MAX_DELAY_SAMPLES} samples of the drive at most",
    "the simulation diverges; check the parameters, the drive's gains and the inputs",
)
_NO_SENSE, _BAD_STEPS, _LONG_DELAY, _DIVERGES = 1, 2, 3, 4


@kernel
def prepare(values: Vector, memory: Vector, time_ns: int) -> int:  # noqa: ARG001 - what every kernel of a unit takes
    """Make what the steps have in common; called anew when a parameter has changed."""
    p = Physics(*_tuple(values[:PHYSICS], PHYSICS))
    sample_s = values[SAMPLE_TIME]
    if not (sample_s > 0.0 and p.r_m > 0.0 and p.r_j > 0.0 and p.I_m > 0.0 and p.I_j > 0.0 and p.k > 0.0):
        return _NO_SENSE
    if not (values[STEPS] >= 1.0 and values[STEPS] <= MAX_STEPS):
        return _BAD_STEPS
    if not p.actuation_delay_delay_s <= MAX_DELAY_SAMPLES * sample_s:
        return _LONG_DELAY
    steps = math.floor(values[STEPS])
    step_s = sample_s / steps
    viscosity = motor_viscosity_N_m_s_per_rad(p, 0.0)
    fill_all(memory[_GAINS:_WHOLE].reshape((SHORT + 2, SIZE)), p, viscosity, step_s)
    fill_multiples(memory[_WHOLE : _WHOLE + steps * SIZE].reshape((steps, SIZE)), p, viscosity, step_s)
    memory[_KEEPS : _KEEPS + steps] = decays(p, steps, step_s)
    return 0


@kernel
def begin(values: Vector, memory: Vector, time_ns: int) -> int:
    """Put the forceps to rest at the start's angle, tension and current, with the load that the input has."""
    problem = prepare(values, memory, time_ns)
    if problem != 0:
        return problem
    p = Physics(*_tuple(values[:PHYSICS], PHYSICS))
    current, angle = values[START_CURRENT], values[START_ANGLE]
    x = rest_state(p, angle, values[START_TENSION], current)
    memory[:STATE_FIELDS] = np.array(x)
    memory[_DRIVE:_SAMPLE] = np.array(DriveState(0.0, encoder_rad(p, angle), 0.0, current))
    memory[_SAMPLE], memory[_PLACE], memory[_LOAD_BEFORE] = 0.0, 0.0, values[LOAD]
    memory[_RING:] = np.full(MAX_DELAY_SAMPLES + 2, current)
    values[COMMAND] = current
    _tell(values, p, x)
    return 0


@kernel
def _tell(values: Vector, p: Physics, x: State) -> None:
    """Write what the sensors show, and what is true."""
    record(values[OUTPUTS : OUTPUTS + 8].reshape((8, 1)), 0, p, x, values[LOAD])
    values[SHOWN_ANGLE] = quantise(values[SHOWN_ANGLE], _quantum_rad(values))
    values[SHOWN_CURRENT] = (1.0 + p.current_gain_relative_error) * x.current_A + p.current_offset_offset_A
    values[TRUE_ANGLE], values[TRUE_CURRENT] = x.theta_m_rad, x.current_A


@kernel
def _quantum_rad(values: Vector) -> float:
    """Return the angle of an encoder's count; 0 for an encoder without counts."""
    return 2.0 * math.pi / values[COUNTS] if values[COUNTS] > 0.0 else 0.0


@kernel
def _law(values: Vector) -> Vector:
    """Return the law's numbers, as `drive_law.law_vector` has them for a rig."""
    share = -math.expm1(-2.0 * math.pi * values[CUTOFF] * values[SAMPLE_TIME])
    error_first = 1.0
    gains = (values[SAMPLE_TIME], values[KP], values[KI], values[KD])
    return np.array([gains[0], gains[1], gains[2], gains[3], share, values[LIMIT], error_first, values[CASCADE]])


@kernel
def advance(values: Vector, memory: Vector, time_ns: int) -> int:  # noqa: ARG001 - drifts count from the start
    """Go on by a sample of the drive with the inputs held."""
    p = Physics(*_tuple(values[:PHYSICS], PHYSICS))
    x = State(*_tuple(memory[:STATE_FIELDS], STATE_FIELDS))
    drive = DriveState(*_tuple(memory[_DRIVE:_SAMPLE], DRIVE_FIELDS))
    angle = quantise(encoder_rad(p, x.theta_m_rad), _quantum_rad(values))
    commanded = values[CURRENT]
    if values[LOOP] != 0.0:
        drive = drive_sample(_law(values), drive, values[REFERENCE], angle)
        commanded = drive.current_A
    values[COMMAND] = commanded
    steps = math.floor(values[STEPS])
    counts = Counts(steps, steps, values[SAMPLE_TIME] / steps)
    c = current_step(counts.step_s, steps, p.actuation_delay_delay_s, p.electrical_lag_time_constant_s)
    size, place = c.whole_samples + 2, math.floor(memory[_PLACE])
    place = place + 1 if place + 1 < size else 0
    memory[_RING + place] = amplified(p, commanded)
    older, newer = place - c.whole_samples - 1, place - c.whole_samples
    old = memory[_RING + (older if older >= 0 else older + size)]
    new = memory[_RING + (newer if newer >= 0 else newer + size)]
    kind = kind_of(p)
    wholly = steps if suits(p, kind, steps) else 0
    whole = memory[_WHOLE : _WHOLE + wholly * SIZE].reshape((wholly, SIZE))
    gains = memory[_GAINS:_WHOLE].reshape((SHORT + 2, SIZE))
    # A load that has changed since the last sample has jumped at the start of this one.
    load = (memory[_LOAD_BEFORE], values[LOAD], -1.0 if values[LOAD] == memory[_LOAD_BEFORE] else 0.0)
    constants, sample = step_constants(p, counts.step_s), math.floor(memory[_SAMPLE])
    keeps = memory[_KEEPS : _KEEPS + wholly]
    x = over_sample(p, kind, gains, whole, keeps, c, counts, constants, x, (old, new), load, sample, 0)
    memory[:STATE_FIELDS] = np.array(x)
    memory[_DRIVE:_SAMPLE] = np.array(drive)
    memory[_SAMPLE], memory[_PLACE], memory[_LOAD_BEFORE] = sample + 1.0, float(place), values[LOAD]
    _tell(values, p, x)
    return 0 if math.isfinite(x.theta_m_rad + x.theta_j_rad + x.omega_m_rad_per_s + x.omega_j_rad_per_s) else _DIVERGES
