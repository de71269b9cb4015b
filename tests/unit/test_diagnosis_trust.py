"""Friction at the rig's word, unless the data contradict it."""

import numpy as np
from numpy.typing import NDArray

from hil_forceps.diagnosis.fit import Fit
from hil_forceps.diagnosis.trust import DOUBTED, at_their_word, trusted, trusting
from hil_forceps.diagnosis.unknowns import Unknown, Unknowns
from tests.unit.test_diagnosis_fit import BOTH, toy, unknown

WIDE = 1e4  # the rig's own deviation is a hundredth of the wide one


def unknowns(*told: float) -> Unknowns:
    items = (Unknown(f"f{k}", "N_m", 0.0, 1.0, -1e9, 1e9, True, 0.0, told=value) for k, value in enumerate(told))
    return Unknowns(tuple(items))


def fit_at(u: list[float], covariance: list[list[float]]) -> Fit:
    empty: NDArray[np.float32] = np.empty(0, dtype=np.float32)
    return Fit(np.array(u), 0.0, empty, [], empty[:, None], np.array(covariance), 1)


def precisions(found: Unknowns) -> list[float]:
    return [item.precision for item in found.items]


def test_what_the_data_hardly_show_is_taken_at_the_rigs_word() -> None:
    assert precisions(trusting(unknowns(WIDE), fit_at([0.5], [[0.04]]))) == [WIDE]


def test_what_the_data_contradict_stays_open() -> None:
    assert precisions(trusting(unknowns(WIDE), fit_at([0.5], [[0.02]]))) == [1.0]


def test_in_doubt_less_is_taken_at_the_rigs_word() -> None:
    hardly_seen, seen = [0.5, 0.0], [0.5, 0.3]
    covariance = [[0.04, 0.0], [0.0, 0.04]]
    for u, kept in ((hardly_seen, [1.0, WIDE]), (seen, [1.0, 1.0])):
        found = fit_at(u, covariance)
        assert trusted(trusting(unknowns(WIDE, WIDE), found)) == [0, 1]
        assert precisions(trusting(unknowns(WIDE, WIDE), found, DOUBTED)) == kept


def test_what_the_rig_says_nothing_tighter_of_stays_as_it_is() -> None:
    assert precisions(trusting(unknowns(1.0, WIDE), fit_at([0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]]))) == [1.0, WIDE]


def test_a_guess_that_the_rig_did_not_make_is_not_taken_at_its_word() -> None:
    guessed = Unknowns(tuple(item._replace(assumed=None) for item in unknowns(WIDE).items))
    assert precisions(trusting(guessed, fit_at([0.0], [[1.0]]))) == [1.0]


def test_of_two_that_trade_places_the_one_gives_way_that_the_data_contradict() -> None:
    # The sum is known to 0.01 and is off by 0.5; the first alone is known to 0.3, the second to 0.3.
    spread, sure = 0.3**2, 0.01**2
    covariance = [[spread, sure - spread], [sure - spread, spread]]
    first_is_off = trusting(unknowns(WIDE, WIDE), fit_at([0.6, -0.1], covariance))
    assert precisions(first_is_off) == [1.0, WIDE]
    second_is_off = trusting(unknowns(WIDE, WIDE), fit_at([-0.1, 0.6], covariance))
    assert precisions(second_is_off) == [WIDE, 1.0]


def test_both_are_taken_at_their_word_when_their_sum_is_right() -> None:
    covariance = [[0.09, -0.0899], [-0.0899, 0.09]]
    assert precisions(trusting(unknowns(WIDE, WIDE), fit_at([0.6, -0.6], covariance))) == [WIDE, WIDE]


def test_a_fit_begins_at_the_rigs_word_where_that_is_nearer() -> None:
    told = unknown("amplitude", 2.0, 1.0, prior=True)._replace(told=WIDE, precision=WIDE)
    problem, whitener = toy((told, BOTH[1]), 3)
    far = np.array([0.2, 0.1, 0.0, 0.0])
    assert at_their_word(problem, far, whitener).tolist() == [0.0, 0.1, 0.0, 0.0]
    # Where the rig's word is wrong, and the prior doesn't outweigh the data, the fit's own value is the better start.
    wrong = told._replace(centre=1.0, told=2.0, precision=2.0)
    problem, whitener = toy((wrong, BOTH[1]), 3)
    there = np.array([1.0, -0.2, 0.0, 0.0])
    assert at_their_word(problem, there, whitener) is there
