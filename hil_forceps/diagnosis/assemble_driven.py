"""The fitting problem of runs whose drive law isn't known."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.experiment import Record
from hil_forceps.diagnosis.experiment_driven import torque_channel
from hil_forceps.diagnosis.mapper import Mapper
from hil_forceps.diagnosis.predict_driven import Driven, make_driven
from hil_forceps.diagnosis.problem import Problem
from hil_forceps.diagnosis.spectrum import make_layout, transform
from hil_forceps.diagnosis.starting import known
from hil_forceps.diagnosis.unknowns import Unknowns, known_parameters
from hil_forceps.model import parameters
from hil_forceps.rig import Rig

Vector = NDArray[np.float64]

ZERO_SHARE = 0.02  # of the jaw's range: zero of its sensor from run to run
LEAST_ZERO_RAD = 2e-3
OFFSET_SHARE = 0.1  # of the torque or current seen: zero of its sensor from run to run


def driven_problem(
    records: Sequence[Record], rig: Rig, mapper: Mapper, shared: Unknowns | None
) -> tuple[Problem, Driven]:
    """Make the problem of fitting a rig's known parameters to runs in mode "driven"."""
    theta = parameters.vector(rig)
    simulator = make_driven(records)
    layout = make_layout(
        [list(record.channels) for record in records],
        [record.weights for record in records],
        [record.period_s for record in records],
    )
    channel = torque_channel(records[0])
    seen = max(float(np.sqrt(np.mean(record.channels[channel] ** 2))) for record in records)
    constant = float(theta[parameters.index("motor.torque_constant_N_m_per_A")]) if channel == "current_A" else 1.0
    angles = [record.channels["theta_j_rad"] for record in records if "theta_j_rad" in record.channels]
    zero = max([LEAST_ZERO_RAD, *(ZERO_SHARE * float(np.ptp(angle)) for angle in angles)])
    problem = Problem(
        tuple(records),
        layout,
        transform(layout, simulator.measured()),
        simulator,
        theta,
        parameters.index,
        shared if shared is not None else _doubtful(known_parameters(rig, seen * constant), rig),
        zero,
        OFFSET_SHARE * seen,
        mapper,
    )
    return problem, simulator


def _doubtful(shared: Unknowns, rig: Rig) -> Unknowns:
    """Leave out what the rig knows exactly (`sd: 0`): without a wire, friction of the jaw is friction of the motor."""
    return Unknowns(tuple(item for item in shared.items if known(rig, item.name).sd != 0.0))
