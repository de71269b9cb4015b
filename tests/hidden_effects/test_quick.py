"""A quick part of the campaign: a few hidden effects, and data in which none must be found; judged by count."""

import pytest

from tests.hidden_effects.cases import Spec
from tests.hidden_effects.tally import Record, in_set, named_right
from tests.hidden_effects.trial import run_case

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def ran(spec: Spec, *, gain: bool = False) -> Record:
    record = run_case(spec, gain=gain, whole=False)
    assert "error" not in record
    assert "skipped" not in record
    return record


def test_a_hidden_effect_is_found_and_explained() -> None:
    record = ran(Spec("cogging", "effect", ("cogging",), 50.0, 7, "mixed"), gain=True)
    assert named_right(record), (record["verdict"], record["named"])
    share, before, after, possible = record["explained"]["whitened"]
    assert min(share, possible) > 0.95
    assert after < before


@pytest.mark.long
def test_a_hidden_slack_is_found() -> None:
    record = ran(Spec("slack", "effect", ("wire_slack",), 50.0, 7, "mixed"))
    assert named_right(record) or in_set(record), (record["verdict"], record["named"])


def test_a_shift_alone_is_no_cause() -> None:
    clean(Spec("shift", "shift", (), 0.0, 7, "mixed", shifted=True))


# Of the first, the load's corners, bent by smoothing, looked like a drift of friction. In the next three the load's
# noise comes in bursts, which passed for a drift of K_t, a ripple, and something unnamed. In the next two the jaw's
# inertia was sought in a wrong valley, and the encoder's slow rounding looks a little like a wire that hardens. In the
# last two the motor dwells within a count (79 were left), and a smooth load was taken for many short straight pieces.
@pytest.mark.long
@pytest.mark.parametrize(
    ("noise", "scenarios", "seed"),
    [
        ("coloured", "mixed", 10603),
        ("white", "turns", 11100),
        ("white", "work", 11204),
        ("coloured", "mixed", 11203),
        ("coloured", "work", 11903),
        ("white", "turns", 12000),
        ("white", "turns", 13804),
        ("coloured", "turns", 17307),
    ],
)
def test_noise_is_no_cause(noise: str, scenarios: str, seed: int) -> None:
    clean(Spec("noise", "none", (), 0.0, seed, scenarios, noise))


@pytest.mark.long
def test_a_straight_load_is_no_cause_where_noise_is_first_taken_for_too_quiet() -> None:
    clean(Spec("noise", "shift", (), 0.0, 24003, "turns", "coloured", shifted=True))


@pytest.mark.long
def test_friction_of_half_of_what_the_rig_says_is_no_cause() -> None:
    """Taken at the rig's word first, with the encoder's rounding to suit it: 30 were left over the motor's speed."""
    clean(Spec("noise", "shift", (), 0.0, 24203, "work", "coloured", shifted=True))


def clean(spec: Spec) -> None:
    record = ran(spec)
    assert record["named"] == []
    assert record["verdict"] in {"consistent", "parameters"}


@pytest.mark.long
def test_a_film_is_found_where_the_rounding_hangs_on_its_speed() -> None:
    """The rounding taken anew moves the speed and that the rounding: after one turn the film was 550 of χ² off."""
    record = ran(Spec("film", "pair", ("current_gain", "film_friction"), 50.0, 11501, "work"))
    assert named_right(record), (record["verdict"], record["named"])
    speed = record["parameters"]["film_friction"]["speed_rad_per_s"][0]
    assert 0.5 < speed / record["hidden"]["film_friction"]["speed_rad_per_s"] < 2.0


@pytest.mark.long
def test_a_rival_is_compared_when_it_is_fitted_as_far() -> None:
    effects = ("presliding_friction", "film_friction", "actuation_delay")
    record = ran(Spec("late", "triple", effects, 20.0, 11500, "mixed"))
    assert named_right(record) or in_set(record), (record["verdict"], record["named"])


@pytest.mark.long
def test_a_neighbour_s_set_holds_the_truth_where_rough_fits_leave_it_behind() -> None:
    record = ran(Spec("weight", "effect", ("jaw_gravity",), 50.0, 11720, "work"))
    assert named_right(record) or in_set(record), (record["named"], record["sets"])


