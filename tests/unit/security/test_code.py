"""What is forbidden in the code, and that the tools that forbid it are on."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PACKAGES = ("hil_forceps", "virtual_bus", "firmware_protocol")
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "shelve", "marshal", "cloudpickle", "joblib", "tarfile"}
# Its `Parallel` sends work to processes that it starts, or to a cluster that the user names; its `load` is a pickle.
ONLY_IN = {"joblib": ("hil_forceps/api/batch/executor.py", "hil_forceps/api/batch/ordered.py")}


@pytest.mark.parametrize(
    ("line", "rule"),
    [
        ("eval(text)", "S307"),
        ("exec(text)", "S102"),
        ("import pickle\npickle.loads(text)", "S301"),
        ("import subprocess\nsubprocess.run(text, shell=True)", "S602"),
        ("import yaml\nyaml.load(text, yaml.Loader)", "S506"),
        ("import xml.etree.ElementTree as ET\nET.fromstring(text)", "S314"),
        ("import tarfile\ntarfile.open(text).extractall()", "S202"),
        ("import socket\nsocket.socket().bind(('0.0.0.0', 1))", "S104"),
    ],
)
@pytest.mark.parametrize("package", PACKAGES)
def test_ruff_forbids_it_here(package: str, line: str, rule: str) -> None:
    ruff = Path(sys.executable).with_name("ruff")
    options = ("--no-cache", "--output-format", "concise", "--stdin-filename", f"{package}/x.py")
    command = [str(ruff), "check", *options, "-"]
    done = subprocess.run(command, cwd=ROOT, input=f'"""X."""\n{line}\n', capture_output=True, text=True, check=False)
    assert f" {rule} " in done.stdout


def test_what_ruff_does_not_look_for_is_not_there() -> None:
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            where = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert isinstance(node.value, ast.Constant), where
                assert node.value.value is False, where
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            forbidden = {name.partition(".")[0] for name in names} & FORBIDDEN_MODULES
            assert not {name for name in forbidden if str(path.relative_to(ROOT)) not in ONLY_IN.get(name, ())}, where
            is_load = isinstance(node, ast.Attribute) and node.attr in {"load", "dump"}
            assert not (is_load and ast.unparse(node).startswith("joblib")), where
            assert not (isinstance(node, ast.Attribute) and node.attr == "extractall"), where


def test_each_exemption_has_its_reason_beside_it() -> None:
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        for line in path.read_text(encoding="utf-8").splitlines():
            _, mark, after = line.partition("# noqa: S")
            if mark and not after.startswith("IM"):  # SIM is no rule of security
                above = path.read_text(encoding="utf-8").split(line)[0].rstrip().rpartition("\n")[2]
                assert " - " in after or above.lstrip().startswith("#"), f"{path}: {line}"
