"""Estimators by name, with the values of a rig bound to them.

Every file of `algorithms` lists its estimators in `ALGORITHMS`. The names that a file or a command may give, and their
order in tables, are `ALGORITHM_IDS` of the rig's schema.
"""

import math
from collections.abc import Iterable
from importlib import import_module
from pkgutil import iter_modules

from hil_forceps.estimation import algorithms
from hil_forceps.estimation.corrections import IGNORED, corrected
from hil_forceps.estimation.interface import Algorithm, Estimator
from hil_forceps.rig.schema import ALGORITHM_IDS, Rig

ESTIMATOR_IDS: tuple[str, ...] = ALGORITHM_IDS


def _found() -> dict[str, Algorithm]:
    modules = (import_module(f"{algorithms.__name__}.{each.name}") for each in iter_modules(algorithms.__path__))
    offered: list[Algorithm] = [each for module in modules for each in getattr(module, "ALGORITHMS", ())]
    return {algorithm.id: algorithm for algorithm in offered}


def _in_order(ids: Iterable[str]) -> list[str]:
    """Return ids in the order of the schema, unknown ones last."""
    return sorted(ids, key=lambda each: (*ALGORITHM_IDS, each).index(each))


def make_estimator(estimator_id: str, rig: Rig, sample_time_s: float, *, over_wire: bool = True) -> Estimator:
    """Bind an algorithm to a rig; `sample_time_s` is the nominal time between the samples it will get.

    `over_wire=False`: samples come without the protocol's rounding. Samples are corrected for effects of the rig
    (`corrections`) if the algorithm says so; an estimator with corrections has no `compiled`. ValueError for an id that
    isn't in `ESTIMATOR_IDS` or a sample time that isn't positive; UserError when the rig doesn't know a value that is
    needed.
    """
    if not (math.isfinite(sample_time_s) and sample_time_s > 0.0):
        raise ValueError(f"sample_time_s must be positive, got {sample_time_s!r}")
    algorithm = _algorithm(estimator_id)
    made = algorithm.make(rig, sample_time_s, over_wire)
    return corrected(made, rig, sample_time_s) if algorithm.corrected else made


def effects_passed_over(estimator_id: str, rig: Rig) -> tuple[str, ...]:
    """Return the effects of a rig that an estimator ignores, for a note to the user."""
    algorithm = _algorithm(estimator_id)
    if not algorithm.corrected:
        return tuple(rig.effects)
    return tuple(name for name in rig.effects if name in IGNORED - algorithm.models)


def _algorithm(estimator_id: str) -> Algorithm:
    algorithm = ALGORITHMS.get(estimator_id)
    if algorithm is None:
        raise ValueError(f"unknown estimator {estimator_id!r}; known: {', '.join(_in_order(ALGORITHMS))}")
    return algorithm


ALGORITHMS = _found()
