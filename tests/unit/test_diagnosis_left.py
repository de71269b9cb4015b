"""What is left beside a model, and when that makes it doubtful."""

from dataclasses import replace

import pytest

from hil_forceps.diagnosis.diagnose import Findings, Options, investigate
from hil_forceps.diagnosis.judge import BOTH_OVER_CHANCE, judge
from hil_forceps.diagnosis.leftover import Leftover
from tests.hidden_effects.generator import RIG, generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS

HIDDEN = "wire_permanent_stretch"
TRUE = true_rig(RIG, {HIDDEN: {"stretch_m": 6.0e-5}}, {})
KINDS = ("multisine", "chirp", "trapezoid")


def found_without(*ids: str) -> Findings:
    """Return what is found in runs of a stretched wire when entries are missing from the catalogue."""
    runs = [generate(TRUE, replace(SCENARIOS[kind], duration_s=4.0), 40 + k, name=kind) for k, kind in enumerate(KINDS)]
    return investigate(runs, RIG, Options(without=frozenset(ids), hold_out=KINDS[-1:]))


@pytest.fixture(scope="module")
def right() -> Findings:
    """The whole catalogue."""
    return found_without()


def with_left(found: Findings, fitted: float, unseen: float) -> Findings:
    """Return findings that leave so many times of what chance gives."""

    def left(look: Leftover | None, times: float) -> Leftover:
        assert look is not None
        return look._replace(gain=times * look.threshold)

    return found._replace(after=left(found.after, fitted), unseen=left(found.unseen, unseen))


@pytest.mark.slow
@pytest.mark.xdist_group("left")
def test_what_both_leave_is_doubted_though_neither_alone_would_be(right: Findings) -> None:
    assert right.choice.model.effects == (HIDDEN,)
    assert judge(right).verdict == "effects"
    more, less = 1.1 * BOTH_OVER_CHANCE, 0.9 * BOTH_OVER_CHANCE
    assert judge(with_left(right, more, more)).verdict == "unnamed"
    assert judge(with_left(right, more, less)).verdict == "effects"
    assert judge(with_left(right, less, more)).verdict == "effects"
    assert judge(with_left(right, more, more)._replace(unseen=None)).verdict == "effects"


@pytest.mark.slow
@pytest.mark.xdist_group("left")
def test_what_no_zero_of_the_jaw_s_sensor_can_be_is_left(right: Findings) -> None:
    assert not right.after.stands_out
    lacking = found_without(HIDDEN)
    assert lacking.choice.model.effects == ()
    verdict = judge(lacking)
    assert verdict.verdict == "unnamed"
    assert verdict.varies_over[0] == "theta_j_rad: constant"
