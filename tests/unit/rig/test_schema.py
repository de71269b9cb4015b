"""The rig as an object: what a file becomes, variants made in code, writing it out again."""

import math
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

from firmware_protocol.frames import MAX_NODE
from firmware_protocol.scales import ANGLE_LSB_PER_REV, CURRENT_LSB_A
from hil_forceps.rig import Parameter, Rig, UserError, dump_rig, load_rig, parse_rig
from hil_forceps.rig.plant import PlantParameters
from hil_forceps.rig.sections import MAX_ENCODER_COUNTS, MAX_NODE_ID
from hil_forceps.rig.validation.consistency import MAX_WIRE_CURRENT_A

ROOT = Path(__file__).parents[3]
CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))

CONTRACT = """\
forceps:
  motor_pulley_radius_m: 2.0e-3
  jaw_pulley_radius_m: 1.4e-3
  motor_inertia_kg_m2: 3.18e-8
  jaw_inertia_kg_m2: 6.85e-8
  motor_viscous_N_m_s_per_rad: 1.16e-4
  motor_coulomb_N_m: 4.62e-7
  jaw_coulomb_N_m: 4.62e-9
  wire_stiffness_N_per_m: 2.6e4
motor:
  torque_constant_N_m_per_A: 1.35e-2
encoder:
  counts_per_rev: 16384
drive:                                  # the position loop that the drive closes
  sample_time_s: 1.0e-3
  kp_A_per_rad: 1.2
  ki_A_per_rad_s: 15.0
  kd_A_s_per_rad: 0.006
  derivative_cutoff_Hz: 150.0
  current_limit_A: 1.0
noise:
  current_A: 1.0e-3
  theta_j_rad: 2.0e-4
  tau_w_N_m: 1.0e-5
effects: {}
"""
PLANT = PlantParameters(2.0e-3, 1.4e-3, 3.18e-8, 6.85e-8, 1.16e-4, 4.62e-7, 4.62e-9, 2.6e4, 1.35e-2)


@pytest.fixture
def rig() -> Rig:
    return parse_rig(CONTRACT)


def test_the_contract_file_loads_and_can_run_on_a_bench(rig: Rig) -> None:
    assert rig.plant() == PLANT
    assert rig.encoder.counts_per_rev == 16384
    assert rig.require_drive().ki_A_per_rad_s == 15.0
    assert rig.noise.theta_j_rad == 2.0e-4
    assert rig.effects == {}
    assert rig.estimators.rfob_cutoff_Hz == 70.0
    rig.require_bench()


def test_defaults_of_an_absent_bench_section(rig: Rig) -> None:
    bench = rig.bench
    assert (bench.host_period_s, bench.host_phase_s, bench.plant_step_s) == (1e-3, 6e-4, 5e-5)
    assert (bench.transport, bench.bitrate_bit_per_s, bench.data_bitrate_bit_per_s) == ("classic", 1_000_000, 5_000_000)
    assert (bench.latency_s, bench.latency_jitter_s, bench.drive_clock_ppm) == (0.0, 0.0, 0.0)
    assert (bench.feedback_divider, bench.node_id) == (1, 1)
    assert bench.algorithms == ("previous", "improved_as_published", "improved", "kalman")
    assert bench.simulations == (1, 2)
    assert bench.direct_sample_times_s == (1e-4,)
    assert rig.limits.max_sample_age_s == 3e-3


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_config_loads_and_comes_back(path: Path) -> None:
    rig = load_rig(path)
    assert parse_rig(dump_rig(rig)) == rig


