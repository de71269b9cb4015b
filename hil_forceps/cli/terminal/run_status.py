"""State of a run while it lasts: a line that is updated on a terminal, else a line every few seconds."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rich.status import Status

from hil_forceps.bridge.results import Telemetry
from hil_forceps.cli.terminal.notes import is_quiet, note_console
from hil_forceps.cli.terminal.progress import last_told


@contextmanager
def run_status() -> Iterator[Any]:
    """Yield a function that shows the state of the run, or None with `--quiet`."""
    console = note_console()
    if is_quiet():
        yield None
        return
    if not console.is_terminal:
        with last_told(_line) as show:
            yield show
        return
    with Status("connecting", console=console) as status:

        def show(seen: Telemetry) -> None:
            status.update(
                f"{seen.axis} {seen.stage.value} {seen.time_s:6.2f} s  θ_m {seen.theta_m_rad:+.4f} rad  "
                f"τ_w {seen.tau_w_N_m * 1e3:+.3f} mN m  x {seen.elongation_m * 1e6:+.1f} µm  "
                f"sent {seen.frames_sent}  received {seen.frames_received}  overruns {seen.overruns}"
            )

        yield show


def _line(seen: Telemetry) -> str:
    axis = f"{seen.axis} " if seen.axis else ""
    return (
        f"{axis}{seen.stage.value}, {seen.frames_received} frames received, {seen.frames_sent} sent, "
        f"{seen.overruns} overruns"
    )
