"""A simulated mini cheetah drive with its rig, and the frames that steer it."""

import json
from pathlib import Path
from typing import Any

import pytest

from hil_forceps.cli import main as cli
from hil_forceps.rig import load_rig

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "mit.yaml"
RIG = load_rig(RIG_FILE)
NODE, MS = 5, 1_000_000
VARIANTS = ("bgkatz", "cubemars", "damiao")


def run(tmp_path: Path, rig: str | Path = RIG_FILE, *more: str) -> tuple[int, dict[str, Any]]:
    arguments = ["run", "--rig", str(rig), "--interface", "virtual_forceps", "--channel", str(tmp_path)]
    with pytest.raises(SystemExit) as ended:
        cli.main([*arguments, "--option", f"rig={rig}", "--duration", "3", "--out", str(tmp_path / "out"), *more])
    return int(ended.value.code or 0), json.loads((tmp_path / "out" / "run.json").read_text())
