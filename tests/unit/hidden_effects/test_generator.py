"""The generator of hidden-effect data: what it writes, what it draws, and how it measures the size of an effect."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from hil_forceps.data.readers.csv_table import read_csv
from hil_forceps.rig.catalogue import EFFECTS, effect
from tests.hidden_effects.generator import (
    CHANNELS,
    COLOURED,
    FAST_DRIVE_RIG,
    FIT_SCENARIOS,
    OTHER_GAINS_RIG,
    RIG,
    generate,
    make_case,
    quantum_rad,
    simulate,
    true_rig,
    write_csv,
)
from tests.hidden_effects.generator_scenarios import KINDS, SCENARIOS, Scenario
from tests.hidden_effects.generator_sizes import effect_size, scaled, size_for

SHORT = {name: dataclasses.replace(scenario, duration_s=3.0) for name, scenario in SCENARIOS.items()}
TYPICAL = {entry.id: {p.name: p.typical for p in entry.parameters} for entry in EFFECTS}
COLUMNS = ["time_s", "theta_m_ref_rad", "theta_m_rad", "current_A", "theta_j_rad", "tau_w_N_m"]


def test_a_run_is_a_table_of_the_contract_and_its_file_reads_back(tmp_path: Path) -> None:
    run = generate(RIG, SCENARIOS["multisine"], 1)
    assert list(run.columns) == COLUMNS
    assert len(run) == 12_000
    assert run.sample_time_s == pytest.approx(1.0e-3)
    assert run.notes == ()
    counts = run.columns["theta_m_rad"] / quantum_rad(RIG)
    assert counts == pytest.approx(np.rint(counts), abs=1.0e-6)
    write_csv(run, tmp_path / "run.csv")
    back = read_csv(tmp_path / "run.csv")
    assert {name: back.columns[name].tobytes() for name in COLUMNS} == {
        name: run.columns[name].tobytes() for name in COLUMNS
    }


@pytest.mark.parametrize("name", SCENARIOS)
def test_same_seed_same_bytes_and_another_seed_another_run(name: str) -> None:
    first, again, other = (generate(RIG, SHORT[name], seed).columns for seed in (5, 5, 6))
    assert all(first[column].tobytes() == again[column].tobytes() for column in COLUMNS)
    assert first["current_A"].tobytes() != other["current_A"].tobytes()
    if name != "rest":
        assert np.ptp(first["theta_m_rad"]) > 0.1
        assert np.ptp(first["tau_w_N_m"]) > 5.0e-4
        assert np.abs(first["tau_w_N_m"]).max() < 6.0e-3
        assert np.abs(first["theta_m_ref_rad"] - first["theta_m_rad"]).mean() < 0.1


def test_runs_begin_at_rest_or_in_the_middle_of_things() -> None:
    names = ("multisine", "multisine_mid")
    speeds = {name: abs(float(simulate(RIG, SHORT[name], 7, ideal=True)[1].truth[0, 1])) for name in names}
    assert speeds["multisine"] < 1.0e-9
    assert speeds["multisine_mid"] > 1.0e-2


def test_grasp_is_loaded_by_what_it_grips() -> None:
    columns = generate(RIG, SCENARIOS["grasp"], 2).columns
    free = columns["theta_j_rad"] < 0.0
    assert np.abs(columns["tau_w_N_m"][free]).max() < 6.0 * RIG.noise.tau_w_N_m
    deep = columns["theta_j_rad"] > 0.3
    slope, _ = np.polyfit(columns["theta_j_rad"][deep], columns["tau_w_N_m"][deep], 1)
    assert 4.0e-3 < slope < 8.0e-3


@pytest.mark.parametrize("noise", [None, COLOURED])
def test_noise_is_as_large_and_as_coloured_as_asked(noise: object) -> None:
    run = generate(RIG, SCENARIOS["slow"], 4) if noise is None else generate(RIG, SCENARIOS["slow"], 4, COLOURED)
    log = simulate(RIG, SCENARIOS["slow"], 4)[1]
    assert run.columns["theta_m_rad"].tobytes() == log.theta_m_rad.tobytes()
    for channel, deviation in (("current_A", 1.0e-3), ("theta_j_rad", 2.0e-4), ("tau_w_N_m", 1.0e-5)):
        error = run.columns[channel] - getattr(log, channel)
        assert error.std() == pytest.approx(deviation, rel=0.1)
        correlation = np.corrcoef(error[1:], error[:-1])[0, 1]
        assert correlation == pytest.approx(0.0 if noise is None else 0.9, abs=0.04)


def test_other_drives_give_other_runs_at_the_same_rows() -> None:
    runs = [generate(rig, SHORT["trapezoid"], 3) for rig in (RIG, OTHER_GAINS_RIG, FAST_DRIVE_RIG)]
    assert [len(run) for run in runs] == [3000] * 3
    assert len({run.columns["theta_m_rad"].tobytes() for run in runs}) == 3
    assert runs[2].columns["theta_m_rad"] == pytest.approx(runs[0].columns["theta_m_rad"], abs=0.05)
    with pytest.raises(ValueError, match="don't fall on samples"):
        generate(FAST_DRIVE_RIG, Scenario("slow", row_s=7.5e-4), 1)
    with pytest.raises(KeyError):
        generate(RIG, Scenario("dance"), 1)


def test_a_case_hides_effects_and_shifts_and_drops_what_was_not_measured() -> None:
    case = make_case({"wire_slack": {"half_width_m": 1e-6}}, 2, shifts={"forceps.wire_stiffness_N_per_m": 0.8},
                     drop=["theta_j_rad"])  # fmt: skip
    assert (len(case.fit), len(case.held_out), len(case.runs)) == (4, 2, 6)
    assert case.assumed.effects == {}
    assert case.true.effects == {"wire_slack": {"half_width_m": 1e-6}}
    assert case.true.plant().wire_stiffness_N_per_m == pytest.approx(0.8 * 2.6e4)
    assert all("theta_j_rad" not in run.columns and len(run.columns) == 5 for run in case.runs)
    assert len({run.name for run in case.runs}) == 6
    held_out = {run.name.partition("_")[2] for run in case.held_out}
    assert held_out.isdisjoint(run.name.partition("_")[2] for run in case.fit)


def test_a_shift_alone_has_no_size_and_an_effect_has() -> None:
    """What a small change of k does is projected out; what slack does isn't, and grows with it."""
    runs = ("multisine",)
    assert effect_size({}, 1, scenarios=runs) == 0.0
    softer = true_rig(RIG, {}, {"forceps.wire_stiffness_N_per_m": 1.01})
    small = effect_size({"wire_slack": {"half_width_m": 1e-7}}, 1, scenarios=runs)
    large = effect_size({"wire_slack": {"half_width_m": 2e-7}}, 1, scenarios=runs)
    assert 1.6 < large / small < 2.1  # a dead zone is not quite in proportion to its width
    # The same way of counting, with the stiffness itself as what is hidden: seen from the softer rig.
    hardening = {"wire_hardening": {"beta_per_m2": 1e7}}
    assert effect_size(hardening, 1, scenarios=runs) == pytest.approx(
        effect_size(hardening, 1, scenarios=runs, rig=softer), rel=0.05
    )


