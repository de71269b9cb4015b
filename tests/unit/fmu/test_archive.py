"""What is in an FMU's archive: a valid description, sources that stand alone, a library without Python."""

import shutil
import subprocess
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu

from hil_forceps.cli import main as cli
from hil_forceps.fmu.build import write_fmu
from hil_forceps.fmu.estimator_unit import estimator_unit
from hil_forceps.fmu.plant_unit import plant_unit
from hil_forceps.rig import Rig
from hil_forceps.rig.catalogue import EFFECTS
from hil_forceps.rig.errors import UserError
from tests.unit.fmu.conftest import ROOT, Made

pytestmark = pytest.mark.xdist_group("fmu")  # what they look at is made once, for all

_FMPY = find_spec("fmpy")
PAPER = str(ROOT / "configs" / "paper.yaml")


def test_fmpy_finds_no_fault(plant_fmu: Made, kalman_fmu_3: Made, rig: Rig, tmp_path: Path) -> None:
    others = [tmp_path / "plant3.fmu", tmp_path / "kalman2.fmu"]
    write_fmu(plant_unit(rig), 3, others[0], ())
    write_fmu(estimator_unit(rig, "kalman"), 2, others[1], ())
    for file in (plant_fmu.file, kalman_fmu_3.file, *others):
        assert validate_fmu(str(file)) == []


def test_the_description_has_every_effect_with_unit_and_start(plant_fmu: Made, rig: Rig) -> None:
    variables = {each.name: each for each in read_model_description(str(plant_fmu.file)).modelVariables}
    for effect in EFFECTS:
        for parameter in effect.parameters:
            told = variables[f"effects.{effect.id}.{parameter.name}"]
            assert bool(told.unit) == bool(parameter.unit)
            assert effect.summary in told.description
    radius = variables["forceps.motor_pulley_radius_m"]
    assert (float(radius.start), radius.unit) == (rig.plant().motor_pulley_radius_m, "m")
    assert radius.variability == "tunable"


def test_the_same_rig_gives_the_same_archive(rig: Rig, tmp_path: Path) -> None:
    for name in ("a.fmu", "b.fmu"):
        write_fmu(estimator_unit(rig, "previous"), 2, tmp_path / name, ())
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()


@pytest.mark.parametrize("made", ["plant_fmu", "kalman_fmu_3"])
def test_the_sources_are_strict_c99_without_undefined_behaviour_in_sight(
    made: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    with zipfile.ZipFile(request.getfixturevalue(made).file) as archive:
        archive.extractall(tmp_path)
    main = "fmi2.c" if made == "plant_fmu" else "fmi3.c"
    command = ["cc", "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-c", main, "-o", "unit.o"]
    ran = subprocess.run(command, cwd=tmp_path / "sources", capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
def test_the_library_asks_for_nothing_but_the_c_library(plant_fmu: Made) -> None:
    library = next((plant_fmu.folder / "binaries" / "linux64").iterdir())
    ran = subprocess.run(["nm", "-D", "--undefined-only", library], capture_output=True, text=True, check=True)
    asked = {line.split()[-1].partition("@")[0] for line in ran.stdout.splitlines()}
    assert "exp" in asked
    assert not [name for name in asked if name.startswith(("Py", "_Py", "NRT", "numba"))]


def test_the_command_says_what_is_in_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil_forceps.fmu.build.find_spec", lambda name: None if name == "ziglang" else _FMPY)
    with pytest.raises(SystemExit) as ended:
        cli.main(
            [
                "fmu",
                "--rig",
                PAPER,
                "--unit",
                "estimator",
                "--algorithm",
                "previous",
                "--out",
                str(tmp_path / "new" / "e.fmu"),
            ]
        )
    assert ended.value.code == 0
    assert "3 inputs, 3 outputs" in capsys.readouterr().out


def test_what_a_user_can_mend_is_told_in_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], rig: Rig) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["fmu", "--rig", PAPER, "--unit", "plant", "--out", str(tmp_path / "plant.zip")])
    assert ended.value.code == 2
    assert "must end in .fmu" in capsys.readouterr().err
    with pytest.raises(UserError, match="--fmi 3"):
        write_fmu(plant_unit(rig), 2, tmp_path / "p.fmu", ("aarch64-linux",))
    with pytest.raises(UserError, match=r"hil-forceps\[fmu\]"):
        write_fmu(plant_unit(rig), 2, tmp_path / "p.fmu", ("x86_64-windows",), zig=False)


def test_without_fmpy_the_remedy_is_told(rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil_forceps.fmu.build.find_spec", lambda _: None)
    with pytest.raises(UserError, match=r"hil-forceps\[fmu\]"):
        write_fmu(plant_unit(rig), 2, tmp_path / "p.fmu", ())
