"""The probe says which way a motor goes before it has gone far, and nothing where noise could be all there is."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil_forceps.drives.promises import Promises, damage
from hil_forceps.drives.supervision.direction import Direction, DirectionProbe

STEP_RAD, NOISE_RAD = math.radians(1.0), 4.0e-4


def led(gain: float, start_rad: float, sign: int, wobble: list[float]) -> tuple[DirectionProbe, float]:
    """Lead a motor that goes `gain` times as far as its reference; return the probe and the furthest reference."""
    probe = DirectionProbe(STEP_RAD, NOISE_RAD)
    furthest = 0.0
    for place, noise in enumerate(wobble):
        asked = sign * STEP_RAD * place / (len(wobble) - 1)
        if probe.see(start_rad + asked, start_rad + gain * asked + noise) is not Direction.UNDECIDED:
            break
        furthest = abs(asked)
    return probe, furthest


NOISES = st.lists(st.floats(-NOISE_RAD / 2, NOISE_RAD / 2), min_size=50, max_size=50)


@given(st.floats(0.6, 1.4), st.floats(-3.0, 3.0), st.sampled_from((-1, 1)), NOISES)
def test_what_follows_is_told_from_what_goes_against(gain: float, start: float, sign: int, noises: list[float]) -> None:
    follows, _ = led(gain, start, sign, noises)
    assert follows.direction is Direction.WITH
    against, furthest = led(-gain, start, sign, noises)
    assert against.direction is Direction.AGAINST
    assert furthest < STEP_RAD / 2
    assert "motor_driver.encoder_rev_per_pulley_rev" in against.words()
    assert "\n" not in against.words()


@given(NOISES, st.sampled_from((-1, 1)))
def test_noise_alone_says_nothing(noises: list[float], sign: int) -> None:
    probe, _ = led(0.0, 1.0, sign, noises)
    assert probe.direction is Direction.UNDECIDED
    assert "does not follow" in probe.words()


def test_its_word_stays() -> None:
    probe = DirectionProbe(STEP_RAD, NOISE_RAD)
    probe.see(0.0, 0.0)
    assert probe.see(STEP_RAD, -STEP_RAD) is Direction.AGAINST
    assert probe.see(STEP_RAD, STEP_RAD) is Direction.AGAINST


def test_a_motor_that_moves_before_the_reference_does_is_not_judged() -> None:
    probe = DirectionProbe(STEP_RAD, NOISE_RAD)
    assert [probe.see(0.0, angle) for angle in (0.0, -STEP_RAD)] == [Direction.UNDECIDED] * 2


@pytest.mark.parametrize(("step", "noise"), [(0.0, 0.0), (STEP_RAD, STEP_RAD / 4.0), (math.nan, 0.0), (math.inf, 0.0)])
def test_a_step_that_noise_would_hide_is_a_mistake(step: float, noise: float) -> None:
    with pytest.raises(ValueError, match="can't be told"):
        DirectionProbe(step, noise)


def test_what_was_sent_or_taken_is_no_damage() -> None:
    counters = {"samples": 9, "setpoints_sent": 9, "not_for_us": 3, "queries_sent": 2, "late": 1, "bad_length": 4}
    assert damage(counters, Promises(harmless_counters=frozenset({"late"}))) == {"bad_length": 4}
