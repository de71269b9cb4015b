"""How much of an effect an extended rig explains on runs of other kinds, where the truth is known.

The simulated world runs the true rig, the refitted one and the extended one, so nothing of the diagnosing model judges
itself. Without noise, which would be hundreds of times what an effect of d = 20 does, and shaken alike.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.options import Findings
from hil_forceps.diagnosis.extension import Model
from hil_forceps.model import parameters
from hil_forceps.rig import Rig
from tests.hidden_effects.cases import Spec
from tests.hidden_effects.generator import Case
from tests.hidden_effects.generator_sizes import Shown, shown

Vector = NDArray[np.float64]

DRAWS = 4


def explained(found: Findings, case: Case, spec: Spec, scenarios: Sequence[str]) -> dict[str, list[float]]:
    """Return the share of the refitted rig's error that the extended one takes away, in runs of these scenarios.

    `whitened`: of all channels, weighed by their noise, as d is; then angle by angle, in rad. Each as share; root of
    the sum (whitened) or mean of squares, before and after; the share of rigs as far from the truth as the fit says
    that it is (1 where the extension has other effects).
    """
    extended = found.choice.model
    rigs = [parameters.rig_with(case.assumed, found.baseline.problem.theta(found.baseline.fit.u), ())]
    rigs.append(parameters.rig_with(case.assumed, extended.problem.theta(extended.fit.u), extended.effects))
    if set(extended.effects) == set(spec.effects):
        rigs += _round_truth(extended, case.true, spec.seed)

    def runs_of(rig: Rig) -> Shown:
        return shown(rig, scenarios, spec.seed, assumed=case.assumed, drop=spec.drop)

    truth = runs_of(case.true)
    errors = [_errors(runs_of(rig), truth) for rig in rigs]
    found_shares = {}
    for name in Shown._fields:
        before, after, *drawn = (error[name] for error in errors)
        possible = 1.0 - float(np.mean(drawn)) / before if drawn else 1.0
        found_shares[name] = [1.0 - after / before, float(np.sqrt(before)), float(np.sqrt(after)), possible]
    return found_shares


def _errors(said: Shown, truth: Shown) -> dict[str, float]:
    squares = {name: (getattr(said, name) - getattr(truth, name)) ** 2 for name in Shown._fields}
    return {name: float(np.sum(s) if name == "whitened" else np.mean(s)) for name, s in squares.items()}


def _round_truth(model: Model, true: Rig, seed: int) -> list[Rig]:
    """Return the true rig with errors drawn as the model's fit has them, within the parameters' ranges."""
    rng = np.random.default_rng([seed, 0xD12A])
    items = model.problem.shared.items
    at = [parameters.index(item.name) for item in items]
    scale, low, high = (np.array([getattr(item, key) for item in items]) for key in ("scale", "low", "high"))
    values, vectors = np.linalg.eigh(model.fit.covariance[: len(items), : len(items)])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = []
    for _ in range(DRAWS):
        theta: Vector = parameters.vector(true)
        theta[at] = np.clip(theta[at] + scale * (root @ rng.standard_normal(len(items))), low, high)
        drawn.append(parameters.rig_with(true, theta, model.effects))
    return drawn
