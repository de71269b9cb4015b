"""The audit: each kind hidden in clean data and found, and nothing found where nothing was hidden."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hil_forceps.audit.audit import audit
from hil_forceps.audit.finding import Finding
from hil_forceps.data.run import Column, Run
from hil_forceps.model.closed_loop import Inputs, law_vector, rest, simulate
from hil_forceps.model.linear_loop import DriveParameters, make_loop, rest_state, rollout
from hil_forceps.model.parameters import NAMES, index, vector
from hil_forceps.rig import Rig, load_rig
from hil_forceps.rig.catalogue import EFFECTS as CATALOGUE
from tests.hidden_effects.generator import RIG as GENERATED
from tests.hidden_effects.generator import generate, true_rig
from tests.hidden_effects.generator_scenarios import SCENARIOS
from tests.unit.audit.told_numbers import tells

COUNTS = 16384
Columns = dict[str, Column]
Change = Callable[[Columns], Columns]
KINDS = ("sines", "steps", "hold", "ramp", "chirp")


@cache
def the_rig() -> Rig:
    law = {"sample_time_s": 1e-3, "kp_A_per_rad": 1.2, "ki_A_per_rad_s": 15.0, "kd_A_s_per_rad": 0.006}
    drive = law | {"derivative_cutoff_Hz": 150.0, "current_limit_A": 1.0}
    return load_rig("configs/realistic.yaml").with_changes({"drive": drive, "bench.feedback_divider": 1})


def reference(kind: str, time_s: Column, generator: np.random.Generator) -> Column:
    phases = generator.uniform(0, 6, 4)
    waves = zip((0.3, 0.1, 0.05, 0.02), (0.4, 1.1, 2.3, 5.1), phases, strict=True)
    motions: dict[str, Column] = {
        "sines": 0.6 + np.sum([a * np.sin(2 * np.pi * f * time_s + p) for a, f, p in waves], axis=0),
        "steps": 0.6 + 0.3 * np.sign(np.sin(np.pi * time_s + phases[0])),
        "hold": np.full_like(time_s, 0.6),
        "ramp": 0.2 + 0.1 * time_s,
        "chirp": 0.6 + 0.1 * np.sin(2 * np.pi * (0.5 + 0.5 * time_s) * time_s),
    }
    return motions[kind]


@cache
def clean(seed: int = 0, kind: str = "sines", seconds: float = 12.0, load_N_m: float = 2e-3) -> Run:
    """Simulate a closed loop with load pulses both ways, and measure it with the rig's noise."""
    rig = the_rig()
    law = rig.require_drive()
    loop = make_loop(rig.plant(), DriveParameters(*(getattr(law, name) for name in DriveParameters._fields)), COUNTS)
    generator = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * 1000)) / 1000
    ref = reference(kind, time_s, generator)
    fine = np.arange(len(time_s) * loop.steps_per_sample) / 1000 / loop.steps_per_sample
    load = load_N_m * (((fine > 2) & (fine < 4)) - 0.5 * ((fine > 6) & (fine < 9)))
    out = rollout(loop, rest_state(rig.plant(), ref[0] * 2.0 / 1.4), ref, load)
    count = len(time_s)
    columns = {
        "time_s": time_s,
        "theta_m_ref_rad": ref,
        "theta_m_rad": out.theta_m_rad,
        "current_A": out.current_A + 1e-3 * generator.normal(size=count),
        "theta_j_rad": out.states[:, 2] + 2e-4 * generator.normal(size=count),
        "tau_w_N_m": load[:: loop.steps_per_sample] + 1e-5 * generator.normal(size=count),
    }
    return Run(f"{kind}{seed}", columns)


def changed(change: Change, kind: str = "sines", seed: int = 0) -> Run:
    run = clean(seed, kind)
    return Run(run.name, change({name: values.copy() for name, values in run.columns.items()}))


