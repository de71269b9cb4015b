"""`hil-forceps check`: whether drive, bus, loop and forceps of a rig file are consistent; nothing is connected."""

import json
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hil_forceps.drives.compatibility.lint import findings
from hil_forceps.drives.registry import machine_for
from hil_forceps.rig import load_rig

EXIT_PROBLEMS = 1


def check(rig: Path, *, as_json: Annotated[bool, Parameter(name="--json", negative="")] = False) -> int:
    """Check whether the settings of a rig file are consistent: watchdog, rates, quanta, currents, bus load.

    Opens no connection. Exit code 1 if there is a problem, 0 if there are only notes or no findings.

    Parameters
    ----------
    rig
        Rig file, as for `run`.
    as_json
        Print the findings as JSON.
    """
    loaded = load_rig(rig)
    machine_for(loaded)  # UserError for values that the profile can't use
    found = findings(loaded)
    if as_json:
        sys.stdout.write(json.dumps({"rig": str(rig), "findings": [each._asdict() for each in found]}, indent=2) + "\n")
        return EXIT_PROBLEMS if any(each.level == "problem" for each in found) else 0
    for finding in found:
        sys.stdout.write(f"{rig}: {finding.level}: {finding.key}: {finding.text}\n")
    problems = sum(finding.level == "problem" for finding in found)
    notes = len(found) - problems
    sys.stdout.write(f"{rig}: {problems} problem{'s' * (problems != 1)}, {notes} note{'s' * (notes != 1)}\n")
    return EXIT_PROBLEMS if problems else 0
