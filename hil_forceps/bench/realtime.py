"""Runs of the bench by the wall clock, against the simulated drive in a process of its own."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from hil_forceps.bench.execute import Executed, never, run_on
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bridge.adapters import LinkSpec, open_link
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

Wire = Literal["pty", "udp_multicast"]
MULTICAST_CHANNEL = "239.74.163.2"
END_TIMEOUT_S = 10.0
SPARE_S = 60.0  # for starting, enabling and ending


def run_realtime(
    specs: Sequence[RunSpec],
    config: Path,
    rig: Rig,
    seed: int,
    out: Path,
    wire: Wire,
    done: Callable[[Executed], None],
    stop_requested: Callable[[], bool] = never,
) -> list[Executed]:
    """Execute `specs` one after the other; each leaves also `out`/NAME.drive.json, what the drive counted.

    On `stop_requested` the run under way ends early and clean, and those not yet begun are dropped.
    """
    results = []
    for spec in specs:
        if stop_requested():
            break
        with tempfile.TemporaryDirectory() as folder:
            where, link = _both_ends(wire, Path(folder) / "drive", rig)
            told: dict[str, Any] = {}
            what = ["--rig", str(config), "--seed", str(seed), "--simulation", str(spec.simulation)]
            # It ends by itself too: were this process killed, it would run on alone.
            with drive_process([*what, "--duration", str(spec.duration_s + SPARE_S), *where], told):
                executed = run_on(open_link(link), spec, rig, seed, out, stop_requested)
        (out / f"{spec.name}.drive.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
        done(executed)
        results.append(executed)
    return results


def _both_ends(wire: Wire, port: Path, rig: Rig) -> tuple[list[str], LinkSpec]:
    is_fd = rig.bench.transport == "fd"
    if wire == "pty":
        return ["--serial-pty", str(port)], LinkSpec(serial_url=str(port), fd=is_fd)
    arguments = ["--interface", wire, "--channel", MULTICAST_CHANNEL]
    return arguments, LinkSpec(interface=wire, channel=MULTICAST_CHANNEL, fd=is_fd)


@contextmanager
def drive_process(arguments: Sequence[str], told: dict[str, Any]) -> Iterator[None]:
    """Run `hil-forceps drive` while the body runs; `told` receives the summary that it ends with.

    UserError with the drive's own words when it does not come up.
    """
    command = [sys.executable, "-m", "hil_forceps.cli.main", "drive", *arguments]
    # In a session of its own: Ctrl-C would end it before the host has disabled it.
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    try:
        if not process.stdout.readline().startswith("ready"):
            _, errors = process.communicate(timeout=END_TIMEOUT_S)
            raise UserError([f"drive: {line}" for line in errors.splitlines()] or "drive: ended without a word")
        yield
    finally:
        process.terminate()
        try:
            output, _ = process.communicate(timeout=END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            output, _ = process.communicate()
    lines = output.splitlines()
    told.update(json.loads(lines[-1]) if lines else {})