def test_what_is_touched_answers_and_that_is_no_size() -> None:
    """A stretched wire moves the jaw, so another load is met, which is measured; only the jaw's zero shows it."""
    stretched = {"wire_permanent_stretch": {"stretch_m": 8e-5}}
    free, touching = (effect_size(stretched, 1, scenarios=(kind,)) for kind in ("multisine", "grasp"))
    assert touching == pytest.approx(free, rel=0.1)


def test_effect_of_a_wanted_size() -> None:
    runs = FIT_SCENARIOS[:1]
    sized = size_for(12.0, {"cogging": TYPICAL["cogging"]}, 3, scenarios=runs)
    assert effect_size(sized, 3, scenarios=runs) == pytest.approx(12.0, rel=0.05)
    assert sized["cogging"]["sine_N_m"] < TYPICAL["cogging"]["sine_N_m"]
    with pytest.raises(ValueError, match="no size of"):
        size_for(1.0e9, {"current_offset": TYPICAL["current_offset"]}, 3, scenarios=("rest",))


def test_scaling_stays_within_the_catalogue() -> None:
    huge = scaled({"cogging": TYPICAL["cogging"], "wire_slack": TYPICAL["wire_slack"]}, 1.0e9)
    assert huge["cogging"] == {"sine_N_m": 1.0, "cosine_N_m": 1.0, "harmonic": 6.0}
    assert scaled({"current_saturation": {"limit_A": 0.2}}, 0.5)["current_saturation"] == {"limit_A": 0.4}
    assert huge["wire_slack"]["half_width_m"] == effect("wire_slack").parameters[0].maximum


def test_every_kind_is_in_the_list_and_every_channel_in_a_run() -> None:
    assert {scenario.kind for scenario in SCENARIOS.values()} == set(KINDS)
    assert set(CHANNELS) < set(COLUMNS)