@pytest.mark.long
def test_a_limit_is_named_that_clips_a_few_peaks() -> None:
    record = ran(Spec("limit", "effect", ("current_saturation",), 50.0, 11717, "mixed"))
    assert named_right(record), (record["verdict"], record["named"])
    assert record["left"][0] < record["left"][1]


@pytest.mark.long
def test_friction_is_named_that_shows_nothing_until_it_is_fitted() -> None:
    effects = ("stribeck_friction", "load_dependent_friction")
    record = ran(Spec("overlooked", "pair", effects, 20.0, 11704, "mixed"))
    assert named_right(record), (record["named"], record["left"])


# Of a large effect the linear look tells little, and what is fitted no further than a neighbour stands far above it.
@pytest.mark.long
@pytest.mark.parametrize(
    ("effect_id", "size", "seed", "scenarios"),
    [("coulomb_asymmetry", 200.0, 80003, "work"), ("load_dependent_friction", 400.0, 70004, "turns")],
)
def test_a_large_effect_is_named(effect_id: str, size: float, seed: int, scenarios: str) -> None:
    record = ran(Spec("large", "large", (effect_id,), size, seed, scenarios))
    # An offset of the current and a coupling stand within the set: which comes first is up to the machine's rounding.
    assert [effect_id] in record["sets"], (record["named"], record["sets"])


@pytest.mark.long
def test_friction_joins_by_what_it_gains_beside_its_own_rounding() -> None:
    """Beside the rounding taken without it, it gains 25 where 400 are hidden, from wherever its fit begins."""
    record = ran(Spec("falling", "effect", ("stribeck_friction",), 20.0, 12212, "turns"))
    assert named_right(record), (record["verdict"], record["named"], record["left"])


@pytest.mark.long
def test_fit_and_rounding_are_followed_to_where_they_agree() -> None:
    """In turn they went a little of the way each: a quarter of the rise was lost, and 81 left in the runs held out."""
    record = ran(Spec("falling", "effect", ("stribeck_friction",), 50.0, 12304, "turns"))
    assert named_right(record), (record["verdict"], record["named"])
    assert record["left_unseen"][0] < 1.5 * record["left_unseen"][1]
    rise = record["parameters"]["stribeck_friction"]["rise_N_m"][0]
    assert rise == pytest.approx(record["hidden"]["stribeck_friction"]["rise_N_m"], rel=0.15)


@pytest.mark.long
def test_a_direction_of_slow_motion_shows_beside_fast_turns() -> None:
    """A deleted friction over the jaw's angle, where one run turns forty times as fast as the others."""
    record = ran(Spec("deleted", "deleted", ("jaw_position_friction",), 20.0, 12204, "turns", deleted=True))
    assert record["verdict"] == "unnamed", (record["verdict"], record["named"], record["left"])


@pytest.mark.long
def test_an_effect_that_no_entry_describes_is_not_called_by_another_s_name() -> None:
    record = ran(Spec("deleted", "deleted", ("wire_slack",), 50.0, 7, "mixed", deleted=True))
    assert record["verdict"] == "unnamed"
    assert record["named"] == []


def test_runs_that_say_nothing_are_undetermined() -> None:
    record = ran(Spec("rest", "uninformative", ("wire_slack",), 20.0, 7, "rest"))
    assert record["verdict"] == "undetermined"
    assert record["reasons"]


@pytest.mark.long
def test_an_inertia_held_to_the_wrong_valley_leaves_nothing_beside_the_right_effect() -> None:
    """Beside a forceps without the lag the deepest valley is 11 % off; held to it, 212 was left where 15 is chance."""
    record = ran(Spec("lag", "effect", ("electrical_lag",), 50.0, 12002, "mixed"))
    assert record["verdict"] == "effects", record["varies_over"]
    assert named_right(record) or in_set(record), (record["named"], record["sets"])
    constant, _, _ = record["parameters"]["electrical_lag"]["time_constant_s"]
    assert constant == pytest.approx(record["hidden"]["electrical_lag"]["time_constant_s"], rel=0.05)


@pytest.mark.long
def test_a_slack_that_the_rounding_hides_takes_the_place_of_its_neighbour() -> None:
    record = ran(Spec("loose", "no_jaw", ("wire_slack",), 50.0, 12001, "mixed", drop=("theta_j_rad",)))
    assert named_right(record), (record["verdict"], record["named"])
    named = [score for score in record["scores"] if score[3] == "named"]
    assert [score[0] for score in named] == ["wire_slack"]
