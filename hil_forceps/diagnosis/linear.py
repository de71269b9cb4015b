"""The closed loop as a linear system: what small torques, forces and loads do to the recorded channels, by frequency.

Only for looking: which harmonics are worth a simulation, and whether what is left after naming varies with some
variable. Everything that ends in a result goes through the simulator.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from hil_forceps.diagnosis.spectrum import Flat, Layout, Matrix, fill, spectrum_of
from hil_forceps.model.two_inertia import continuous
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import DriveLaw

Vector = NDArray[np.float64]
Vectors = NDArray[np.float64]  # one a row
Complex = NDArray[np.complex128]
Place = Literal["motor", "wire", "jaw"]


class Response(NamedTuple):
    """Frequency response of one run's grid: place → channel → complex gain per bin."""

    gains: Mapping[Place, Mapping[str, Complex]]


def responses(
    plant: PlantParameters, law: DriveLaw, rows: int, period_s: float, integral_per_s: float = 0.0
) -> Response:
    """Return what a motor torque [N m], a wire force [N] and a jaw load [N m] do to θ_m and θ_j in closed loop.

    `integral_per_s`: of the integral of θ_m, as added to it.
    """
    frequency = fft.rfftfreq(rows, period_s)
    omega = 2.0 * np.pi * np.maximum(frequency, 1e-3)
    a, b = continuous(plant)
    inputs = np.column_stack(
        (b[:, 0], b[:, 1], -plant.motor_pulley_radius_m * b[:, 0] - plant.jaw_pulley_radius_m * b[:, 1])
    )
    states = np.linalg.solve(1j * omega[:, None, None] * np.eye(4) - a, np.broadcast_to(inputs, (omega.size, 4, 3)))
    motor, jaw = states[:, 0, :], states[:, 2, :]
    loop = plant.torque_constant_N_m_per_A * _controller(law, omega)
    closed = motor / (1.0 + loop * motor[:, 0])[:, None]
    torque = -loop[:, None] * closed
    jaw = jaw + jaw[:, :1] * torque
    closed *= (1.0 + integral_per_s * period_s / (1.0 - np.exp(-1j * omega * period_s)))[:, None]
    places: tuple[Place, ...] = ("motor", "jaw", "wire")
    return Response({place: {"theta_m_rad": closed[:, k], "theta_j_rad": jaw[:, k]} for k, place in enumerate(places)})


def _controller(law: DriveLaw, omega: Vector) -> Complex:
    period = law.sample_time_s
    back = np.exp(-1j * omega * period)
    share = -np.expm1(-2.0 * np.pi * law.derivative_cutoff_Hz * period)
    speed = share * (1.0 - back) / (period * (1.0 - (1.0 - share) * back))
    hold = (1.0 - back) / (1j * omega * period)
    pid = law.kp_A_per_rad + law.ki_A_per_rad_s * period / (1.0 - back) + law.kd_A_s_per_rad * speed
    return np.asarray(pid * hold)


def columns(layout: Layout, responses_of: Sequence[Response], place: Place, signals: Sequence[Vectors]) -> Matrix:
    """Return the flat sensitivities to disturbances at a place, one column each; `signals`: their courses in each run.

    Single precision: nothing that ends in a result hangs on it.
    """
    found = np.zeros((len(signals[0]), layout.size), dtype=np.float32)
    spectra = [fft.rfft(each.astype(np.float32)) for each in signals]
    for part in layout.parts:
        gain = responses_of[part.run].gains[place].get(part.channel)
        if gain is None:
            continue
        answers = fft.irfft(spectra[part.run] * gain.astype(np.complex64), part.rows)
        found[:, part.start : part.stop] = spectrum_of(part, answers).view(np.float32)
    return np.ascontiguousarray(found.T)


def direct_column(layout: Layout, channel: str, signals: list[Vector]) -> Flat:
    """Return the flat sensitivity to something added to a channel itself."""
    flat = np.zeros(layout.size, dtype=np.float32)
    for part in layout.parts:
        if part.channel == channel:
            fill(flat, part, signals[part.run])
    return flat
