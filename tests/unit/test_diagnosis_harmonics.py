"""What repeats once or twice in a turn does so to the last digit; of more, any number is possible."""

from dataclasses import replace

import pytest

from hil_forceps.diagnosis.diagnose import Options, investigate
from hil_forceps.diagnosis.entries import Probe, free_names
from hil_forceps.diagnosis.judge import judge
from hil_forceps.diagnosis.result import Estimate
from hil_forceps.diagnosis.unknowns import LEAST_OF_MANY, Unknowns
from hil_forceps.rig.catalogue import effect
from tests.hidden_effects.generator import RIG, generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS

KINDS = ("multisine", "chirp", "trapezoid")


@pytest.mark.parametrize("name", ["cogging", "torque_ripple"])
@pytest.mark.parametrize(("start", "least"), [(1.0, None), (2.0, None), (3.0, LEAST_OF_MANY), (1.46, 1.0)])
def test_a_harmonic_is_held_where_it_is_whole(name: str, start: float, least: float | None) -> None:
    values = {"sine": 0.1, "cosine": 0.1, "sine_N_m": 1e-6, "cosine_N_m": 1e-6, "harmonic": start}
    entry = effect(name)
    probe = Probe(name, {p.name: values[p.name] for p in entry.parameters}, (), False)
    items = {item.name: item for item in Unknowns(()).with_effect(name, probe.start, free_names(entry, probe)).items}
    assert len(items) == (2 if least is None else 3)
    if least is not None:
        assert items[f"effects.{name}.harmonic"].low == least


@pytest.mark.slow
@pytest.mark.parametrize("harmonic", [1.0, 7.0])
def test_a_cogging_is_named_with_its_harmonic_whether_fitted_or_not(harmonic: float) -> None:
    hidden = {"cogging": {"sine_N_m": 4e-6, "cosine_N_m": 4e-6, "harmonic": harmonic}}
    true = true_rig(RIG, hidden, {})
    runs = [generate(true, replace(SCENARIOS[kind], duration_s=4.0), 40 + k, name=kind) for k, kind in enumerate(KINDS)]
    found = judge(investigate(runs, RIG, Options(hold_out=KINDS[-1:])))
    assert [named.id for named in found.effects] == ["cogging"]
    told = found.effects[0].parameters
    assert list(told) == ["sine_N_m", "cosine_N_m", "harmonic"]
    if harmonic == 1.0:
        assert told["harmonic"] == Estimate(1.0, 1.0, 1.0, "")
    else:
        assert 0.0 < told["harmonic"].high - told["harmonic"].low < 1.0
        assert told["harmonic"].low < harmonic < told["harmonic"].high
