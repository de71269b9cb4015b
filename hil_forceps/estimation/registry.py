"""Estimators by name, with the numbers of a rig bound to them."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.estimation import improved, kalman, kalman_model, previous, single
from hil_forceps.estimation.corrections import IGNORED, corrected
from hil_forceps.estimation.interface import ELONGATION, TAU_W, Compiled, Estimate, Estimator, Sample, State
from hil_forceps.rig.schema import ALGORITHM_IDS, Rig

ESTIMATOR_IDS: tuple[str, ...] = ALGORITHM_IDS
CORRECTED_IDS = ("improved", "kalman")  # take effects of the rig into account

# What the wire of `firmware_protocol` rounds to: angles to 2⁻²⁴ turn, currents to 0.2 mA.
WIRE_ANGLE_RAD = 2.0 * math.pi / 2**24
WIRE_CURRENT_A = 2.0e-4

_Vector = NDArray[np.float64]


class _Kernels(NamedTuple):
    kind: int
    start: Callable[[_Vector, int, float, float], State]
    step: Callable[[State, _Vector, int, float, float], State]


_PREVIOUS = _Kernels(single.PREVIOUS, previous.start, previous.step)
_IMPROVED = _Kernels(single.IMPROVED, improved.start, improved.step)
_KALMAN = _Kernels(single.KALMAN, kalman.start, kalman.step)


def make_estimator(estimator_id: str, rig: Rig, sample_time_s: float, *, over_wire: bool = True) -> Estimator:
    """Bind an algorithm to a rig; `sample_time_s` is the nominal time between the samples it will get.

    `over_wire=False` tells that samples come without the wire's rounding. Effects of the rig are taken into account by
    those of `CORRECTED_IDS` as far as a sample can tell them (`corrections`); the paper's own stay as published. Such
    an estimator has no `compiled`. ValueError for an id that isn't in
    `ESTIMATOR_IDS` or a sample time that isn't positive; UserError when the rig doesn't know a value that is needed.
    """
    if not (math.isfinite(sample_time_s) and sample_time_s > 0.0):
        raise ValueError(f"sample_time_s must be positive, got {sample_time_s!r}")
    made = _make(estimator_id, rig, sample_time_s, over_wire)
    return corrected(made, rig, sample_time_s) if estimator_id in CORRECTED_IDS else made


def effects_passed_over(estimator_id: str, rig: Rig) -> tuple[str, ...]:
    """Return the effects of a rig that an estimator works without: what a user should be told."""
    if estimator_id not in CORRECTED_IDS:
        return tuple(rig.effects)
    modelled = {"wire_damping"} if estimator_id == "kalman" else set()
    return tuple(name for name in rig.effects if name in IGNORED - modelled)


def _make(estimator_id: str, rig: Rig, sample_time_s: float, over_wire: bool) -> Estimator:
    plant = rig.plant()
    corner_rad_per_s = 2.0 * math.pi * rig.estimators.rfob_cutoff_Hz
    if estimator_id == "previous":
        return _bind(estimator_id, _PREVIOUS, previous.constants(plant, corner_rad_per_s))
    if estimator_id == "improved":
        return _bind(estimator_id, _IMPROVED, improved.constants(plant, corner_rad_per_s, as_published=False))
    if estimator_id == "improved_as_published":
        return _bind(estimator_id, _IMPROVED, improved.constants(plant, corner_rad_per_s, as_published=True))
    if estimator_id == "kalman":
        hold_time_s = sample_time_s if rig.drive is None else rig.drive.sample_time_s
        damping = rig.effects.get("wire_damping", {}).get("damping_N_s_per_m", 0.0)
        constants = kalman_model.constants(
            plant, _sensors(rig, over_wire), sample_time_s, hold_time_s, kalman_model.Tuning(), damping
        )
        return _bind(estimator_id, _KALMAN, constants)
    raise ValueError(f"unknown estimator {estimator_id!r}; known: {', '.join(ESTIMATOR_IDS)}")


def _sensors(rig: Rig, over_wire: bool) -> kalman_model.Sensors:
    return kalman_model.Sensors(
        encoder_quantum_rad=rig.encoder.quantum_rad,
        transport_quantum_rad=WIRE_ANGLE_RAD if over_wire else 0.0,
        current_noise_A=rig.noise.current_A,
        transport_quantum_A=WIRE_CURRENT_A if over_wire else 0.0,
    )


def _bind(estimator_id: str, kernels: _Kernels, constants: _Vector) -> Estimator:
    start_kernel, step_kernel = kernels.start, kernels.step

    def start(sample: Sample) -> State:
        return start_kernel(constants, *sample)

    def step(state: State, sample: Sample) -> State:
        return step_kernel(state, constants, *sample)

    return Estimator(estimator_id, start, step, _estimate, Compiled(kernels.kind, constants))


def _estimate(state: State) -> Estimate:
    return Estimate(float(state[TAU_W]), float(state[ELONGATION]))
