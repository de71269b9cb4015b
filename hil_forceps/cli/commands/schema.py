"""`hil-forceps schema`: the JSON schema of rig or bench files, for editors."""

import json
import sys

from hil_forceps.rig.json_schema import Kind
from hil_forceps.rig.json_schema import schema as schema_of


def schema(kind: Kind = "rig") -> int:
    """Print the JSON schema of rig or bench files: an editor completes keys by it, and shows meaning, unit and range.

    Parameters
    ----------
    kind
        rig, or bench: a rig file that has all that `bench` needs.
    """
    sys.stdout.write(json.dumps(schema_of(kind), indent=2, ensure_ascii=False) + "\n")
    return 0
