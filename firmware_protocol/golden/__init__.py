"""Golden vectors: what any implementation of the protocol must reproduce, as one language-neutral JSON file.

`python -m firmware_protocol.golden > firmware_protocol/golden/vectors.json` writes it anew; a test compares.
"""

import json

from firmware_protocol.golden.scenarios import scenarios
from firmware_protocol.golden.vectors import messages, rejects, serial_streams
from firmware_protocol.messages import PROTOCOL_MAJOR, PROTOCOL_MINOR


def document() -> str:
    """Return the whole file: one vector or one step of a scenario a line, so that a change reads well."""
    sections = {
        "messages": messages(),
        "rejects": rejects(),
        "serial_streams": serial_streams(),
        "drive_scenarios": scenarios(),
    }
    head = f'{{\n"protocol": [{PROTOCOL_MAJOR}, {PROTOCOL_MINOR}]'
    return ",\n".join([head, *(f'"{name}": {_lines(rows)}' for name, rows in sections.items())]) + "\n}\n"


def _lines(rows: list[dict[str, object]]) -> str:
    return "[\n" + ",\n".join(_row(row) for row in rows) + "\n]"


def _row(row: dict[str, object]) -> str:
    steps = row.get("steps")
    if not isinstance(steps, list):
        return json.dumps(row)
    head = json.dumps({key: value for key, value in row.items() if key != "steps"})
    return head[:-1] + ', "steps": [\n  ' + ",\n  ".join(json.dumps(step) for step in steps) + "]}"
