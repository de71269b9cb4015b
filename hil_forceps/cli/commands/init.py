"""`hil-forceps init`: a first rig file from motor, drive, encoder and pulleys, with a comment for each key."""

import json
import os
import shlex
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from hil_forceps.cli.arguments.first_rig import Besides, Hardware, answers_of
from hil_forceps.cli.terminal.notes import note
from hil_forceps.rig import presets
from hil_forceps.rig.errors import UserError
from hil_forceps.rig.first_rig.answers import Answers
from hil_forceps.rig.first_rig.commented import text_of
from hil_forceps.rig.first_rig.plan import sections, without_value
from hil_forceps.rig.loading import parse_rig

SCHEMA = Path(presets.__file__).parents[1] / "schemas" / "rig.schema.json"
OUTPUT = Group("Output", sort_key=3)
NOT_GIVEN_HARDWARE, NOTHING_BESIDES = Hardware(), Besides()


def init(
    rig: Path | None = None,
    *,
    hardware: Hardware = NOT_GIVEN_HARDWARE,
    besides: Besides = NOTHING_BESIDES,
    overwrite: Annotated[bool, Parameter(group=OUTPUT, negative="")] = False,
    list_: Annotated[bool, Parameter(name="--list", group=OUTPUT, negative="")] = False,
    json_: Annotated[bool, Parameter(name="--json", group=OUTPUT, negative="")] = False,
) -> int:
    """Write a first rig file with a comment for each key: its meaning, its unit, and the source of its value.

    On a terminal the command asks for missing values. Presets contain the data sheet values of common motors and
    drives, each with its source (--list). Parameters that no data sheet has (wire, jaw, friction) get bounds, which
    `diagnose` narrows down.

    Parameters
    ----------
    rig
        File to write.
    overwrite
        Overwrite an existing file.
    list_
        List the presets with their sources, and write nothing.
    json_
        Print the result as JSON: the file and its keys without a value, or the list of presets.
    """
    if list_:
        _list(as_json=json_)
        return 0
    if rig is None:
        raise UserError("RIG: missing; name the file to write, such as forceps.yaml, or list the presets with --list")
    if rig.exists() and not overwrite:
        raise UserError(f"{rig}: already exists; name another file, or use --overwrite")
    left = _write(answers_of(hardware, besides), rig)
    if json_:
        sys.stdout.write(json.dumps({"rig": str(rig), "without_value": left}) + "\n")
        return 0
    sys.stdout.write(f"{rig}: written; next: hil-forceps check {shlex.quote(str(rig))}\n")
    if left:
        note(
            f"{rig}: {len(left)} keys have bounds but no value, and `run` and `bench` need a value: "
            f"{', '.join(left)}; see docs/diagnosis.md"
        )
    return 0


def _write(answers: Answers, rig: Path) -> list[str]:
    """Write the file and return the keys without a value; UserError if the answers give no valid rig."""
    found = sections(answers)
    text = text_of(answers, found, _schema_from(rig), _command())
    parse_rig(text, str(rig))
    try:
        rig.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"{rig}: can't be written: {error.strerror}; name another file") from error
    return without_value(found)


def _schema_from(rig: Path) -> str:
    """Return the schema's path relative to the rig file, so that an editor finds it."""
    try:
        return Path(os.path.relpath(SCHEMA, rig.resolve().parent)).as_posix()
    except ValueError:  # on another drive of Windows
        return SCHEMA.as_uri()


def _command() -> str:
    words = sys.argv[1:] if "init" in sys.argv[1:2] else ["init"]
    return shlex.join(["hil-forceps", *words])


def _list(*, as_json: bool) -> None:
    motors, drives = presets.motors(), presets.drives()
    if as_json:
        listed = {"motors": motors, "drives": drives}
        plain = {kind: {name: each.model_dump() for name, each in found.items()} for kind, found in listed.items()}
        sys.stdout.write(json.dumps(plain, indent=2, ensure_ascii=False) + "\n")
        return
    for name, motor in motors.items():
        sys.stdout.write(f"--motor {name}\n    {motor.title}\n    {motor.source}\n")
    for name, drive in drives.items():
        sys.stdout.write(f"--drive {name}\n    {drive.title}\n    {drive.page}\n")