def serious(findings: list[Finding]) -> list[tuple[str, str]]:
    return [(finding.kind, finding.channel) for finding in findings if finding.severity != "note"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_found_where_nothing_is_hidden(kind: str, seed: int) -> None:
    findings = audit([clean(seed, kind)], the_rig())
    assert serious(findings) == []
    assert any(finding.kind == "excitation" for finding in findings)


def scaled(channel: str, factor: float) -> Change:
    return lambda columns: columns | {channel: factor * columns[channel]}


def shifted(channel: str, rows: int) -> Change:
    return lambda columns: columns | {channel: np.roll(columns[channel], rows)}


def frozen(channel: str) -> Change:
    def change(columns: Columns) -> Columns:
        columns[channel][5000:5400] = columns[channel][5000]
        return columns

    return change


def spiked(channel: str, size: float, rows: int = 1) -> Change:
    def change(columns: Columns) -> Columns:
        for begin in (1234, 7000):
            columns[channel][begin : begin + rows] += size
        return columns

    return change


def noisy(channel: str, sd: float) -> Change:
    noise = np.random.default_rng(5).normal(size=12_000)
    return lambda columns: columns | {channel: columns[channel] + sd * noise}


def smooth(channel: str) -> Change:
    return lambda columns: (
        columns | {channel: np.convolve(np.pad(columns[channel], 12, "edge"), np.ones(25) / 25, "valid")}
    )


def without(rows: slice) -> Change:
    return lambda columns: {name: np.delete(values, rows) for name, values in columns.items()}


def counted(channel: str, quantum: float) -> Change:
    return lambda columns: columns | {channel: np.round(columns[channel] / quantum) * quantum}


def constant(channel: str) -> Change:
    return lambda columns: columns | {channel: np.full_like(columns[channel], 0.25)}


def clipped(level: float) -> Change:
    noise = 1e-3 * np.random.default_rng(7).normal(size=12_000)
    return lambda columns: columns | {"current_A": np.clip(columns["current_A"], -level, level) + noise}


def restamped(stamps: Callable[[Column], Column]) -> Change:
    return lambda columns: columns | {"time_s": stamps(columns["time_s"])}


JITTER = np.random.default_rng(9).uniform(0, 5e-4, 12_000)


@pytest.mark.parametrize(
    ("change", "kind", "channel"),
    [
        (without(slice(3000, 3400)), "gaps", "time_s"),
        (restamped(lambda t: t + JITTER), "jitter", "time_s"),
        (restamped(lambda t: t * (1 + 2e-4 * t)), "clock_drift", "time_s"),
        (restamped(lambda t: np.r_[t[:500], t[500] - 0.99e-3, t[501:]]), "repeated_stamps", "time_s"),
        (restamped(lambda t: t * 1.3), "sample_rate", "time_s"),
        (restamped(lambda t: t * 1e3), "sample_rate", "time_s"),
        (counted("theta_m_rad", 2 * np.pi / 1024), "quantum", "theta_m_rad"),
        (counted("theta_j_rad", 0.1), "quantum", "theta_j_rad"),
        (smooth("theta_m_rad"), "quantum", "theta_m_rad"),
        (constant("theta_j_rad"), "constant", "theta_j_rad"),
        (constant("current_A"), "constant", "current_A"),
        (frozen("current_A"), "stuck", "current_A"),
        (frozen("theta_m_rad"), "stuck", "theta_m_rad"),
        (frozen("tau_w_N_m"), "stuck", "tau_w_N_m"),
        (lambda c: c | {"theta_j_rad": np.repeat(c["theta_j_rad"][::10], 10)}, "held", "theta_j_rad"),
        (clipped(0.15), "clipped", "current_A"),
        (noisy("theta_j_rad", 2e-3), "noise", "theta_j_rad"),
        (noisy("tau_w_N_m", 1e-4), "noise", "tau_w_N_m"),
        (noisy("current_A", 8e-3), "noise", "current_A"),
        (smooth("theta_j_rad"), "noise", "theta_j_rad"),
        (shifted("current_A", 4), "channel_shift", "current_A"),
        (shifted("current_A", -3), "channel_shift", "current_A"),
        (shifted("theta_j_rad", 15), "channel_shift", "theta_j_rad"),
        (shifted("theta_j_rad", -8), "channel_shift", "theta_j_rad"),
        (scaled("theta_j_rad", -1), "sign", "theta_j_rad"),
        (scaled("current_A", -1), "sign", "current_A"),
        (scaled("tau_w_N_m", -1), "sign", "tau_w_N_m"),
        (scaled("theta_m_ref_rad", -1), "sign", "theta_m_ref_rad"),
        (scaled("theta_j_rad", 180 / np.pi), "unit", "theta_j_rad"),
        (scaled("theta_m_rad", 180 / np.pi), "unit", "theta_m_rad"),
        (scaled("theta_m_ref_rad", 180 / np.pi), "unit", "theta_m_ref_rad"),
        (scaled("current_A", 1000), "unit", "current_A"),
        (scaled("tau_w_N_m", 1000), "unit", "tau_w_N_m"),
        (spiked("theta_m_rad", 0.05), "outliers", "theta_m_rad"),
        (spiked("current_A", -0.6), "outliers", "current_A"),
        (spiked("theta_j_rad", 0.1, 2), "outliers", "theta_j_rad"),
        (spiked("tau_w_N_m", 5e-3), "outliers", "tau_w_N_m"),
        (scaled("theta_j_rad", 0.5), "kinematics", "theta_j_rad"),
        (lambda c: c | {"current_A": c["current_A"][::-1].copy()}, "drive_law", "current_A"),
        (
            lambda c: {
                n: v if n in ("time_s", "theta_m_ref_rad") else np.full_like(v, v[0]) + 1e-9 * np.sin(1e4 * c["time_s"])
                for n, v in c.items()
            },
            "excitation",
            "theta_m_rad",
        ),
    ],
)
def test_what_is_hidden_is_found(change: Change, kind: str, channel: str) -> None:
    findings = audit([changed(change)], the_rig())
    assert (kind, channel) in {(finding.kind, finding.channel) for finding in findings}
    (found,) = [finding for finding in findings if (finding.kind, finding.channel) == (kind, channel)]
    assert found.run == "sines0"
    assert channel in found.text or channel == "time_s"


def text_of(change: Change, kind: str, channel: str) -> str:
    findings = audit([changed(change)], the_rig())
    (found,) = [finding for finding in findings if (finding.kind, finding.channel) == (kind, channel)]
    return found.text


def test_numbers_are_right() -> None:
    assert tells(text_of(without(slice(3000, 3400)), "gaps", "time_s"), 400)
    assert tells(text_of(counted("theta_m_rad", 2 * np.pi / 1024), "quantum", "theta_m_rad"), 1024)
    assert tells(text_of(shifted("current_A", 4), "channel_shift", "current_A"), 4)  # ms
    assert tells(text_of(shifted("theta_j_rad", 15), "channel_shift", "theta_j_rad"), pytest.approx(15, abs=2))
    assert tells(text_of(clipped(0.15), "clipped", "current_A"), pytest.approx(0.15, abs=5e-3))
    assert tells(text_of(scaled("theta_j_rad", 0.5), "kinematics", "theta_j_rad"), pytest.approx(0.7, rel=0.05))
    assert tells(text_of(spiked("theta_j_rad", 0.1, 2), "outliers", "theta_j_rad"), 4)
    assert tells(text_of(noisy("current_A", 8e-3), "noise", "current_A"), pytest.approx(8e-3, rel=0.1))


@pytest.mark.parametrize(
    ("effect", "told"),
    [
        ("load_dependent_friction", set()),
        ("stribeck_friction", set()),
        ("wire_slack", set()),
        ("wire_hysteresis", set()),
        ("current_gain", set()),
        ("current_offset", set()),
        ("channel_skew", {"channel_shift"}),
        ("current_saturation", {"clipped", "reference"}),
    ],
)
def test_effects_of_physics_are_no_problems_of_the_data(effect: str, told: set[str]) -> None:
    base, theta = clean(3, "steps").columns, vector(the_rig())
    for name in (name for name in NAMES if name.startswith(f"effects.{effect}.")):
        parameter = {p.name: p for e in CATALOGUE if e.id == effect for p in e.parameters}[name.rpartition(".")[2]]
        theta[index(name)] = parameter.typical
    reference_rad, load = base["theta_m_ref_rad"], np.round(base["tau_w_N_m"] / 1e-4) * 1e-4
    inputs = Inputs(base["time_s"], reference_rad, load, np.empty(0, np.int64), np.empty(0))
    law, quantum = law_vector(the_rig().require_drive()), 2 * np.pi / COUNTS
    out = simulate(theta, law, quantum, inputs, rest(theta, float(reference_rad[0])), 4)
    noise = np.random.default_rng(1).normal(size=(3, len(load)))
    measured = {
        "theta_m_rad": np.round(out.theta_m_rad / quantum) * quantum,
        "current_A": out.current_A + 1e-3 * noise[0],
        "theta_j_rad": out.theta_j_rad + 2e-4 * noise[1],
        "tau_w_N_m": out.tau_w_N_m + 1e-5 * noise[2],
    }
    findings = audit([Run(effect, base | measured)], the_rig())
    assert {finding.kind for finding in findings if finding.severity != "note"} == told
    assert not any(finding.severity == "problem" for finding in findings)


def test_a_run_of_another_rig() -> None:
    other = the_rig().with_changes(
        {"drive.kp_A_per_rad": 0.2, "drive.ki_A_per_rad_s": 400.0, "drive.kd_A_s_per_rad": 0.0}
    )
    assert ("drive_law", "current_A") in serious(audit([clean(0, "steps")], other))
    other = the_rig().with_changes({"forceps.motor_pulley_radius_m": 4.0e-3})
    assert serious(audit([clean()], other)) == [("kinematics", "theta_j_rad")]
    for counts in (4096, 65536, 10_000):
        other = the_rig().with_changes({"encoder.counts_per_rev": counts})
        assert serious(audit([clean()], other)) == [("quantum", "theta_m_rad")]
    assert serious(audit([clean()], the_rig().with_changes({"encoder.counts_per_rev": "ideal"}))) == [
        ("quantum", "theta_m_rad")
    ]


def test_runs_against_each_other() -> None:
    runs = [clean(seed) for seed in (1, 2, 3)]
    assert serious(audit(runs, the_rig())) == []
    again = Run("again", runs[1].columns)
    cut = Run("cut", {name: values[:6000] for name, values in runs[2].columns.items()})
    found = [finding for finding in audit([*runs, again, cut], the_rig()) if finding.kind == "duplicate"]
    assert [(finding.run, finding.severity) for finding in found] == [("again", "problem"), ("cut", "warning")]
    odd = changed(scaled("theta_j_rad", 1.15), seed=4)
    assert serious(audit([*runs, odd], the_rig())) == [("odd_run", "theta_j_rad")]


def test_without_jaw_sensor_load_cell_drive_or_reference() -> None:
    kept = {name: clean().columns[name] for name in ("time_s", "theta_m_rad", "current_A")}
    rig = the_rig().with_changes({"drive": None})
    findings = audit([Run("bare", kept)], rig)
    assert serious(findings) == []
    assert {"no_load_cell", "no_jaw_sensor"} <= {finding.kind for finding in findings}
    torque = {"tau_m_N_m" if name == "current_A" else name: values for name, values in clean().columns.items()}
    torque["tau_m_N_m"] = 1.35e-2 * torque["tau_m_N_m"]
    assert serious(audit([Run("torque", torque)], rig)) == []
    assert ("sign", "tau_m_N_m") in serious(audit([Run("t", torque | {"tau_m_N_m": -torque["tau_m_N_m"]})], rig))
    assert ("unit", "tau_m_N_m") in serious(audit([Run("t", torque | {"tau_m_N_m": 1e3 * torque["tau_m_N_m"]})], rig))


def test_notes_of_the_reader_are_passed_on() -> None:
    run = Run("noted", without(slice(100, 200))(dict(clean().columns)), ("3 rows repeat",))
    told = [finding.text for finding in audit([run], the_rig()) if finding.kind == "reader"]
    assert told == ["3 rows repeat"]


def test_two_rows_are_enough_to_say_something() -> None:
    run = Run("two", {"time_s": np.array([0.0, 1e-3]), "theta_m_rad": np.zeros(2), "current_A": np.ones(2)})
    assert ("constant", "theta_m_rad") in serious(audit([run], the_rig()))


def test_time_grows_as_the_rows_do() -> None:
    def seconds(run: Run) -> float:
        """Return the least processor time of three audits."""
        spent = []
        for _ in range(3):
            begin = time.process_time()
            audit([run], the_rig())
            spent.append(time.process_time() - begin)
        return min(spent)

    # What grows by rows takes 8 times as long, what grows by their square 64 times.
    assert seconds(clean(0, "sines", 96.0)) < 23.0 * seconds(clean(0, "sines", 12.0))


@pytest.mark.parametrize("seed", [0, 4, 9])
def test_what_the_integral_held_at_the_start_is_no_clipping(seed: int) -> None:
    """A run that begins amid motion has a constant more in all its commands: the law seemed to ask for more."""
    scenario = replace(SCENARIOS["teleoperation"], duration_s=6.0)
    run = generate(true_rig(GENERATED, {}, {}), scenario, seed, name="amid")
    assert not [finding for finding in audit([run], GENERATED) if finding.kind == "clipped"]
