"""What a search says of a rig: from runs of a drive whose law is known, and from runs driven by their motion."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.hypotheses.candidate import Search
from hil_forceps.diagnosis.hypotheses.search import Found, search
from hil_forceps.diagnosis.lack_of_fit.omnibus_test import LackOfFit, omnibus_test
from hil_forceps.diagnosis.state_space.layout import Noise
from hil_forceps.rig.catalogue import EFFECTS

Vector = NDArray[np.float64]

# Without a load cell, what acts on the jaw is a load, as any: nothing tells it from one.
LIKE_A_LOAD = frozenset(entry.id for entry in EFFECTS if entry.location == "jaw")
# Other values of the rig give the same runs, as other radii do: no experiment tells it. Beside values that are fitted
# it is only another way to say how far these are off: beside `GAUGED`, its values of motor and wire.
GAUGES = frozenset({"encoder_scale"})
GAUGED = frozenset(
    {
        "forceps.motor_inertia_kg_m2",
        "forceps.motor_viscous_N_m_s_per_rad",
        "forceps.wire_stiffness_N_per_m",
    }
)


class Identified(NamedTuple):
    """What the runs say."""

    noise: Noise
    records: tuple[Any, ...]  # `Evidence`: of the runs that were fitted
    held_out: tuple[Any, ...]
    found: Found
    before: LackOfFit  # beside the known parameters, in the runs fitted
    after: LackOfFit  # beside the best model
    unseen: LackOfFit | None  # beside it in the runs held out; None without any


def searched(how: Search, theta: Vector) -> tuple[Found, LackOfFit, LackOfFit]:
    """Return what a search finds from `theta` on, and what the known parameters and the best model leave."""
    found = search(how, theta)
    how.progress("testing the lack of fit")
    after = omnibus_test(found.best.fit, how.mapper, how.seed, how.weigh)
    before = omnibus_test(found.baseline, how.mapper, how.seed, how.weigh) if found.best.effects else after
    return found, before, after
