"""Shapes between the places that are looked at."""

from hil_forceps.diagnosis.hypotheses.places import Place, between
from hil_forceps.model import parameters
from tests.hidden_effects.generator import RIG

THETA = parameters.vector(RIG)


def test_a_shape_between_two_places_has_columns_of_its_own() -> None:
    place = Place("presliding_friction", {"angle_rad": 0.02}, {"level_N_m": 1e-4}, 7, 8, True)
    found = between(THETA, place, 1.5, 3)
    assert found is not None
    near, columns = found
    assert near.shape["angle_rad"] == 0.03
    assert (near.first, near.stop, near.amplitudes, near.one_sided) == (3, 4, place.amplitudes, True)
    assert columns[0].theta[parameters.index("effects.presliding_friction.angle_rad")] == 0.03


def test_harmonics_amplitudes_and_what_has_no_shape_stay() -> None:
    harmonic = Place("cogging", {"harmonic": 6.0}, {"sine_N_m": 1e-4, "cosine_N_m": 1e-4}, 0, 2, False)
    assert between(THETA, harmonic, 1.5, 0) is None
    assert between(THETA, Place("jaw_gravity", {}, {"sine_N_m": 1e-5}, 0, 1, False), 1.5, 0) is None
    assert between(THETA, Place("current_saturation", {"limit_A": 0.3}, {}, 0, 1, True), 1.5, 0) is None


def test_a_shape_out_of_its_range_is_no_place() -> None:
    place = Place("presliding_friction", {"angle_rad": 1.9}, {"level_N_m": 1e-4}, 0, 1, True)
    assert between(THETA, place, 1.5, 0) is None
