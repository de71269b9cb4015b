"""The wheel: it builds, installs into an environment of its own, and brings its entry points and its DBC."""

import os
import re
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

import hil_forceps

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("wheel")]  # it is built once, for all

ROOT = Path(__file__).resolve().parents[2]


def call(*arguments: object, folder: Path) -> str:
    """Run a command far from the source tree; return what it said."""
    hidden = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(
        [str(argument) for argument in arguments], cwd=folder, env=hidden, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("wheel")
    call(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", out, ROOT, folder=out)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an environment with the wheel; what the wheel depends on comes from the one that runs the tests."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    (packages,) = folder.glob("lib/python*/site-packages")
    python = folder / "bin" / "python"
    install = ("-m", "pip", "--python", python, "install", "--quiet", "--no-deps", "--no-index", "--no-compile", wheel)
    call(sys.executable, *install, folder=folder)
    # The borrowed packages stand behind the installed wheel; the editable install among them must not be found.
    lines = [path for path in (sysconfig.get_path("purelib"), sysconfig.get_path("platlib")) if path]
    (packages / "borrowed.pth").write_text("\n".join(dict.fromkeys(lines)) + "\n")
    return folder


def python(installed: Path, script: str) -> str:
    return call(installed / "bin" / "python", "-c", script, folder=installed).strip()


def test_wheel_holds_packages_and_data_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    tops = {name.split("/")[0] for name in names}
    assert {"hil_forceps", "firmware_protocol", "virtual_bus"} <= tops
    assert all(top.endswith(".dist-info") for top in tops - {"hil_forceps", "firmware_protocol", "virtual_bus"})
    for wanted in (
        "firmware_protocol/motor_driver.dbc",
        "firmware_protocol/golden/vectors.json",
        "firmware_protocol/py.typed",
        "hil_forceps/py.typed",
        "hil_forceps/configs/drives/odrive.yaml",
    ):
        assert wanted in names
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_it_is_the_wheel_that_is_imported(installed: Path) -> None:
    where = python(installed, "import hil_forceps, virtual_bus; print(hil_forceps.__file__, virtual_bus.__file__)")
    assert all(Path(path).is_relative_to(installed) for path in where.split())


def test_command_works(installed: Path) -> None:
    command = installed / "bin" / "hil-forceps"
    assert call(command, "--version", folder=installed).strip() == hil_forceps.__version__
    said = call(command, "info", folder=installed)
    assert f"hil-forceps {hil_forceps.__version__}, protocol" in said
    assert re.search(r"CAN interfaces from plugins: .*virtual_forceps", said)
    assert re.search(r"drives for .*: .*simulated", said)
    assert "--serial-pty" in call(command, "drive", "--help", folder=installed)
    decoded = call(command, "decode", "081#CDCC2C0000000003", folder=installed)
    assert "theta_m_rad=1.0995575" in decoded
    assert call(command, "docs", "docs/rig-file.md", folder=installed).startswith("# The rig file\n")
    written = call(command, "configs", "--out", "configs", folder=installed).split()
    assert "configs/realistic.yaml" in written
    assert "poles of the plant" in call(command, "info", "--rig", "configs/realistic.yaml", folder=installed)


@pytest.mark.long
def test_python_can_finds_the_interface(installed: Path) -> None:
    script = (
        "import can\n"
        f"bus = can.Bus(interface='virtual_forceps', channel='x', rig={str(ROOT / 'configs' / 'paper.yaml')!r})\n"
        "print(type(bus).__module__, bus.recv(0.1) is not None)\n"
        "bus.shutdown()\n"
    )
    assert python(installed, script) == "virtual_bus.interface True"


def test_dbc_is_read_from_the_installed_package(installed: Path) -> None:
    script = (
        "from importlib.resources import files\nimport cantools\n"
        "text = files('firmware_protocol').joinpath('motor_driver.dbc').read_text()\n"
        "print(len(cantools.database.load_string(text, 'dbc').messages))\n"
    )
    assert int(python(installed, script)) >= 10


def test_version_stands_in_one_place_and_the_papers_agree(wheel: Path) -> None:
    version = hil_forceps.__version__
    assert wheel.name.split("-")[1] == version
    assert 'dynamic = ["version"]' in (ROOT / "pyproject.toml").read_text()
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.findall(r"^version: (\S+)$", citation, re.MULTILINE) == [version]
    newest = re.search(r"^## \[(\d[^\]]*)\] - (\d{4}-\d{2}-\d{2})$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert newest is not None
    assert newest[1] == version
    assert re.findall(r'^date-released: "(.*)"$', citation, re.MULTILINE) == [newest[2]]
