"""Effects of sensors, amplifier and timing, in logs of the closed loop and in the forceps that a drive samples."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from firmware_protocol.scales import ANGLE_LSB_RAD, CURRENT_LSB_A
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECTS
from tests.hidden_effects.generator import RIG, true_rig
from virtual_bus.direct import DirectWorld
from virtual_bus.drive import SimulatedDrive, forceps_of, loop_of
from virtual_bus.effects.forceps import ForcepsWithEffects
from virtual_bus.effects.numbers import effect_numbers
from virtual_bus.logs import TRUTH_COLUMNS, Log, simulated_log
from virtual_bus.plant.forceps import SimulatedForceps
from virtual_bus.plant.load import LoadProfile, piecewise_linear
from virtual_bus.plant.plant import truth_parameters

PERIOD_S = 1.0e-3
PERIOD_NS = 1_000_000
ROWS = 800
PAD = 120
LOAD = piecewise_linear([-1.0, 0.2, 0.4, 0.4], [0.0, 1.5e-3, -1.5e-3, 1.0e-3])
TYPICAL = {entry.id: {p.name: p.typical for p in entry.parameters} for entry in EFFECTS}


def reference(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    time_s = rows * PERIOD_S
    return np.asarray(0.3 * np.sin(2.0 * math.pi * 2.0 * time_s) + 0.1 * np.sin(2.0 * math.pi * 9.0 * time_s))


def log_of(
    effects: dict[str, dict[str, float]], *, step_s: float = 5.0e-5, load: LoadProfile = LOAD, quantum: float = 0.0
) -> Log:
    rig = true_rig(RIG, effects, {})
    samples = np.arange(-PAD, ROWS + PAD, dtype=np.float64)
    return simulated_log(
        truth_parameters(rig.plant(), step_s),
        effect_numbers(rig.effects),
        loop_of(rig),
        quantum,
        reference(samples),
        load,
        slice(PAD, PAD + ROWS),
        0.0,
        step_s,
    )


def truth(log: Log, name: str) -> NDArray[np.float64]:
    return np.asarray(log.truth[:, TRUTH_COLUMNS.index(name)])


def test_log_without_effects_says_what_is() -> None:
    log = log_of({})
    for channel, name in (("theta_m_rad", "theta_m"), ("current_A", "current_A"), ("theta_j_rad", "theta_j"),
                          ("tau_w_N_m", "tau_w_N_m")):  # fmt: skip
        assert getattr(log, channel).tobytes() == truth(log, name).tobytes()
    assert log.tau_w_N_m.tolist() == [LOAD.torque_at(k * PERIOD_NS) for k in range(ROWS)]


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_current_of_a_row_is_the_one_commanded_a_sample_and_the_delay_earlier(delay: int) -> None:
    """The law, run over the rows in plain numpy, gives the current of the next row."""
    log, law = log_of({"actuation_delay": {"delay_s": delay * PERIOD_S}}), RIG.require_drive()
    error = reference(np.arange(ROWS, dtype=np.float64)) - log.theta_m_rad
    gain = 1.0 - math.exp(-2.0 * math.pi * law.derivative_cutoff_Hz * PERIOD_S)
    speed = np.zeros(ROWS)
    for k in range(1, ROWS):
        speed[k] = speed[k - 1] + gain * ((log.theta_m_rad[k] - log.theta_m_rad[k - 1]) / PERIOD_S - speed[k - 1])
    wanted = law.kp_A_per_rad * error + law.ki_A_per_rad_s * np.cumsum(error) * PERIOD_S - law.kd_A_s_per_rad * speed
    rest = (
        log.current_A[51 + delay :] - wanted[50 : ROWS - 1 - delay]
    )  # the integral's start is unknown, the filter's start forgotten
    assert np.ptp(rest) < 1.0e-12


def test_gain_and_offset_are_in_the_record_alone() -> None:
    plain, log = log_of({}), log_of({"current_gain": {"relative_error": 0.1}, "current_offset": {"offset_A": 0.02}})
    assert log.truth.tobytes() == plain.truth.tobytes()
    assert log.current_A == pytest.approx(1.1 * plain.current_A + 0.02, abs=1.0e-15)


def test_amplifier_cuts_the_middle_and_the_ends() -> None:
    commands = log_of({})
    width, limit = 0.01, 0.12
    log = log_of({"amplifier_deadband": {"half_width_A": width}, "current_saturation": {"limit_A": limit}})
    assert np.abs(commands.current_A).max() > limit + 0.02
    assert np.abs(log.current_A).max() == limit
    assert (log.current_A == 0.0).sum() > 3 * (commands.current_A == 0.0).sum()
    # The deadband alone, on a current that is the same as without it: what's left of the law's current.
    law = RIG.require_drive()
    still = log_of({"amplifier_deadband": {"half_width_A": 1.0}})
    assert np.abs(still.current_A).max() == 0.0 < law.kp_A_per_rad


@pytest.mark.parametrize("delay_s", [1.0e-3, 3.70123e-4, 4.25e-3])
def test_delayed_current_arrives_to_the_nanosecond(delay_s: float) -> None:
    """Seen through a late channel of the current: just after the arrival the new command, just before the old."""
    law = {"actuation_delay": {"delay_s": delay_s}}
    into = delay_s % PERIOD_S
    just_after = log_of(law | {"channel_skew": {"current_s": -into - 2.0e-9}}).current_A
    just_before = log_of(law | {"channel_skew": {"current_s": -into}}).current_A
    changes = np.abs(np.diff(just_before)) > 1.0e-6
    assert changes.mean() > 0.9
    assert just_after[:-1] == pytest.approx(just_before[1:], abs=0.0)
    assert (np.abs(just_after - just_before)[:-1][changes] > 0.0).all()


def test_lag_is_exponential_towards_the_command() -> None:
    lag = 4.0e-4
    log = log_of({"electrical_lag": {"time_constant_s": lag}})
    current, target = truth(log, "current_A"), truth(log, "target_A")
    kept = math.exp(-PERIOD_S / lag)
    assert current[1:] == pytest.approx(target[1:] + (current[:-1] - target[1:]) * kept, abs=1.0e-12)
    assert log_of({"electrical_lag": {"time_constant_s": lag}}, step_s=2.5e-5).current_A == pytest.approx(
        log.current_A, abs=1.0e-4
    )


def test_encoder_errors_are_in_the_loop_and_in_the_record() -> None:
    effects = {"encoder_scale": {"relative_error": 0.05},
               "encoder_eccentricity": {"sine_rad": 0.01, "cosine_rad": -0.02}}  # fmt: skip
    log = log_of(effects)
    angle = truth(log, "theta_m")
    assert log.theta_m_rad == pytest.approx(1.05 * angle + 0.01 * np.sin(angle) - 0.02 * np.cos(angle), abs=1.0e-15)
    wanted = reference(np.arange(ROWS, dtype=np.float64))
    plain = log_of({})
    assert np.abs(log.theta_m_rad - wanted).mean() < 1.3 * np.abs(plain.theta_m_rad - wanted).mean()  # follows θ_enc
    quantum = 2.0 * math.pi / 4096.0
    counts = log_of(effects, quantum=quantum).theta_m_rad / quantum
    assert counts == pytest.approx(np.rint(counts), abs=1.0e-9)


@pytest.mark.parametrize("skew_s", [2.0e-3, 3.3e-4, 1.47e-3, -6.1e-4, -2.0e-3])
def test_skewed_channel_is_what_it_was_then_and_nothing_else_changes(skew_s: float) -> None:
    """Between the rows against the cubic through their angles and speeds."""
    plain = log_of({})
    names = {"theta_m_s": "theta_m_rad", "theta_j_s": "theta_j_rad", "tau_w_s": "tau_w_N_m", "current_s": "current_A"}
    log = log_of({"channel_skew": dict.fromkeys(names, skew_s)})
    assert log.truth.tobytes() == plain.truth.tobytes()
    rows = np.arange(ROWS)
    inside = slice(10, ROWS - 10)
    for channel, speed in (("theta_m_rad", "omega_m"), ("theta_j_rad", "omega_j")):
        cubic = CubicHermiteSpline(rows * PERIOD_S, getattr(plain, channel), truth(plain, speed))
        off = np.abs(getattr(log, channel) - cubic(rows * PERIOD_S - skew_s))[inside]
        assert off.mean() < 1.0e-5
        assert np.abs(getattr(log, channel) - getattr(plain, channel))[inside].mean() > 100.0 * off.mean()
        if skew_s % PERIOD_S == 0.0:
            whole = round(skew_s / PERIOD_S)
            assert (
                getattr(log, channel)[inside].tobytes()
                == getattr(plain, channel)[10 - whole : ROWS - 10 - whole].tobytes()
            )
    assert log.tau_w_N_m.tolist() == [LOAD.torque_at(k * PERIOD_NS - round(skew_s * 1e9)) for k in range(ROWS)]
    held = np.ceil(rows - skew_s / PERIOD_S - 1.0e-9).astype(np.int64)  # the current is held up to the row it ends at
    assert log.current_A[inside] == pytest.approx(plain.current_A[held[inside]], abs=0.0)


def test_drifts_begin_with_the_first_row() -> None:
    effects = {"torque_constant_drift": {"relative_change": -0.5, "time_constant_s": 0.1}}
    log, plain = log_of(effects), log_of({})
    assert log.truth[:1].tobytes() == plain.truth[:1].tobytes()
    late = slice(ROWS - 250, ROWS)
    ratio = np.abs(log.current_A[late]).mean() / np.abs(plain.current_A[late]).mean()
    assert ratio == pytest.approx(2.0, rel=0.15)  # half the constant takes twice the current


def forceps(effects: dict[str, dict[str, float]], rig: Rig = RIG) -> SimulatedForceps | ForcepsWithEffects:
    quiet = true_rig(rig, effects, {}).with_changes({"noise": {}})
    result = forceps_of(quiet, LOAD, seed=3, jaw_start_rad=0.0)
    result.start_load(0)
    return result


def sampled(world: SimulatedForceps | ForcepsWithEffects, rows: int = 300) -> NDArray[np.int64]:
    wanted = np.rint(reference(np.arange(rows, dtype=np.float64)) / ANGLE_LSB_RAD).astype(np.int64)
    return np.array(
        [world.sample(k * PERIOD_NS, (k + 1) * PERIOD_NS, int(wanted[k])) for k in range(rows)], dtype=np.int64
    )


def test_neutral_effects_make_the_forceps_without_any() -> None:
    neutral = {"wire_slack": {"half_width_m": 0.0}, "cogging": {"harmonic": 7.0}, "channel_skew": {}}
    assert isinstance(forceps(neutral), SimulatedForceps)
    assert isinstance(forceps({"wire_slack": {"half_width_m": 1e-9}}), ForcepsWithEffects)


def test_forceps_with_next_to_no_effect_moves_as_the_one_without() -> None:
    """Two integrations of the same plant: they differ by how friction is smoothed, far below a count."""
    with_effect, without = sampled(forceps({"wire_slack": {"half_width_m": 1e-15}})), sampled(forceps({}))
    count = 2.0 * math.pi / 16384 / ANGLE_LSB_RAD
    assert np.abs(with_effect - without)[:, 0].max() <= 3.0 * count
    assert np.abs(with_effect - without)[:, 1].mean() * CURRENT_LSB_A < 2.0e-3


def test_read_then_run_is_sample() -> None:
    effects = {name: TYPICAL[name] for name in ("wire_slack", "actuation_delay", "channel_skew", "cogging")}
    whole, parts = forceps(effects), forceps(effects)
    rows = sampled(whole, 100)
    wanted = np.rint(reference(np.arange(100, dtype=np.float64)) / ANGLE_LSB_RAD).astype(np.int64)
    for k in range(100):
        reading = parts.read(k * PERIOD_NS)
        assert tuple(reading) == tuple(rows[k])
        parts.run(k * PERIOD_NS, (k + 1) * PERIOD_NS, reading.theta_m, int(wanted[k]))


def test_late_channels_of_the_forceps_are_late_and_early_ones_make_the_others_late() -> None:
    plain = sampled(forceps({"cogging": TYPICAL["cogging"]}))
    late = sampled(
        forceps({"cogging": TYPICAL["cogging"], "channel_skew": {"theta_m_s": 2.0e-3, "theta_j_s": -1.0e-3}})
    )
    shifts = (3, 1, 0, 1)
    for channel, shift in enumerate(shifts):
        assert late[shift:, channel].tolist() == plain[: len(plain) - shift, channel].tolist()
        assert (late[1:, channel] != plain[1:, channel]).any() == (shift > 0)


def test_direct_world_shows_what_sensors_say() -> None:
    ideal = RIG.with_changes({"encoder.counts_per_rev": "ideal", "noise": {}})
    effects = {"encoder_scale": {"relative_error": 0.1}, "current_offset": {"offset_A": 0.25}}
    sample = DirectWorld(true_rig(ideal, effects, {}), 0, seed=1).sample()
    plain = DirectWorld(ideal, 0, seed=1).sample()
    assert sample.theta_m_rad == pytest.approx(1.1 * plain.theta_m_rad, rel=1.0e-12)
    assert sample.current_A == 0.25


def frames_of(rig: Rig, end_ns: int) -> list[bytes]:
    drive = SimulatedDrive(rig, LOAD)
    sent: list[bytes] = []
    while drive.next_wake_ns() < end_ns:
        drive.wake(drive.next_wake_ns())
        sent += [frame.data for frame in drive.take_outbox()]
    assert drive.counters["outbox_full"] == 0
    return sent


def test_drive_on_the_bus_runs_a_rig_with_every_effect() -> None:
    with_effects, without = (frames_of(true_rig(RIG, effects, {}), 50_000_000) for effects in (TYPICAL, {}))
    assert len(with_effects) == len(without) > 100
    assert sum(one != other for one, other in zip(with_effects, without, strict=True)) > 30
    assert with_effects == frames_of(true_rig(RIG, TYPICAL, {}), 50_000_000)
