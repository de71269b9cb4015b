"""The JSON schemas for editors: they take every rig here, refuse what a schema can see, and are up to date."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator

from hil_forceps.rig import UserError, load_rig
from hil_forceps.rig.json_schema import schema
from hil_forceps.rig.yaml_loader import load_document

ROOT = Path(__file__).parents[3]
CONFIGS = sorted((ROOT / "configs").rglob("*.yaml"))
BROKEN = sorted((Path(__file__).parent / "broken_rigs").glob("*.yaml"))

# What stands between keys, or is decided by YAML before there is any data: no schema can see it.
UNSEEN = {
    "bus_too_slow",
    "cascade_without_velocity_gain",
    "duplicate_key",
    "duplicate_section",
    "fd_data_slower",
    "host_phase",
    "latency",
    "nan",  # JSON has none, so no schema speaks of it
    "plant_step",
    "plant_step_coarse",
}


def data_of(path: Path) -> object:
    """Return what a file's YAML says; nothing where it says nothing: an editor's YAML tells that by itself."""
    try:
        document = load_document(path.read_text(), path.name)
    except (UserError, UnicodeDecodeError):
        return None
    return None if document.problems else document.data


def found(kind: Any, path: Path) -> list[str]:
    return [error.message for error in Draft7Validator(schema(kind)).iter_errors(data_of(path))]


def test_schemas_are_schemas_and_up_to_date() -> None:
    for kind in ("rig", "bench"):
        Draft7Validator.check_schema(json.loads((ROOT / "docs" / "schema" / f"{kind}.schema.json").read_text()))
    command = [sys.executable, str(ROOT / "tools" / "generation" / "rig_schema.py"), "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_rig_here_is_taken(path: Path) -> None:
    assert found("rig", path) == []


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_a_bench_file_is_what_a_bench_takes(path: Path) -> None:
    rig = load_rig(path)
    try:
        rig.require_bench()
        is_bench = "bench" in rig.model_fields_set
    except UserError:
        is_bench = False
    assert (found("bench", path) == []) == is_bench


def test_most_broken_rigs_are_for_a_schema_to_see() -> None:
    assert sum(data_of(path) is not None for path in BROKEN) - len(UNSEEN) >= 30


@pytest.mark.parametrize("path", BROKEN, ids=lambda path: path.stem)
def test_a_broken_rig_is_refused_where_a_schema_can_see_it(path: Path) -> None:
    if path.stem not in UNSEEN:
        assert found("rig", path)


def test_what_no_schema_can_see_is_still_only_that() -> None:
    """Each of the exceptions is really none of a schema's: it passes, or has no data of its own."""
    for name in UNSEEN:
        path = Path(__file__).parent / "broken_rigs" / f"{name}.yaml"
        assert data_of(path) is None or found("rig", path) == [], name


@pytest.mark.parametrize(
    ("key", "value", "is_taken"),
    [
        ("jaw_inertia_kg_m2", "unknown", True),
        ("jaw_inertia_kg_m2", "unkown", False),
        ("jaw_inertia_kg_m2", {"min": 1e-9, "max": 1e-5}, True),
        ("jaw_inertia_kg_m2", {"min": 1e-9}, False),
        ("jaw_inertia_kg_m2", {}, False),
        ("jaw_inertia_kg_m2", {"sd": 1e-9}, False),
        ("jaw_inertia_kg_m2", {"value": 1e-8, "sd": 0.0}, True),
        ("motor_pulley_radius_m", 0.0, False),
        ("motor_pulley_radius_m", 2.0, False),
        ("motor_pulley_radius_mm", 2.0, False),
    ],
)
def test_what_may_be_said_of_a_parameter(key: str, value: object, is_taken: bool) -> None:
    data: Any = load_document((ROOT / "configs" / "paper.yaml").read_text(), "paper").data
    data["forceps"][key] = value
    assert Draft7Validator(schema("rig")).is_valid(data) == is_taken
