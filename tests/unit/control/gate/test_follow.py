"""Many samples and requests at once: the gate is then as if it had been asked for each."""

import math
import random
from typing import Any

import numpy as np
import pytest

from hil_forceps.control.gate import Gate, GateState
from hil_forceps.control.gate.bounds import FeedbackBounds
from hil_forceps.control.gate.feedback import BLOCK_SAMPLES
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import Limits

PERIOD_NS = 100_000
PLANT = PlantParameters(2e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)
LIMITS: dict[str, Any] = {
    "position_min_rad": -1.0,
    "position_max_rad": 1.0,
    "speed_max_rad_per_s": 20.0,
    "acceleration_max_rad_per_s2": 1e5,
}
Row = tuple[float, float, float]  # angle, current, request


def bounds(current_max_A: float = math.inf) -> FeedbackBounds:
    return FeedbackBounds(PLANT, 50.0, 1e-3, 5e-3, 0.01, 0.02, 0.5, 0.05, math.inf, current_max_A, 1e-3)


def opened(limits: Limits, feedback: FeedbackBounds | None) -> Gate:
    """A gate that has let its first output pass."""
    gate = Gate(limits, feedback)
    gate.see(0, 0, 0.0, 0.0)
    gate.open(0)
    gate.step(0.0, 0)
    assert gate.state is GateState.OPEN
    return gate


def slots(thing: Any) -> dict[str, str]:
    """All that an object with slots remembers, as text: NaN equals itself, and a number of numpy one of Python."""
    with np.printoptions(legacy="1.25"):
        return {name: repr(getattr(thing, name, None)) for name in type(thing).__slots__}


def memory(gate: Gate) -> dict[str, str]:
    kept = slots(gate) | ({} if gate._monitor is None else slots(gate._monitor))
    return {name: said for name, said in kept.items() if name not in {"_limit", "_limiter", "_monitor"}}


def one_by_one(gate: Gate, rows: list[Row], begin: int) -> list[tuple[float | None, str]]:
    answers = []
    for place, (theta, current, request) in enumerate(rows, begin):
        now_ns = (place + 1) * PERIOD_NS
        gate.see(now_ns, now_ns, theta, current)
        passed, verdict = gate.step(request, now_ns)
        answers.append((passed, verdict.name))
    return answers


def at_once(gate: Gate, rows: list[Row]) -> list[tuple[float | None, str]]:
    """Follow as far as that goes, one by one where it doesn't, and so on."""
    answers: list[tuple[float | None, str]] = []
    while len(answers) < len(rows):
        theta, current, request = np.array(rows[len(answers) :]).T.copy()
        followed = gate.follow(PERIOD_NS, theta, current, request)
        answers += [(passed, "PASSED") for passed in request[:followed].tolist()]
        if len(answers) < len(rows):
            answers += one_by_one(gate, rows[len(answers) : len(answers) + 1], len(answers))
    return answers


def motion(seed: int, wild: float) -> list[Row]:
    """A smooth motion with jumps of angle and request, strong currents and standstills here and there."""
    source, rows, angle = random.Random(seed), [], 0.0
    still = 0
    for place in range(300):
        request = 0.1 * (1.0 - math.cos(100.0 * place * PERIOD_NS * 1e-9))
        still = still - 1 if still else (80 if source.random() < 0.1 * wild else 0)
        angle = angle if still else request + 1e-5 * source.gauss(0.0, 1.0)
        chance = source.random()
        theta = math.nan if chance < 0.05 * wild else angle + (0.2 if chance < 0.1 * wild else 0.0)
        current = source.gauss(0.0, 0.1) + (2.0 if place % 100 > 70 and wild else 0.0)
        asked = (
            math.inf if 0.1 * wild <= chance < 0.13 * wild else request + (0.3 if chance > 1.0 - 0.05 * wild else 0.0)
        )
        rows.append((theta, current, asked))
    return rows


