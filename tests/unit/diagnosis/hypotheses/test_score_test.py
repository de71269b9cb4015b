"""Score tests: what the threshold is of."""

import numpy as np
from scipy import stats

from hil_forceps.diagnosis.error_rates import FALSE_ALARMS
from hil_forceps.diagnosis.evidence import Gram
from hil_forceps.diagnosis.hypotheses.places import Place
from hil_forceps.diagnosis.hypotheses.score_test import Prior, score_test

NOTHING_FITTED = Prior(np.zeros((0, 0)), np.zeros(0))


def place(first: int, stop: int) -> Place:
    return Place("viscous_drift", {}, {}, first, stop, False)


def test_the_threshold_of_one_column_is_that_of_chi2() -> None:
    tested = score_test(Gram(np.eye(1), np.zeros(1)), NOTHING_FITTED, [place(0, 1)], seed=1)
    # By the exponential tail beyond a quantile that the draws reach.
    assert abs(tested.threshold - float(stats.chi2.isf(FALSE_ALARMS, 1))) < 1.5


def test_columns_that_depend_on_each_other_but_for_rounding_raise_no_threshold() -> None:
    """Harmonics over a short motion do: a threshold of 7 000 came of it, and no lack of fit was significant."""
    angle = 0.3 * np.sin(np.linspace(0.0, 20.0, 3000))
    waves = [wave(k * angle) for k in range(4, 13) for wave in (np.sin, np.cos)]
    columns = np.column_stack([*waves, *(np.sign(np.cos(np.linspace(0.0, 20.0, 3000))) * w for w in waves)])
    information = columns.T @ columns
    own = np.sqrt(np.diag(information))
    rng = np.random.default_rng(3)
    noise = 3e-7 * np.outer(own, own) * rng.standard_normal(information.shape)
    found = Gram(information + noise + noise.T, np.zeros(own.size))
    tested = score_test(found, NOTHING_FITTED, [place(0, 18), place(18, 36)], seed=1)
    assert tested.threshold < 30.0
