"""Hidden effects sized by what a case's own runs show of them.

d is what the whitened innovations of the true model differ by from those of the model without the effect, in
deviations, after the known parameters have been refitted. Friction that holds, a coarse encoder, loads and zeros that
nobody knows forgive what they forgive there, too: an effect of d = 20 that a hold hides is made larger until it shows
as much. The refit is no linear one: a count that is far off tells more than one that a refit comes near to.
"""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.diagnosis.evidence import pass_all
from hil_forceps.diagnosis.hypotheses.candidate import is_finite
from hil_forceps.diagnosis.identification import adapting, known_of, records_of
from hil_forceps.diagnosis.inference.fit import Fit, fit_from
from hil_forceps.diagnosis.inference.parameters import without_effect
from hil_forceps.diagnosis.preparation.sensor_noise import sensor_noise
from hil_forceps.diagnosis.starting_parameters import with_friction_in_the_load
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.generator_sizes import Effects, scaled

TOLERANCE = 0.15  # relative, of d
MAX_ROUNDS = 8
MAX_FACTOR = 4.0  # of the amplitudes, in one round


def own_size(runs: Sequence[EvenRun], assumed: Rig, true: Rig, effect_id: str) -> float:
    """Return d of an effect of the true rig in runs of it; infinite where a filter without it diverges."""
    theta = with_friction_in_the_load(parameters.vector(true), runs)
    noise = sensor_noise([even.run for even in runs], assumed)
    records, _ = records_of(runs, (), assumed, noise, map, theta)
    known = known_of(assumed, records)
    adapted = adapting(map)(records, Fit((), pass_all(records, theta, map), np.eye(0)), first=True)
    with_it = pass_all(adapted, theta, map)
    without = pass_all(adapted, without_effect(theta, effect_id), map)
    if not is_finite(without):
        return math.inf
    refitted = fit_from(adapted, without, known, map).passes
    apart = 0.0
    for one, other in zip(with_it.runs, refitted.runs, strict=True):
        both = one.as_recorded(one.counts) & other.as_recorded(other.counts)
        apart += float(np.sum((other.as_recorded(other.residual) - one.as_recorded(one.residual))[both] ** 2))
    # The refit follows the noise, too: of χ² that is the number of parameters on the mean.
    return math.sqrt(max(0.0, apart - len(known)))


def sized(
    wanted: float, effect_id: str, start: Mapping[str, float], size_of: Callable[[Effects], float]
) -> dict[str, dict[str, float]]:
    """Return an effect with its amplitudes times one factor, so that `size_of` it is `wanted`, within the tolerance.

    ValueError where no size within the catalogue's ranges has that d, or it jumps over it.
    """
    low, high, factor, d = 0.0, math.inf, 1.0, 0.0
    for _ in range(MAX_ROUNDS):
        effects = scaled({effect_id: start}, factor)
        d = size_of(effects)
        if abs(d - wanted) <= TOLERANCE * wanted:
            return effects
        low, high = (factor, high) if d < wanted else (low, factor)
        if d < wanted and scaled({effect_id: start}, MAX_FACTOR * factor) == effects:
            break  # the end of its range
        factor *= min(max(wanted / d if d > 0.0 else MAX_FACTOR, 1.0 / MAX_FACTOR), MAX_FACTOR)
        if not low < factor < high:
            factor = math.sqrt(max(low, high / MAX_FACTOR**2) * high)
    raise ValueError(f"no size of {effect_id} gives d = {wanted}; the last was {d:.3g}")