@pytest.mark.parametrize(("name", "counts"), [("paper", None), ("realistic", 16384)])
def test_bench_configs_run_as_they_are(name: str, counts: int | None) -> None:
    rig = load_rig(ROOT / "configs" / f"{name}.yaml")
    rig.require_bench()
    assert rig.plant() == PLANT
    assert rig.encoder.counts_per_rev == counts


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("2.6e4", (2.6e4, 2.6e3, None, None)),
        ("26000", (2.6e4, 2.6e3, None, None)),
        ("{value: 2.6e4}", (2.6e4, 2.6e3, None, None)),
        ("{value: 2.6e4, sd: 1.0e3}", (2.6e4, 1.0e3, None, None)),
        ("{min: 1.0e3, max: 1.0e6}", (None, None, 1.0e3, 1.0e6)),
        ("{value: 2.6e4, min: 1.0e3, max: 1.0e6}", (2.6e4, None, 1.0e3, 1.0e6)),
        ("{value: 2.6e4, sd: 5, min: 1.0e3, max: 1.0e6}", (2.6e4, 5.0, 1.0e3, 1.0e6)),
        ("unknown", (None, None, None, None)),
    ],
)
def test_what_may_be_known_of_a_parameter(given: str, expected: tuple[float | None, ...]) -> None:
    rig = parse_rig(CONTRACT.replace("2.6e4", given))
    k = rig.forceps.wire_stiffness_N_per_m
    assert (k.value, k.sd, k.minimum, k.maximum) == expected
    assert parse_rig(dump_rig(rig)) == rig


@pytest.mark.parametrize("given", ["{min: 1e3, max: 1e3}", "{value: 999, min: 1e3, max: 1e6}", "{min: 1e3}", "{sd: 1}"])
def test_what_may_not(given: str) -> None:
    with pytest.raises(UserError, match=r"<rig>:9: forceps.wire_stiffness_N_per_m"):
        parse_rig(CONTRACT.replace("2.6e4", given))


def test_plant_names_every_value_that_is_not_known() -> None:
    text = CONTRACT.replace("2.6e4", "{min: 1.0e3, max: 1.0e6}").replace("1.35e-2", "unknown")
    with pytest.raises(UserError) as caught:
        parse_rig(text).plant()
    assert caught.value.problems == (
        "forceps.wire_stiffness_N_per_m: has no value, but one is needed here; give a value",
        "motor.torque_constant_N_m_per_A: has no value, but one is needed here; give a value",
    )


def test_a_rig_with_effects_loads_and_a_bench_takes_it() -> None:
    given = "effects:\n  wire_slack: {half_width_m: 1e-5}\n  wire_creep: {time_constant_s: 2.0}"
    rig = parse_rig(CONTRACT.replace("effects: {}", given))
    assert rig.effects == {"wire_slack": {"half_width_m": 1e-5}, "wire_creep": {"time_constant_s": 2.0}}
    rig.require_bench()
    assert parse_rig(dump_rig(rig)) == rig


def test_a_rig_without_a_drive_loads_and_has_no_loop() -> None:
    head, _, rest = CONTRACT.partition("drive:")
    rig = parse_rig(head + "noise:" + rest.partition("noise:")[2])
    assert rig.drive is None
    with pytest.raises(UserError, match="drive: the section is missing"):
        rig.require_drive()
    with pytest.raises(UserError, match="drive: the section is missing"):
        rig.require_bench()


def test_all_that_keeps_a_bench_from_running_is_told_at_once() -> None:
    text = CONTRACT.replace("2.6e4", "unknown")
    with pytest.raises(UserError) as caught:
        parse_rig(text.replace("sample_time_s: 1.0e-3", "sample_time_s: 1.3e-4")).require_bench()
    keys = [line.split(":")[0] for line in caught.value.problems]
    assert keys == [
        "forceps.wire_stiffness_N_per_m",
        "bench.plant_step_s",
        "bench.bitrate_bit_per_s",
    ]


def test_a_fast_drive_is_no_error_where_no_bench_is_meant() -> None:
    rig = parse_rig(CONTRACT.replace("sample_time_s: 1.0e-3", "sample_time_s: 1.25e-4"))
    assert rig.require_drive().sample_time_s == 1.25e-4


