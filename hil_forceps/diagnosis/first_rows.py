"""The state of plant and drive before the first row of a run, as far as its first rows tell."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.model import closed_loop, drive_law, parameters
from hil_forceps.model.closed_loop import Start
from hil_forceps.model.drive_law import DriveState

Vector = NDArray[np.float64]

ROWS_FOR_INTEGRAL = 40
ROWS_FOR_SPEED = 12


def make_starts(records: Sequence[Record], theta: Vector, law: Vector) -> tuple[Start, ...]:
    """Return the state before the first row of each run, from its first rows."""
    return tuple(_start(record, theta, law) for record in records)


def _start(record: Record, theta: Vector, law: Vector) -> Start:
    angle = record.channels["theta_m_rad"]
    few = min(ROWS_FOR_SPEED, angle.size)
    speed = float(np.polyfit(record.time_s[:few], angle[:few], 1)[0]) if few > 1 else 0.0
    if abs(angle[few - 1] - angle[0]) < 2.5 * _quantum(angle):
        speed = 0.0
    load = float(record.tau_w_N_m[0]) if record.tau_w_N_m is not None else 0.0
    at_rest = closed_loop.rest(theta, float(angle[0]), load / theta[parameters.index("forceps.jaw_pulley_radius_m")])
    current = record.channels["current_A"]
    period = float(law[drive_law.SAMPLE_TIME])
    integral = _integral(record, law, speed)
    ratio = (
        theta[parameters.index("forceps.motor_pulley_radius_m")]
        / theta[parameters.index("forceps.jaw_pulley_radius_m")]
    )
    plant = at_rest.plant._replace(omega_m_rad_per_s=speed, omega_j_rad_per_s=speed * float(ratio))
    held = float(np.mean(current[: min(ROWS_FOR_SPEED, current.size)]))
    plant = plant._replace(current_A=held)
    return Start(plant, DriveState(integral, float(angle[0]) - speed * period, speed, held))


def _integral(record: Record, law: Vector, speed: float) -> float:
    """Return the drive's integral before the first row: what the measured current asks for, over the first rows."""
    ki = float(law[drive_law.KI])
    if ki <= 0.0:
        return 0.0
    rows = min(ROWS_FOR_INTEGRAL, record.time_s.size - 1)
    angle, reference = record.channels["theta_m_rad"][:rows], record.reference_rad[:rows]
    idle = DriveState(0.0, float(angle[0]) - speed * record.period_s, speed, 0.0)
    without = drive_law.law_current(law, reference, angle, idle)
    missing = record.channels["current_A"][1 : rows + 1] - without
    limit = float(law[drive_law.LIMIT])
    free = np.abs(without) < limit
    wanted = float(np.mean(missing[free])) if free.any() else 0.0
    return max(-limit, min(limit, wanted)) / ki


def _quantum(angle: Vector) -> float:
    steps = np.abs(np.diff(angle))
    steps = steps[steps > 1e-12]
    return float(steps.min()) if steps.size else 0.0
