"""Write docs/foxglove-layout.json from the panels of the live page; with `--check` only compare."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hil_forceps.bridge.live.topics import LANES, PANELS

TARGET = Path(__file__).resolve().parents[2] / "docs" / "foxglove-layout.json"


def main(arguments: list[str]) -> int:
    """Write the layout, or with `--check` tell whether it is up to date."""
    text = json.dumps(layout(), indent=2, ensure_ascii=False) + "\n"
    if arguments == ["--check"]:
        if not TARGET.exists() or TARGET.read_text(encoding="utf-8") != text:
            print(f"{TARGET} is out of date; run python -m tools.generation.foxglove_layout")
            return 1
        return 0
    TARGET.write_text(text, encoding="utf-8")
    return 0


def layout() -> dict[str, Any]:
    """Return the layout: a plot for each panel, and the states over time below them."""
    panels: dict[str, Any] = {}
    for place, panel in enumerate(PANELS):
        panels[f"Plot!panel{place}"] = {
            "title": f"{panel.title} [SI]",
            "paths": [
                {
                    "value": _path(trace.topic, trace.field),
                    "label": trace.label,
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                    "showLine": True,
                }
                for trace in panel.traces
            ],
            "showXAxisLabels": True,
            "showYAxisLabels": True,
            "showLegend": True,
            "legendDisplay": "top",
            "isSynced": True,
            "xAxisVal": "timestamp",
            "followingViewWidth": 10,
        }
    panels["StateTransitions!states"] = {
        "paths": [
            {"value": _path(lane.topic, lane.field), "label": lane.title, "timestampMethod": "receiveTime"}
            for lane in LANES
        ],
        "isSynced": True,
    }
    names = list(panels)
    plots = _split(names[:-1])
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "column", "first": plots, "second": names[-1], "splitPercentage": 85},
    }


def _path(topic: str, field: str) -> str:
    return f"{topic}.{field.lower()}"  # ROS wants lower case


def _split(names: Sequence[str], *, is_row: bool = True) -> Any:
    """Return a tree of halves, side by side and one below the other by turns."""
    if len(names) == 1:
        return names[0]
    half = (len(names) + 1) // 2
    return {
        "direction": "row" if is_row else "column",
        "first": _split(names[:half], is_row=not is_row),
        "second": _split(names[half:], is_row=not is_row),
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