def test_changes_give_a_checked_variant_and_leave_the_rig_alone(rig: Rig) -> None:
    other = rig.with_changes(
        {
            "encoder.counts_per_rev": "ideal",
            "drive.sample_time_s": 1e-4,
            "bench": {"transport": "fd"},
            "bench.simulations": (2,),
            "forceps.wire_stiffness_N_per_m": {"min": 1e3, "max": 1e5},
            "noise.current_A": None,
        }
    )
    assert other.encoder.counts_per_rev is None
    assert other.require_drive().sample_time_s == 1e-4
    assert (other.bench.transport, other.bench.simulations) == ("fd", (2,))
    assert other.forceps.wire_stiffness_N_per_m == Parameter(min=1e3, max=1e5)
    assert (other.noise.current_A, other.noise.theta_j_rad) == (0.0, 2.0e-4)
    assert rig == parse_rig(CONTRACT)


def test_bad_changes_are_told_all_at_once_without_a_file(rig: Rig) -> None:
    changes = {"encoder.counts_per_rev": 1, "bench.transprot": "fd", "limits.position_min_rad": 9, "drive": 3}
    with pytest.raises(UserError) as caught:
        rig.with_changes(changes)
    assert set(caught.value.problems) == {
        "encoder.counts_per_rev: is 1, must be 4 to 16777216; correct it",
        "bench.transprot: unknown key; did you mean transport?",
        "limits.position_min_rad: is 9, not below position_max_rad 3; swap them",
        "drive: is 3, must be a mapping of keys; write `key: value` lines under it",
    }


def test_change_of_a_key_below_what_is_no_section(rig: Rig) -> None:
    with pytest.raises(UserError, match=r"drive: is 3"):
        rig.with_changes({"drive": 3, "drive.sample_time_s": 1e-3})


def test_rig_is_comparable_hashable_picklable_and_frozen(rig: Rig) -> None:
    same = parse_rig(CONTRACT)
    other = rig.with_changes({"encoder.counts_per_rev": 4096})
    assert rig == same
    assert hash(rig) == hash(same)
    assert rig != other
    assert len({rig, same, other}) == 2
    assert pickle.loads(pickle.dumps(rig)) == rig
    with pytest.raises(ValueError, match="frozen"):
        rig.encoder.counts_per_rev = 3


def test_an_explicit_default_is_the_same_rig(rig: Rig) -> None:
    assert parse_rig(CONTRACT + "bench:\n  host_period_s: 1e-3\n") == rig


def test_whole_numbers_may_be_written_as_floats_and_floats_as_whole_numbers() -> None:
    rig = parse_rig(CONTRACT.replace("16384", "4096.0").replace("current_limit_A: 1.0", "current_limit_A: 1"))
    assert rig.encoder.counts_per_rev == 4096
    assert isinstance(rig.require_drive().current_limit_A, float)


def test_bounds_shared_with_the_wire_are_the_wires() -> None:
    assert MAX_NODE_ID == MAX_NODE
    assert MAX_ENCODER_COUNTS == ANGLE_LSB_PER_REV
    assert math.isclose(MAX_WIRE_CURRENT_A, CURRENT_LSB_A * (2**15 - 1))


@pytest.mark.parametrize(
    ("statement", "unwanted"),
    [
        (
            "import hil_forceps.rig, hil_forceps.rig.errors, hil_forceps.rig.plant",
            "pydantic yaml numpy scipy numba can",
        ),
        (
            "from hil_forceps.rig import load_rig, Rig, parse_rig, dump_rig, Parameter",
            "numpy scipy numba can matplotlib",
        ),
    ],
)
def test_imports_stay_light(statement: str, unwanted: str) -> None:
    code = f"{statement}; import sys; print(*[name for name in {unwanted.split()!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == ""


def test_package_names_nothing_it_does_not_have() -> None:
    with pytest.raises(ImportError):
        from hil_forceps.rig import nonsense  # noqa: F401, PLC0415
