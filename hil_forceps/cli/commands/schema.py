"""`hil-forceps schema`: the JSON schema of rig files or bench files, for editors."""

import json
import sys

from hil_forceps.rig.json_schema import Kind
from hil_forceps.rig.json_schema import schema as schema_of


def schema(kind: Kind = "rig") -> int:
    """Print the JSON schema of rig files or bench files.

    With it an editor completes keys, and shows their meaning, unit and range.

    Parameters
    ----------
    kind
        rig, or bench: a rig file with the sections that `bench` needs.
    """
    sys.stdout.write(json.dumps(schema_of(kind), indent=2, ensure_ascii=False) + "\n")
    return 0
