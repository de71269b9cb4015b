"""The transmission estimator: recovers what was simulated, uses no future, is the same sample by sample and at once."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_forceps.data.run import Run
from hil_forceps.estimation import transmission
from hil_forceps.estimation.transmission import TERMS, Structure
from hil_forceps.identification.instrument.report import RunInfo
from hil_forceps.identification.instrument.splits import EXTREMES, ODD_LOADS, splits
from hil_forceps.identification.instrument.transmission_fit import PRESLIDING_RAD, fit_transmission, inputs
from hil_forceps.rig.errors import UserError

Vector = NDArray[np.float64]

RATE_Hz = 1000
SECONDS = 12.0


def simulated_run(name: str, load_N_m: float, frequency_Hz: float, seed: int) -> Run:
    """A motor that turns a wire-driven jaw; its own equations, integrated here, share no code with the estimator."""
    time = np.arange(0.0, SECONDS, 1.0 / RATE_Hz)
    phase = 2 * np.pi * frequency_Hz * time
    theta = -0.5 + 0.5 * np.cos(phase)
    speed = np.gradient(theta, time)
    presliding = np.zeros_like(theta)  # friction element in [-1, 1], by Dahl's law in small steps
    for n in range(1, len(theta)):
        way = theta[n] - theta[n - 1]
        presliding[n] = presliding[n - 1] + way * (1 - np.sign(way) * presliding[n - 1]) / 0.04
    tau_w = load_N_m * (1 + 0.15 * theta) + 1e-3 * np.sin(3 * phase)
    tau_m = 1.4 * tau_w * (1 + 0.25 * presliding) + 0.03 * presliding + 0.004 * speed
    theta_j = 0.9 * theta + 1.1 - 0.4 * tau_m
    noise = np.random.default_rng(seed)
    columns = {
        "time_s": time,
        "theta_m_rad": theta + 1e-4 * noise.standard_normal(len(time)),
        "theta_drive_rad": theta,
        "tau_m_N_m": tau_m + 2e-4 * noise.standard_normal(len(time)),
        "theta_j_rad": theta_j,
        "tau_w_N_m": tau_w,
    }
    return Run(name, columns)


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    loads = (0.01, 0.03, 0.05, 0.07)
    return [
        simulated_run(f"{x}{y}", load, frequency, 10 * x + y)
        for x, frequency in enumerate((0.2, 0.4))
        for y, load in enumerate(loads)
    ]


def rms(values: Vector) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_it_recovers_the_load_and_the_angle_of_runs_it_was_not_fitted_to(runs: list[Run]) -> None:
    train = [run for run in runs if run.name[1] in "02"]
    levels = {run.name: int(run.name[1]) for run in runs}
    fit = fit_transmission(train, levels, "tau_m_N_m")
    inside = slice(2 * RATE_Hz, -RATE_Hz)
    for run in (run for run in runs if run.name[1] == "1"):
        tau_w, theta_j = transmission.run(fit.constants, *inputs(run, "tau_m_N_m"))
        truth = run.columns["tau_w_N_m"]
        friction = run.columns["tau_m_N_m"] / 1.4 - truth  # what an estimator without friction would be off by
        assert rms((tau_w - truth)[inside]) < 0.12 * rms(friction[inside])
        assert rms((theta_j - run.columns["theta_j_rad"])[inside]) < np.radians(0.25)


def test_the_future_changes_nothing_before(runs: list[Run]) -> None:
    fit = fit_transmission(runs[:4], {run.name: int(run.name[1]) for run in runs}, "tau_m_N_m")
    whole = inputs(runs[5], "tau_m_N_m")
    cut = 7000
    changed = whole._replace(
        theta_m_rad=np.concatenate([whole.theta_m_rad[:cut], whole.theta_m_rad[cut:] + 0.2]),
        theta_drive_rad=np.concatenate([whole.theta_drive_rad[:cut], 3.0 * whole.theta_drive_rad[cut:]]),
        drive=np.concatenate([whole.drive[:cut], -whole.drive[cut:]]),
    )
    before, after = transmission.run(fit.constants, *whole), transmission.run(fit.constants, *changed)
    for one, other in zip(before, after, strict=True):
        assert np.array_equal(one[:cut], other[:cut])
        assert not np.array_equal(one[cut:], other[cut:])


def test_steps_give_the_same_bits_as_a_record(runs: list[Run]) -> None:
    fit = fit_transmission(runs[:4], {run.name: int(run.name[1]) for run in runs}, "tau_m_N_m")
    data = inputs(runs[6], "tau_m_N_m")
    tau_w, theta_j = transmission.run(fit.constants, *data)
    samples = zip(*(column[:500].tolist() for column in data), strict=True)
    state = transmission.start(fit.constants, *next(samples))
    for n, sample in enumerate(samples, start=1):
        kept = state.copy()
        new = transmission.step(state, fit.constants, *sample)
        assert np.array_equal(state, kept)  # never changed in place
        state = new
        assert state[transmission.TAU_W] == tau_w[n]
        assert state[transmission.THETA_J] == theta_j[n]
    same = transmission.step(state, fit.constants, int(data.time_ns[499]), 9.0, 9.0, 9.0)
    assert np.array_equal(same, state)  # a stamp that isn't later


def test_outside_its_range_only_the_straight_part_of_the_angle_goes_on() -> None:
    angle, torque = np.zeros(TERMS), np.zeros(TERMS)
    angle[:4] = (0.0, 0.5, 7.0, -3.0)
    torque[:4] = (0.0, 0.5, 7.0, -3.0)
    c = transmission.constants(Structure(60.0, PRESLIDING_RAD[0], (-1.0, 1.0)), torque, angle)
    edge, beyond = (transmission.start(c, 0, theta, theta, 0.0) for theta in (1.0, 3.0))
    assert beyond[transmission.TAU_W] == edge[transmission.TAU_W] == pytest.approx(4.5)
    assert beyond[transmission.THETA_J] - edge[transmission.THETA_J] == pytest.approx(0.5 * 2.0)


@pytest.mark.parametrize("standstill", [0.0, 0.2])
def test_at_rest_friction_takes_what_drives_until_it_has_no_more(standstill: float) -> None:
    torque = np.zeros(TERMS)
    names = transmission.term_names()
    torque[names.index("u x^0")] = 1.0
    for element in (1, 2, 3):
        torque[names.index(f"z{element} x^0")] = -0.2 / 3
    c = transmission.constants(Structure(60.0, PRESLIDING_RAD[0], (-1.0, 1.0), standstill), torque)
    drive = np.concatenate([np.zeros(100), np.full(400, 0.15), np.full(400, 0.5)])
    rest = np.zeros_like(drive)
    tau_w, _ = transmission.run(c, np.arange(drive.size) * 1_000_000, rest, rest, drive)
    reached = tau_w[[499, 899]]
    assert reached == pytest.approx([0.0, 0.3] if standstill else [0.15, 0.5], abs=2e-3)
    moving = np.linspace(0.0, 0.9, drive.size)
    anyhow = [
        transmission.run(
            transmission.constants(Structure(60.0, PRESLIDING_RAD[0], (-1.0, 1.0), s), torque),
            np.arange(drive.size) * 1_000_000,
            moving,
            moving,
            drive,
        )[0]
        for s in (0.0, standstill)
    ]
    assert np.allclose(anyhow[0], anyhow[1], atol=1e-9)  # a motor that turns has all its friction already


def stopping_run(name: str, load_N_m: float, seed: int) -> Run:
    """A motor that stops for a second in every two; its gear sticks then and takes a current that wanders."""
    time = np.arange(0.0, SECONDS, 1.0 / RATE_Hz)
    moving = (time % 2.0) < 1.0
    way = np.cumsum(np.where(moving, np.sin(np.pi * (time % 2.0)) * np.where(time % 4.0 < 2.0, 1.0, -1.0), 0.0))
    theta = way / RATE_Hz - 0.35
    direction = np.where(time % 4.0 < 2.0, 1.0, -1.0)
    noise = np.random.default_rng(seed)
    wanders = np.repeat(noise.uniform(-0.9, 0.9, int(SECONDS)), RATE_Hz)
    taken = np.where(moving, direction, wanders) * 0.05
    tau_w = load_N_m * (1 + 0.15 * theta)
    columns = {
        "time_s": time,
        "theta_m_rad": theta,
        "current_A": tau_w + taken + 2e-4 * noise.standard_normal(len(time)),
        "theta_j_rad": 0.9 * theta,
        "tau_w_N_m": tau_w,
    }
    return Run(name, columns)


def test_a_gear_that_sticks_is_found_and_hides_no_load_any_more() -> None:
    runs = [stopping_run(f"{n}{level}", 0.02 * (level + 1), 10 * n + level) for n in range(2) for level in range(4)]
    levels = {run.name: int(run.name[1]) for run in runs}
    train = [run for run in runs if run.name[1] in "02"]
    renamed = [Run(run.name, {**run.columns, "tau_m_N_m": run.columns["current_A"]}) for run in runs]
    sticks = fit_transmission(train, levels, "current_A")
    slides = fit_transmission([run for run in renamed if run.name[1] in "02"], levels, "tau_m_N_m")
    assert sticks.structure.standstill > 0.0
    assert slides.structure.standstill == 0.0  # the same columns, taken for a torque behind the gear
    errors = []
    for fit in (sticks, slides):
        held = [run for run in renamed if run.name[1] == "1"]
        left = [transmission.run(fit.constants, *inputs(run, fit.source))[0] - run.columns["tau_w_N_m"] for run in held]
        errors.append(rms(np.concatenate([e[RATE_Hz:-RATE_Hz] for e in left])))
    assert errors[0] < 0.5 * errors[1]


def test_a_term_has_a_name_each() -> None:
    names = transmission.term_names()
    assert len(names) == len(set(names)) == TERMS
    assert names[transmission.TERM_DRIVE] == "u x^0"
    assert names[transmission.TERM_SPEED] == "speed"


def test_what_it_needs_and_lacks_is_named(runs: list[Run]) -> None:
    with pytest.raises(UserError, match="current_A was not measured"):
        fit_transmission(runs[:2], {run.name: 0 for run in runs}, "current_A")
    with pytest.raises(UserError, match="no run"):
        fit_transmission([], {}, "tau_m_N_m")
    with pytest.raises(ValueError, match="must be positive"):
        transmission.constants(Structure(60.0, PRESLIDING_RAD[0], (1.0, 1.0)))
    with pytest.raises(ValueError, match="standstill must be 0 or positive"):
        transmission.constants(Structure(60.0, PRESLIDING_RAD[0], (-1.0, 1.0), -0.1))


def test_splits_come_from_loads_and_frequencies_and_not_from_names() -> None:
    loads = (12e-3, 24e-3, 36e-3, 49e-3)
    runs = [
        RunInfo(f"run {load:.3f} {frequency}", frequency + 0.003, load * (1 + 0.02 * frequency), 100, ())
        for frequency in (0.1, 0.3, 0.2)
        for load in reversed(loads)
    ]
    found = {split.name: split for split in splits(runs)}
    assert set(found) == {ODD_LOADS, EXTREMES}
    for split in found.values():
        assert set(split.train) | set(split.held_out) == {run.name for run in runs}
        assert not set(split.train) & set(split.held_out)
    assert {name[4:9] for name in found[ODD_LOADS].held_out} == {"0.024", "0.049"}
    assert all(name.startswith("run 0.049") or name.endswith("0.3") for name in found[EXTREMES].held_out)
    assert len(found[EXTREMES].held_out) == 3 + 3
    assert splits(runs[:1]) == ()
    assert splits([]) == ()
