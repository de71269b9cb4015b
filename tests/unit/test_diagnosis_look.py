"""What a look remembers of each entry."""

import numpy as np

from hil_forceps.diagnosis.look import of_best_places


def test_an_entry_s_chance_is_that_of_the_place_that_gains_most() -> None:
    names = ["current_saturation", "cogging", "current_saturation", "current_saturation"]
    gains, inflation = np.array([12.2, 30.0, 26.0, 19.7]), np.array([6.25, 1.3, 2.08, 2.56])
    assert of_best_places(names, gains, inflation) == {"current_saturation": 2.08, "cogging": 1.3}
    assert of_best_places([], np.empty(0), np.empty(0)) == {}
