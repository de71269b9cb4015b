"""An estimator as a unit: samples of angle and current in; torque, elongation and the motor's reference out."""

import numpy as np

from hil_forceps.estimation.corrections import IGNORED, tuning_of
from hil_forceps.estimation.interface import Sample
from hil_forceps.estimation.registry import ALGORITHMS
from hil_forceps.fmu import estimator_kernels as k
from hil_forceps.fmu.rig_numbers import rig_numbers
from hil_forceps.fmu.unit import Unit, Variable
from hil_forceps.model.parameters import NAMES, vector
from hil_forceps.rig import Rig
from hil_forceps.rig.schema import AlgorithmId

_DEFAULT_SAMPLE_TIME_S = 1e-3


def estimator_unit(rig: Rig, algorithm: AlgorithmId, sample_time_s: float | None = None) -> Unit:
    """Return an estimator's unit for a rig; UserError when the rig doesn't know a value that is needed.

    Its samples are the communication steps; `sample_time_s` is how far apart they are meant to be, by default as far
    as the drive's.
    """
    if sample_time_s is None:
        sample_time_s = _DEFAULT_SAMPLE_TIME_S if rig.drive is None else rig.drive.sample_time_s
    offered = ALGORITHMS[algorithm]
    estimator = offered.make(rig, sample_time_s, False)  # no bus rounds them
    compiled = estimator.compiled
    assert compiled is not None
    size = estimator.start(Sample(0, 0.0, 0.0)).size
    kernels = k.Kernels(compiled.start.function, compiled.step.function, compiled.constants, size)
    theta = vector(rig)
    if offered.corrected and set(rig.effects) - IGNORED:
        advance = k.corrected(kernels, theta, tuning_of(rig, sample_time_s))
    else:
        advance = k.plain(kernels)
    return Unit(
        f"hil_forceps_estimator_{algorithm}",
        f"Reaction torque and wire elongation of wire-actuated forceps, estimated by {algorithm}",
        (*_signals(rig), *_told(rig, theta, sample_time_s)),
        k.memory_size(kernels),
        k.fresh,
        k.nothing,
        advance,
        k.PROBLEMS,
        sample_time_s,
        -1,
    )


def _signals(rig: Rig) -> list[Variable]:
    plant = rig.plant()
    signals = (
        ("theta_m_rad", "rad", "input", "motor angle as the encoder shows it"),
        ("current_A", "A", "input", "measured current"),
        ("theta_j_ref_rad", "rad", "input", "reference of the jaw angle"),
        ("tau_w_N_m", "N_m", "output", "estimated load on the jaw"),
        ("elongation_m", "m", "output", "estimated elongation of the wire"),
        ("theta_m_ref_rad", "rad", "output", "reference of the motor angle that makes up for the elongation"),
    )
    constants = (
        ("motor.torque_constant_N_m_per_A", "N_m_per_A", plant.torque_constant_N_m_per_A),
        ("forceps.motor_pulley_radius_m", "m", plant.motor_pulley_radius_m),
        ("forceps.jaw_pulley_radius_m", "m", plant.jaw_pulley_radius_m),
    )
    return [
        *(Variable(name, unit, "input" if way == "input" else "output", "continuous", 0.0, meaning)
          for name, unit, way, meaning in signals),
        *(Variable(name, unit, "local", "constant", value, "of the rig that the unit is for")
          for name, unit, value in constants),
    ]  # fmt: skip


def _told(rig: Rig, theta: np.ndarray[tuple[int], np.dtype[np.float64]], sample_time_s: float) -> list[Variable]:
    """Return what else the estimator is made for, to be read."""
    told = {name: value for name, value in zip(NAMES, theta.tolist(), strict=True) if name.startswith("forceps.")}
    for effect, values in rig.effects.items():
        told |= {f"effects.{effect}.{name}": value for name, value in values.items()}
    for name in ("forceps.motor_pulley_radius_m", "forceps.jaw_pulley_radius_m"):
        del told[name]
    known = rig_numbers()
    return [
        *(Variable(name, known[name].unit, "local", "constant", value, known[name].meaning)
          for name, value in told.items()),
        Variable("sample_time_s", "s", "local", "constant", sample_time_s, "time between samples as it is meant to be"),
    ]  # fmt: skip
