"""Runs of the bench in real time, with the simulated drive in a separate process."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

from hil_forceps.bench.execute import Executed, never, run_on
from hil_forceps.bench.matrix import RunSpec
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.live.view import View
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError

Wire = Literal["pty", "udp_multicast"]
MULTICAST_CHANNEL = "239.74.163.2"
END_TIMEOUT_S = 10.0
SPARE_TIME_S = 60.0  # for starting, enabling and ending
# Counters of the drive for setpoints that arrived undamaged and were refused.
REFUSALS = ("not_enabled", "setpoint_stale", "sample_old", "sample_future")


class RealTime(NamedTuple):
    """Settings of runs in real time."""

    config: Path  # rig file, for the drive's process
    wire: Wire
    estimator_rig: Rig | None = None  # of the specs that name one
    view: View | None = None  # shows the runs while they last


def run_realtime(
    specs: Sequence[RunSpec],
    rig: Rig,
    seed: int,
    out: Path,
    how: RealTime,
    done: Callable[[Executed], None],
    stop_requested: Callable[[], bool] = never,
) -> list[Executed]:
    """Execute `specs` one after the other; each also writes `out`/NAME.drive.json, the counters of the drive.

    On `stop_requested` the current run is stopped, and later ones are not begun.
    """
    results = []
    for spec in specs:
        if stop_requested():
            break
        with tempfile.TemporaryDirectory() as folder:
            where, link = _both_ends(how.wire, Path(folder) / "drive", rig)
            told: dict[str, Any] = {}
            asked = ["--rig", str(how.config), "--seed", str(seed), "--simulation", str(spec.simulation), *where]
            # The duration ends the drive even if this process is killed.
            with drive_process([*asked, "--duration", str(spec.duration_s + SPARE_TIME_S)], told):
                link_end = open_link(link)
                executed = run_on(link_end, spec, rig, seed, out, stop_requested, how.estimator_rig, how.view)
        if not told:
            raise UserError(f"{spec.name}: the drive's process ended early: {executed.record.ending}")
        executed.record.timing["accounting"] = account(executed.record.timing["counters"], told)
        (out / f"{spec.name}.drive.json").write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
        done(executed)
        results.append(executed)
    return results


def account(host: Mapping[str, Mapping[str, int]], drive: Mapping[str, Any]) -> dict[str, dict[str, int]]:
    """Account for all cyclic frames by sequence number: sent by one end, and received, refused or lost at the other.

    `feedback` counts from the first frame that the host received. `unaccounted` are frames that no counter explains:
    those in transit when a run ended, otherwise zero.
    """
    counts, heard, machine = host["host"], drive["received"], drive["drive"]
    refused = {name: machine[name] for name in REFUSALS}
    sent = counts["setpoints_sent"]
    known = machine["setpoints_accepted"] + sum(refused.values()) + machine["setpoints_lost"]
    return {
        "feedback": {
            "delivered": counts["samples"],
            "lost": counts["lost_feedback"],
            "stale": counts["stale_feedback"],
            "unpaired": counts["unpaired"],
            "broken": counts["bad_crc"] + counts["bad_length"] + counts["bad_format"],
        },
        "setpoints": {
            "sent": sent,
            "heard": int(heard.get("SETPOINT", 0)) + int(heard.get("FD_SETPOINT", 0)),
            "accepted": machine["setpoints_accepted"],
            "lost": machine["setpoints_lost"],
            **refused,
            "unaccounted": sent - known,
        },
    }


def _both_ends(wire: Wire, port: Path, rig: Rig) -> tuple[list[str], LinkSpec]:
    is_fd = rig.bench.transport == "fd"
    if wire == "pty":
        return ["--serial-pty", str(port)], LinkSpec(serial_url=str(port), fd=is_fd)
    arguments = ["--interface", wire, "--channel", MULTICAST_CHANNEL]
    return arguments, LinkSpec(interface=wire, channel=MULTICAST_CHANNEL, fd=is_fd)


@contextmanager
def drive_process(arguments: Sequence[str], told: dict[str, Any]) -> Iterator[None]:
    """Run `hil-forceps drive` while the block runs; `told` receives the summary that it prints at its end.

    UserError with the drive's messages if it does not start.
    """
    command = [sys.executable, "-m", "hil_forceps.cli.main", "drive", *arguments]
    # In a separate session: otherwise Ctrl-C would end it before the host has disabled the drive.
    process = subprocess.Popen(  # noqa: S603 - this interpreter and this package, no shell
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    try:
        if not process.stdout.readline().startswith("ready"):
            _, errors = process.communicate(timeout=END_TIMEOUT_S)
            raise UserError([f"drive: {line}" for line in errors.splitlines()] or "drive: ended without a message")
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
