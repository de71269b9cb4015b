"""What is short and strong is told from noise that is as high on the average."""

from dataclasses import replace

import numpy as np
import pytest

from hil_forceps.diagnosis import load_course
from hil_forceps.diagnosis.bursts import COUNTS, EVERY, ROWS, STANDS_OUT, burst_of
from hil_forceps.diagnosis.diagnose import Options, investigate
from hil_forceps.diagnosis.judge import audit_findings, burst_beside, judge
from hil_forceps.diagnosis.spectrum import Flat, Layout, fill, make_layout
from tests.hidden_effects.generator import COLOURED, RIG, generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS

LONG, RUNS = 8000, 3
AT = 5000


def layout(channel: str = "theta_j_rad", rows: int = LONG) -> Layout:
    return make_layout([(channel,)] * RUNS, [np.ones(rows)] * RUNS, [1e-3] * RUNS)


def noise(where: Layout, seed: int, times: float = 1.0) -> Flat:
    """Return white noise, in one window of the second run `times` as strong."""
    rng = np.random.default_rng(seed)
    flat = np.zeros(where.size, dtype=np.float32)
    for part in where.parts:
        values = rng.standard_normal(part.rows)
        if part.run == 1:
            values[AT : AT + ROWS] *= times
        fill(flat, part, values)
    return flat


def test_noise_alone_has_no_burst_and_a_strong_window_is_one_where_it_is() -> None:
    where = layout()
    for seed in range(20):
        found = burst_of(where, noise(where, seed))
        assert found is not None
        assert found.gain < 0.4 * STANDS_OUT
        assert not found.stands_out
        found = burst_of(where, noise(where, seed, 3.0))
        assert found is not None
        assert found.stands_out
        assert found.run == 1
        assert abs(found.first - AT) < 2 * EVERY
        assert 4.0 < found.times < 14.0


def test_the_fading_at_the_ends_of_a_run_is_no_burst_and_hides_none_in_what_counts() -> None:
    where = layout()
    part = where.parts[0]
    rng = np.random.default_rng(3)
    flat = noise(where, 3)
    inside = int(np.flatnonzero(part.weights**2 > COUNTS)[0])
    values = rng.standard_normal(part.rows)
    values[:inside] = 0.0  # silence where it fades: what is left is no louder for it
    fill(flat, part, values)
    quiet = burst_of(where, flat)
    assert quiet is not None
    assert not quiet.stands_out
    values[inside + ROWS : inside + 2 * ROWS] *= 3.5
    fill(flat, part, values)
    loud = burst_of(where, flat)
    assert loud is not None
    assert loud.stands_out
    assert loud.run == 0


@pytest.mark.parametrize("where", [layout("theta_m_rad"), layout(rows=100)], ids=["no jaw's sensor", "too short"])
def test_nothing_is_said_without_a_jaw_s_sensor_or_of_a_moment(where: Layout) -> None:
    assert burst_of(where, noise(where, 5)) is None


@pytest.mark.slow
def test_a_jaw_that_is_struck_once_is_told_and_is_no_verdict() -> None:
    true = true_rig(RIG, {}, {})
    kinds = ("multisine", "trapezoid", "chirp")
    runs = [generate(true, replace(SCENARIOS[kind], duration_s=6.0), 61 + k, name=kind) for k, kind in enumerate(kinds)]
    quiet = investigate(runs, RIG, Options())
    assert judge(quiet).verdict == "consistent"
    assert not [said for said in audit_findings(quiet) if said.kind == "burst"]
    struck = runs[0].columns["theta_j_rad"].copy()
    there = slice(2000, 2040)
    struck[there] += 2.4e-3 * np.sin(0.9 * np.arange(40)) * np.exp(-np.arange(40) / 15.0)
    runs[0] = replace(runs[0], columns={**runs[0].columns, "theta_j_rad": struck})
    loud = investigate(runs, RIG, Options())
    assert judge(loud).verdict == "consistent"
    (said,) = [said for said in audit_findings(loud) if said.kind == "burst"]
    assert (said.run, said.channel, said.severity) == ("multisine", "theta_j_rad", "warning")
    assert "from 1.9" in said.text or "from 2.0" in said.text


@pytest.mark.slow
def test_a_small_jump_of_the_load_makes_no_burst_once_it_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    # At 4.371 s by 0.026 mN m, less than shows in an increment.
    kinds = ("multisine", "trapezoid", "chirp")
    runs = [generate(RIG, SCENARIOS[kind], 17305000 + k, COLOURED, name=kind) for k, kind in enumerate(kinds)]
    options = Options(hold_out=("chirp",))
    found = burst_beside(investigate(runs, RIG, options).choice)
    monkeypatch.setattr(load_course, "small_jumps", lambda *_: [])
    missed = burst_beside(investigate(runs, RIG, options).choice)
    assert found is not None
    assert missed is not None
    assert missed.gain > 5.0 * found.gain
    assert abs(missed.first - 4371) < 2 * ROWS
    assert found.gain < 0.4 * STANDS_OUT
