"""Model and world are put together from one file an effect: adding one takes two files and a command."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

MODEL_FILE = '''
"""Quadratic drag: friction of the motor that grows with the square of its speed."""

from hil_forceps.effects.entry import Effect, Parameter

EFFECT = Effect(
    "quadratic_drag",
    "motor",
    "friction of the motor that grows with the square of its speed (a fluid, a fan)",
    "F_m += q ω_m |ω_m|",
    (Parameter("drag_N_m_s2_per_rad2", "N_m_s2_per_rad2", 0.0, 1.0, 0.0, 1e-6, "q"),),
    "drag of a body in a fluid at high Reynolds numbers",
    "motion at several speeds",
    changes="torque",
)


def motor_drag_N_m(drag_N_m_s2_per_rad2: float, omega_m_rad_per_s: float) -> float:
    """Return the torque against a positive speed."""
    return drag_N_m_s2_per_rad2 * omega_m_rad_per_s * abs(omega_m_rad_per_s)
'''

WORLD_FILE = '''
"""A fluid that brakes the motor."""


def motor_drag_N_m(drag_N_m_s2_per_rad2: float, omega_m_rad_per_s: float) -> float:
    """Return the torque against a positive speed."""
    square = drag_N_m_s2_per_rad2 * omega_m_rad_per_s**2
    return square if omega_m_rad_per_s > 0.0 else -square
'''

HIDE = """
import sys
from pathlib import Path
from hil_forceps.data.readers.csv_table import write_csv
from hil_forceps.rig.loading import dump_rig
from tests.hidden_effects.generator import RIG, true_rig
from tests.unit.diagnosis.simulated_runs import runs_of

folder = Path(sys.argv[1])
true = true_rig(RIG, {"quadratic_drag": {"drag_N_m_s2_per_rad2": float(sys.argv[2])}}, {})
for run in runs_of(true, ("multisine", "trapezoid", "chirp", "teleoperation", "slow", "multisine"), 8100):
    write_csv(run, folder / f"{run.name}.csv")
(folder / "rig.yaml").write_text(dump_rig(RIG))
"""


def run(command: list[str], where: Path) -> subprocess.CompletedProcess[str]:
    environment = {"PYTHONPATH": str(where), "PATH": "/usr/bin:/bin", "OPENBLAS_NUM_THREADS": "1"}
    return subprocess.run(command, cwd=where, env=environment, capture_output=True, text=True, check=False)


def test_composition_is_up_to_date() -> None:
    done = run([sys.executable, "-m", "tools.generation.compose_effects", "--check"], ROOT)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(name="copy", scope="module")
def copy_with_one_more_effect(tmp_path_factory: pytest.TempPathFactory) -> Path:
    copy = tmp_path_factory.mktemp("copy")
    for folder in ("hil_forceps", "virtual_bus", "firmware_protocol", "tests", "tools", "configs"):
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", copy)
    (copy / "hil_forceps/effects/motor/quadratic_drag.py").write_text(MODEL_FILE.lstrip())
    (copy / "virtual_bus/effects/motor/quadratic_drag.py").write_text(WORLD_FILE.lstrip())
    return copy


def test_a_new_effect_is_put_in_by_a_command(copy: Path) -> None:
    assert run([sys.executable, "-m", "tools.generation.compose_effects", "--check"], copy).returncode == 1
    done = run([sys.executable, "-m", "tools.generation.compose_effects"], copy)
    assert done.returncode == 0, done.stderr
    for side in ("hil_forceps/model", "virtual_bus/effects"):
        text = (copy / side / "composition.py").read_text()
        assert "    quadratic_drag_drag_N_m_s2_per_rad2: float\n" in text
        assert "total += _quadratic_drag__motor_drag_N_m(" in text
    before = (ROOT / "hil_forceps/model/composition.py").read_text().splitlines()
    assert set(before) <= set((copy / "hil_forceps/model/composition.py").read_text().splitlines())


def test_an_argument_that_nobody_hands_over_is_told(copy: Path) -> None:
    file = copy / "hil_forceps/effects/motor/quadratic_drag.py"
    file.write_text(MODEL_FILE.lstrip().replace("omega_m_rad_per_s", "speed"))
    done = run([sys.executable, "-m", "tools.generation.compose_effects"], copy)
    file.write_text(MODEL_FILE.lstrip())
    assert done.returncode == 1
    assert "quadratic_drag.motor_drag_N_m: nothing is called speed there; there are D_m, I_j" in done.stderr


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_new_effect_is_hidden_and_found(copy: Path, tmp_path: Path) -> None:
    assert run([sys.executable, "-m", "tools.generation.compose_effects"], copy).returncode == 0
    hidden = 4e-7
    done = run([sys.executable, "-c", HIDE, str(tmp_path), str(hidden)], copy)
    assert done.returncode == 0, done.stderr
    runs = [str(path) for path in sorted(tmp_path.glob("*.csv"))]
    command = [sys.executable, "-m", "hil_forceps.cli.main", "diagnose", *runs, "--rig", str(tmp_path / "rig.yaml")]
    done = run([*command, "--out", str(tmp_path / "out")], copy)
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert result["verdict"] == "effects"
    (named,) = result["effects"]
    assert named["id"] == "quadratic_drag"
    assert named["parameters"]["drag_N_m_s2_per_rad2"]["value"] == pytest.approx(hidden, rel=0.05)
