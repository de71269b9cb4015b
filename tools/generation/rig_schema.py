"""Write the JSON schemas of rig and bench files; with `--check` only compare.

Each goes to docs/schema/, to be linked to, and into the package, where written rigs find it.
"""

import json
import sys
from pathlib import Path
from typing import get_args

from hil_forceps.rig.json_schema import Kind, schema

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (ROOT / "docs" / "schema", ROOT / "hil_forceps" / "rig" / "schemas")


def main(arguments: list[str]) -> int:
    """Write the files, or with `--check` tell whether they are up to date."""
    stale = []
    for kind in get_args(Kind):
        text = json.dumps(schema(kind), indent=2, ensure_ascii=False) + "\n"
        for folder in FOLDERS:
            path = folder / f"{kind}.schema.json"
            if arguments != ["--check"]:
                path.write_text(text, encoding="utf-8")
            elif not path.is_file() or path.read_text(encoding="utf-8") != text:
                stale.append(path)
    for path in stale:
        print(f"{path} is out of date; run python tools/generation/rig_schema.py")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
