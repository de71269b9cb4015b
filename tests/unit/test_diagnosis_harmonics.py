"""What repeats with the motor's turn does so a whole number of times; behind a gear, any number."""

from dataclasses import replace

import pytest

from hil_forceps.diagnosis import choice
from hil_forceps.diagnosis.diagnose import Findings, Options, investigate
from hil_forceps.diagnosis.hypotheses.entries import LEAST_OF_MANY, Probe, free_parameters
from hil_forceps.diagnosis.extension import Model
from hil_forceps.diagnosis.judge import judge
from hil_forceps.diagnosis.result import Estimate
from hil_forceps.diagnosis.unknowns import Unknowns
from hil_forceps.diagnosis.whole import with_whole_harmonics
from hil_forceps.model.parameters import index
from hil_forceps.rig.catalogue import effect
from tests.hidden_effects.generator import RIG, generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS

KINDS = ("multisine", "chirp", "trapezoid")


@pytest.mark.parametrize("name", ["cogging", "torque_ripple"])
@pytest.mark.parametrize(
    ("start", "geared", "least"),
    [
        (1.0, False, None),
        (2.0, False, None),
        (3.0, False, LEAST_OF_MANY),
        (1.46, False, 1.0),
        (1.0, True, 1.0),
        (3.0, True, 1.0),
    ],
)
def test_a_harmonic_is_held_where_it_is_whole(name: str, start: float, geared: bool, least: float | None) -> None:
    values = {"sine": 0.1, "cosine": 0.1, "sine_N_m": 1e-6, "cosine_N_m": 1e-6, "harmonic": start}
    entry = effect(name)
    probe = Probe(name, {p.name: values[p.name] for p in entry.parameters}, (), False)
    free = free_parameters(entry, probe, geared=geared)
    items = {item.name: item for item in Unknowns(()).with_effect(name, probe.start, free).items}
    assert len(items) == (2 if least is None else 3)
    if least is not None:
        assert items[f"effects.{name}.harmonic"].low == least


def _beside_cogging(harmonic: float) -> Findings:
    hidden = {"cogging": {"sine_N_m": 4e-6, "cosine_N_m": 4e-6, "harmonic": harmonic}}
    true = true_rig(RIG, hidden, {})
    runs = [generate(true, replace(SCENARIOS[kind], duration_s=4.0), 40 + k, name=kind) for k, kind in enumerate(KINDS)]
    return investigate(runs, RIG, Options(hold_out=KINDS[-1:]))


@pytest.mark.slow
@pytest.mark.parametrize("harmonic", [1.0, 7.0])
def test_a_whole_harmonic_is_named_as_it_is(harmonic: float) -> None:
    found = judge(_beside_cogging(harmonic))
    assert [named.id for named in found.effects] == ["cogging"]
    told = found.effects[0].parameters
    assert list(told) == ["sine_N_m", "cosine_N_m", "harmonic"]
    assert told["harmonic"] == Estimate(harmonic, harmonic, harmonic, "")


def _doubted(model: Model, half: float) -> Model:
    """Return the model as if its cogging's harmonic were known by ± half."""
    place = model.problem.shared.names.index("effects.cogging.harmonic")
    covariance = model.fit.covariance.copy()
    covariance[place, place] = (half / 1.96 / model.problem.shared.items[place].scale) ** 2
    return replace(model, fit=model.fit._replace(covariance=covariance))


@pytest.mark.slow
def test_a_harmonic_that_is_not_whole_stays_free() -> None:
    found = _beside_cogging(7.4)
    told = judge(found).effects[0].parameters["harmonic"]
    assert 7.0 < told.low < 7.4 < told.high < 8.0
    doubted = _doubted(found.choice.model, 0.5)  # 7 is in the interval, but doesn't fit
    assert with_whole_harmonics(doubted, found.choice.whitener) is doubted


@pytest.mark.slow
def test_a_harmonic_is_held_where_its_interval_has_one_whole_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice, "with_whole_harmonics", lambda model, _: model)
    found = _beside_cogging(7.0)
    free, whitener = found.choice.model, found.choice.whitener
    told = judge(found).effects[0].parameters["harmonic"]
    assert told.low < 7.0 < told.high
    held = with_whole_harmonics(free, whitener)
    assert "effects.cogging.harmonic" not in held.problem.shared.names
    assert held.problem.theta(held.fit.u)[index("effects.cogging.harmonic")] == 7.0
    doubted = _doubted(free, 1.1)
    assert with_whole_harmonics(doubted, whitener) is doubted