@pytest.mark.parametrize("is_checked", [False, True])
@pytest.mark.parametrize("wild", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("seed", range(8))
def test_the_gate_is_as_if_asked_for_each(seed: int, wild: float, is_checked: bool) -> None:
    rows, feedback = motion(seed, wild), bounds(1.5) if is_checked else None
    together, alone = opened(Limits(**LIMITS), feedback), opened(Limits(**LIMITS), feedback)
    assert at_once(together, rows) == one_by_one(alone, rows, 0)
    assert memory(together) == memory(alone)


def test_what_passes_is_followed_to_the_end() -> None:
    rows = motion(1, 0.0)
    theta, current, request = np.array(rows).T.copy()
    assert opened(Limits(**LIMITS), bounds()).follow(PERIOD_NS, theta, current, request) == len(rows)
    assert opened(Limits(**LIMITS), None).follow(PERIOD_NS, theta, current, request) == len(rows)


def test_it_follows_up_to_the_first_that_does_not_pass() -> None:
    theta, current, request = np.array(motion(1, 0.0)).T.copy()
    request[40] += 0.5
    assert opened(Limits(**LIMITS), bounds()).follow(PERIOD_NS, theta, current, request) == 40
    theta[20] += 0.5
    assert opened(Limits(**LIMITS), bounds()).follow(PERIOD_NS, theta, current, request) == 20
    theta[0] = math.nan
    assert opened(Limits(**LIMITS), bounds()).follow(PERIOD_NS, theta, current, request) == 0


def test_a_finding_ends_it_with_the_sample_taken() -> None:
    theta, current, request = np.array(motion(1, 0.0)).T.copy()
    current[8:16] = 3.0
    gate = opened(Limits(**LIMITS), bounds(1.5))
    assert gate.follow(PERIOD_NS, theta, current, request) == 15
    assert gate.state is GateState.FROZEN
    assert gate.follow(PERIOD_NS, theta[16:], current[16:], request[16:]) == 0


@pytest.mark.parametrize("more", [{"jerk_max_rad_per_s3": 1e6}, {"window_travel_max_rad": 1.0}])
def test_other_limits_are_not_followed(more: dict[str, float]) -> None:
    theta, current, request = np.array(motion(1, 0.0)).T.copy()
    assert opened(Limits(**LIMITS, **more), None).follow(PERIOD_NS, theta, current, request) == 0


def test_neither_is_a_gate_that_does_not_stand_at_a_sample_of_its_own() -> None:
    theta, current, request = np.array(motion(1, 0.0)).T.copy()
    limits = Limits(**LIMITS)
    closed = Gate(limits)
    assert closed.follow(PERIOD_NS, theta, current, request) == 0
    closed.see(0, 0, 0.0, 0.0)
    closed.open(0)
    assert closed.follow(PERIOD_NS, theta, current, request) == 0  # nothing has left yet
    late = opened(limits, None)
    late.see(PERIOD_NS, PERIOD_NS, 0.0, 0.0)
    late.step(0.0, PERIOD_NS + 1)
    assert late.follow(PERIOD_NS, theta, current, request) == 0
    for period_ns in (0, -1, 20_000_001):
        assert opened(limits, None).follow(period_ns, theta, current, request) == 0
    for period_ns in (1, 20_000_000):
        assert opened(limits, None).follow(period_ns, theta, current, np.zeros(len(theta))) == len(theta)


def test_a_single_sample_is_followed() -> None:
    theta, current, request = np.array(motion(1, 0.0)[:1]).T.copy()
    assert opened(Limits(**LIMITS), bounds()).follow(PERIOD_NS, theta, current, request) == 1


def test_a_turn_by_as_much_as_a_motor_can_is_followed() -> None:
    """The top speed over a period, and what the encoder is unsure of besides."""
    feedback = bounds()
    theta = np.array([feedback.jump_speed_rad_per_s * PERIOD_NS * 1e-9 + 0.5 * feedback.jump_slack_rad])
    assert opened(Limits(**LIMITS), feedback).follow(PERIOD_NS, theta, np.zeros(1), np.zeros(1)) == 1


def test_a_sample_that_ends_a_block_is_judged_by_the_reference_before_it() -> None:
    rows = motion(1, 0.0)[:BLOCK_SAMPLES]
    together, alone = opened(Limits(**LIMITS), bounds()), opened(Limits(**LIMITS), bounds())
    one_by_one(together, rows[:-1], 0)
    theta, current, request = np.array(rows[-1:]).T.copy()
    assert together.follow(PERIOD_NS, theta, current, request) == 1
    one_by_one(alone, rows, 0)
    assert memory(together) == memory(alone)
