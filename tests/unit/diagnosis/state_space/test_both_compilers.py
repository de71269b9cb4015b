"""The passes, compiled by the C compiler and by numba: the same bits."""

import importlib
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hil_forceps.data.even_rows import EvenRun
from hil_forceps.data.run import Run
from hil_forceps.diagnosis.identification import records_of
from hil_forceps.diagnosis.state_space.advance import physics_of
from hil_forceps.diagnosis.state_space.filter_pass import filter_run
from hil_forceps.diagnosis.state_space.forcing_pass import COLUMNS_AT_ONCE, forced
from hil_forceps.diagnosis.state_space.layout import Noise, Series
from hil_forceps.diagnosis.state_space.response_pass import response_run
from hil_forceps.kernels.run_kernel import RunKernel
from hil_forceps.model import parameters
from tests.hidden_effects.generator import COLOURED, RIG, WHITE, generate
from tests.hidden_effects.generator_scenarios import SCENARIOS

pytestmark = [pytest.mark.long, pytest.mark.xdist_group("both_compilers")]

ROWS = 2500
NOISE = Noise(np.array([2e-4, 1e-5, 1e-3]), np.array([0.0, 0.9, 0.5]), np.array([0.0, 2e-5, 0.0]))
EFFECTS = {
    "none": {},
    "slack": {"effects.wire_slack.half_width_m": 1e-6},
    "hysteresis": {"effects.wire_hysteresis.force_N": 0.05, "effects.wire_hysteresis.stretch_m": 1e-5},
    "presliding": {"effects.presliding_friction.level_N_m": 1e-5, "effects.presliding_friction.angle_rad": 1e-3},
    "film": {"effects.film_friction.level_N_m": 1e-5, "effects.film_friction.speed_rad_per_s": 1.0},
}
CASES = [
    ("sliding", {}, "multisine_mid", 1),
    ("holding", {"forceps.motor_coulomb_N_m": 2e-4, "forceps.jaw_coulomb_N_m": 1e-4}, "multisine_mid", 1),
    ("two samples", {"forceps.motor_coulomb_N_m": 2e-4}, "multisine_mid", 2),
    ("four samples", {"forceps.motor_coulomb_N_m": 2e-4}, "multisine_mid", 4),
]


@pytest.fixture(params=CASES, ids=[case[0] for case in CASES])
def series(request: pytest.FixtureRequest) -> Series:
    name, changes, scenario, samples = request.param
    rig = RIG.with_changes({"encoder.counts_per_rev": 16384, "drive.sample_time_s": 1e-3 / samples, **changes})
    run = generate(rig, replace(SCENARIOS[scenario], row_s=1e-3), 5, COLOURED if samples > 1 else WHITE, name)
    columns = {column: values[:ROWS] for column, values in run.columns.items()}
    lost = np.zeros(ROWS, dtype=np.bool_)
    lost[700:720] = True
    (record,), _ = records_of([EvenRun(Run(name, columns), lost)], [], rig, NOISE, map, parameters.vector(rig))
    found: Series = record.series
    return found


def passes_of(d: Series, effect: str) -> Iterator[np.ndarray[Any, Any]]:
    """Yield all that the three passes say of a run with a plant that has an effect."""
    theta = parameters.vector(RIG)
    base = physics_of(theta)
    for name, value in EFFECTS[effect].items():
        theta[list(parameters.NAMES).index(name)] = value
    plant = physics_of(theta)
    filtered = filter_run(plant, d)
    yield from (each for each in filtered if isinstance(each, np.ndarray))
    yield from filtered.between
    yield response_run(plant, base, d, filter_run(base, d), 1.0)
    rng = np.random.default_rng(1)
    rows = d.encoder_rad.size
    motor, jaw = (rng.normal(0.0, 1e-5, (rows, COLUMNS_AT_ONCE)) for _ in range(2))
    yield forced(base, d, filtered, motor, jaw, rng.normal(0.0, 1e-5, (rows, 4, COLUMNS_AT_ONCE)))


@pytest.mark.parametrize("effect", EFFECTS)
def test_passes_are_the_same_bits(series: Series, effect: str, monkeypatch: pytest.MonkeyPatch) -> None:
    by_c = list(passes_of(series, effect))
    for name in ("filter_pass", "response_pass", "forcing_pass"):
        module = importlib.import_module(f"hil_forceps.diagnosis.state_space.{name}")
        kernel = getattr(module, name)
        assert isinstance(kernel, RunKernel)
        assert kernel._entries  # the C compiler's was called
        monkeypatch.setattr(module, name, kernel.by_numba)
    by_numba = list(passes_of(series, effect))
    assert len(by_c) == len(by_numba) > 15
    for a, b in zip(by_c, by_numba, strict=True):
        np.testing.assert_array_equal(a, b)
