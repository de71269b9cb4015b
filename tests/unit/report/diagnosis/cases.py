"""Diagnoses of every verdict, as the report gets them."""

import html.parser
import re
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hil_forceps.audit.finding import Finding
from hil_forceps.diagnosis.result import (
    Balance,
    Candidate,
    Detectable,
    Diagnosis,
    Estimate,
    Gain,
    NamedEffect,
    NextExperiment,
    RunEvidence,
    Shift,
    Trend,
    Verdict,
)
from hil_forceps.report.diagnosis.files import write_report

State = Literal["named", "tied", "weaker", "below threshold", "at a bound", "not excited"]
Vector = NDArray[np.float64]
NOISE = {"theta_m_rad": 2e-4, "current_A": 1e-3, "theta_j_rad": 2e-4}


def run_evidence(
    name: str = "sine_1",
    *,
    seed: int = 1,
    seconds: float = 12.0,
    held_out: bool = False,
    jaw: bool = True,
    load: bool = True,
    slack: float = 4e-3,
    nominal_factor: float = 1.06,
) -> RunEvidence:
    """A run of a plausible forceps whose jaw lags by `slack` rad after each reversal."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, seconds, 1e-3)
    hz = 0.4 + 0.1 * seed
    theta = 0.6 * np.sin(2 * np.pi * hz * time_s) * (1 - 0.2 * np.cos(0.5 * time_s))
    omega = np.gradient(theta, time_s)
    tau_w = 2e-3 * np.sin(2 * np.pi * 0.13 * time_s + seed) * (time_s > 2)
    tension = tau_w / 1.4e-3
    gone = np.flatnonzero(np.diff(np.sign(omega)) != 0)
    last = np.concatenate([[0], gone])[np.searchsorted(gone, np.arange(len(time_s)))]
    since = time_s - time_s[last]
    current = 0.15 * tau_w / 2e-3 + 8e-3 * omega / 2 + 5e-3 * np.tanh(omega / 0.05)
    missing_current = 6e-3 * np.sign(omega) * np.exp(-since / 0.05) + 4e-3 * tension / 1.4 * np.sign(omega)
    jaw_angle = 1.43 * theta - tension * 0.02
    missing_jaw = slack * np.tanh(tension / 0.2)
    clean = {"theta_m_rad": theta, "current_A": current + missing_current, "theta_j_rad": jaw_angle + missing_jaw}
    baseline = {"theta_m_rad": theta - 4e-4 * np.sign(omega), "current_A": current, "theta_j_rad": jaw_angle}
    extended = {key: clean[key] + 0.1 * NOISE[key] * np.sin(time_s) for key in clean}
    nominal = {key: nominal_factor * values for key, values in baseline.items()}
    keep = [key for key in clean if jaw or key != "theta_j_rad"]
    measured = {key: clean[key] + NOISE[key] * random.standard_normal(len(time_s)) for key in keep}
    measured["theta_m_ref_rad"] = theta + 2e-3 * omega
    variables = {"theta": theta, "omega": omega, "tension": tension, "time_since_reversal": since}
    variables["acceleration"] = np.gradient(omega, time_s)
    estimates: dict[str, Vector] = {}
    if load:
        measured["tau_w_N_m"] = tau_w + 1e-5 * random.standard_normal(len(time_s))
        variables["load"] = tau_w
        sign = np.sign(omega)
        estimates = {"tau_w_before_N_m": tau_w + 2e-4 * sign, "tau_w_after_N_m": tau_w + 2e-5 * sign}
        if jaw:
            estimates |= {"theta_j_before_rad": jaw_angle, "theta_j_after_rad": jaw_angle + 0.9 * missing_jaw}
    pick = {stage: {key: columns[key] for key in keep} for stage, columns in
            {"baseline": baseline, "extended": extended, "nominal": nominal}.items()}  # fmt: skip
    return RunEvidence(
        name, held_out, time_s, measured, pick["baseline"], pick["extended"], pick["nominal"], variables, estimates
    )


def wire_slack(*, runs: int = 6, jaw: bool = True) -> Diagnosis:
    """An effect in the wire, found in `runs` runs of which the last is held out."""
    names = ("sine_slow", "sine_fast", "chirp", "steps_of_load", "hold_and_release", "multi_turn_spin")
    evidence = tuple(
        run_evidence(names[place], seed=place + 1, held_out=runs > 1 and place == runs - 1, jaw=jaw)
        for place in range(runs)
    )
    ids = ("wire_slack", "load_dependent_friction", "wire_hysteresis", "jaw_gravity", "wire_damping", "cogging",
           "stribeck_friction", "presliding_friction", "encoder_scale", "current_offset", "wire_creep", "viscous_drift",
           "torque_ripple", "actuation_delay", "pulley_eccentricity")  # fmt: skip
    first = tuple(
        Candidate(one, 0, 4200.0 / 2.1**place, 14.0, "weaker" if place else "named") for place, one in enumerate(ids)
    )
    states: tuple[State, ...] = ("named", "tied", "weaker", "weaker", "at a bound", "not excited")
    second = tuple(
        Candidate(one, 1, 310.0 / 2.6**place, 14.0, state)
        for place, (one, state) in enumerate(zip(ids[1:], states, strict=False))
    )
    third = tuple(Candidate(one, 2, 9.0 / 1.6**place, 14.0, "below threshold") for place, one in enumerate(ids[2:10]))
    gain = {
        "theta_m_rad": Gain(4.4e-4, 2.1e-4, 2e-4, 0.97, 0.94, 0.99),
        "current_A": Gain(5.1e-3, 1.1e-3, 1e-3, 0.991, 0.985, 0.996),
        "tau_w_estimate_N_m": Gain(2e-4, 2e-5, 1e-5, 0.99, 0.97, 0.995),
    }
    balances = [
        Balance("motor", "current_A", 5.1, 1.03),
        Balance("sensor", "theta_m_rad", 2.2, 1.01),
        Balance("timing", "current_A", 1.1, 1.0),
    ]
    trends = [Trend("current_A", "time_since_reversal", 0.62, 0.01), Trend("current_A", "tension", 0.4, 0.005)]
    if jaw:
        gain["theta_j_rad"] = Gain(3.9e-3, 2.2e-4, 2e-4, 0.998, 0.996, 0.999)
        balances += [Balance("wire", "theta_j_rad", 19.5, 1.02), Balance("jaw", "theta_j_rad", 1.3, 1.02)]
        trends.append(Trend("theta_j_rad", "tension", 0.97, 0.01))
    return Diagnosis(
        "effects",
        "The wire has slack of ±2.06 µm around zero tension, and friction of the motor grows with tension.",
        effects=(
            NamedEffect("wire_slack", "wire", 0.98, {"half_width_m": Estimate(2.06e-6, 1.98e-6, 2.14e-6, "m")}),
            NamedEffect("load_dependent_friction", "motor", 0.81, {"mu": Estimate(0.0213, 0.0197, 0.0229)}),
        ),
        candidate_sets=(("wire_slack", "load_dependent_friction"), ("wire_slack", "wire_hysteresis")),
        parameter_shifts={
            "forceps.wire_stiffness_N_per_m": Shift(2.6e4, Estimate(2.21e4, 2.15e4, 2.27e4, "N_per_m")),
            "motor.torque_constant_N_m_per_A": Shift(1.35e-2, Estimate(1.352e-2, 1.34e-2, 1.364e-2, "N_m_per_A")),
            "forceps.motor_coulomb_N_m": Shift(None, Estimate(6.1e-5, 5.8e-5, 6.4e-5, "N_m")),
            "forceps.jaw_inertia_kg_m2": Shift(6.85e-8, Estimate(6.9e-8, 5.9e-8, 7.8e-8, "kg_m2")),
        },
        gain=gain,
        held_out=(evidence[-1].name,) if runs > 1 else (),
        data_audit=(
            Finding("gap", "warning", "chirp", "time_s", "1 gap in time, about 12 samples missing"),
            Finding("quantum", "note", "sine_slow", "theta_m_rad", "quantum of 3.83e-4 rad, as the encoder's"),
        ),
        minimum_detectable={
            "wire_creep": Detectable("share", 0.0061, ""),
            "cogging": Detectable("sine_N_m", 3.1e-6, "N_m"),
            "wire_hardening": Detectable("beta_per_m2", 2.2e6, "per_m2"),
        },
        next_experiment=NextExperiment(
            "hold_and_release",
            (("load_dependent_friction", "wire_hysteresis"),),
            11.2,
            "Friction keeps its torque when the load is held; a loop doesn't.",
        ),
        reasons=("load_dependent_friction and wire_hysteresis differ by 2.1 in χ², below the calibrated 6.3",),
        candidates=first + second + third,
        balances=tuple(balances),
        trends=tuple(trends),
        noise_sd=NOISE,
        runs=evidence,
    )  # fmt: skip


def without_effects(verdict: Verdict, sentence: str, slack: float = 0.0) -> Diagnosis:
    """A diagnosis that named nothing, two runs."""
    runs = tuple(run_evidence(f"run_{seed}", seed=seed, held_out=seed == 2, slack=slack) for seed in (1, 2))
    still = tuple(replace(run, extended=run.baseline) for run in runs)
    if verdict != "unnamed":
        still = tuple(replace(run, baseline=run.extended, extended=run.extended, nominal=run.nominal) for run in runs)
    return replace(
        wire_slack(runs=2), verdict=verdict, sentence=sentence, effects=(), runs=still, candidate_sets=((),), gain={},
        reasons=(), next_experiment=None, candidates=tuple(replace(c, state="below threshold", score=c.threshold / 3)
        for c in wire_slack(runs=2).candidates if c.step == 0), trends=(), balances=(),
        varies_over=("tension", "time_since_reversal") if verdict == "unnamed" else (),
    )  # fmt: skip


def undetermined() -> Diagnosis:
    """Nothing at all could be simulated."""
    return Diagnosis(
        "undetermined",
        "These data can't tell: the motor never moved.",
        reasons=("theta_m_rad is constant in every run", "tau_w_N_m wasn't measured"),
        data_audit=(Finding("constant", "problem", "still", "theta_m_rad", "constant over 12 s"),),
        next_experiment=NextExperiment("chirp", (), float("nan"), "It moves the motor through the loop's whole band."),
    )


CASES = {
    "effects": wire_slack,
    "one_run_no_jaw": lambda: wire_slack(runs=1, jaw=False),
    "unnamed": lambda: without_effects("unnamed", "Something beyond the catalogue varies over tension.", 4e-3),
    "parameters": lambda: without_effects("parameters", "The wire is 15 % softer than the rig says."),
    "consistent": lambda: without_effects("consistent", ""),
    "undetermined": undetermined,
}


class Page(html.parser.HTMLParser):
    """What a browser would see: balanced tags, addresses, ids, text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.headings: list[str] = []
        self.images = 0
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)
        self.images += tag == "img"
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href")]
        self.ids += [value or "" for name, value in attrs if name == "id"]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)
        if "style" not in self.open:
            self.text += data


def page_of(diagnosis: Diagnosis, folder: Path) -> Page:
    write_report(diagnosis, folder / "out" / "report.html")
    raw = (folder / "out" / "report.html").read_text(encoding="utf-8")
    page = Page(raw)
    assert page.open == []
    assert len(raw) < 5_000_000
    assert all(one.startswith(("data:image/svg+xml;base64,", "#s")) for one in page.addresses)
    assert "url(" not in raw
    assert "<script" not in raw
    assert len(set(page.ids)) == len(page.ids)
    assert not re.search(r"\b(nan|inf|None)\b", page.text)
    return page
