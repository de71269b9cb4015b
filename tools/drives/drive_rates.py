"""The largest rate of a host's loop that a drive's line carries: by computation, and tried in virtual time.

By computation: at which the frames of a tick, stuffed at worst, fill the line. Tried: the shortest of `PERIODS_S` at
which nothing is lost, dropped, withheld or damaged, and a sample comes for each tick; with the rig's latency. Some
drives take whole milliseconds only, and none is asked more often than its loop runs.
"""

import tempfile
from pathlib import Path
from typing import Final

import can

from hil_forceps.bench.assembly import Settings
from hil_forceps.bench.session import Plan, run_session, service_config, stamps_are_host_time
from hil_forceps.bridge.clocks import VirtualClock
from hil_forceps.bridge.links.adapters import Connection
from hil_forceps.bridge.links.can_link import VirtualTimeLink
from hil_forceps.control.trajectories import PAPER_TRAJECTORY
from hil_forceps.drives.compatibility.lint import findings
from hil_forceps.drives.promises import damage
from hil_forceps.drives.registry import bus_load, machine_for, maker_profile, sample_period_s
from hil_forceps.rig import Rig
from hil_forceps.rig.errors import UserError
from virtual_bus.interface import VirtualForcepsBus

PERIODS_S: Final = (5e-4, 6.25e-4, 8e-4, 1e-3, 1.25e-3, 1.6e-3, 2e-3, 2.5e-3, 4e-3, 5e-3)
DURATION_S: Final = 1.0
MIN_SAMPLES_PER_TICK: Final = 0.995  # the first and the last may be on their way
MAX_SAMPLE_AGE_PERIODS: Final = 5.0  # what is looked for is loss


def computed_Hz(rig: Rig) -> float:
    """Return the rate at which a rig's frames fill its line."""
    return 1.0 / (bus_load(rig) * rig.bench.host_period_s)


def at_period(rig: Rig, period_s: float) -> Rig:
    """Return a rig with another period of the host's loop, and of what its drive sends by itself."""
    bench = rig.bench
    changes: dict[str, object] = {
        "bench.host_period_s": period_s,
        "bench.host_phase_s": bench.host_phase_s * period_s / bench.host_period_s,
        "limits.max_sample_age_s": MAX_SAMPLE_AGE_PERIODS * period_s,
    }
    if rig.drive_profile == "odrive":
        changes |= {"motor_driver.feedback_period_s": period_s, "motor_driver.current_period_s": period_s}
    return rig.with_changes(changes)


def is_carried(rig: Rig) -> bool:
    """Tell whether a rig runs in virtual time with nothing lost."""
    try:
        machine = machine_for(rig)
    except UserError:
        return False
    if any(found.level == "problem" for found in findings(rig)):
        return False
    try:
        bus = VirtualForcepsBus(f"rate {rig.bench.host_period_s} {rig.drive_profile}", rig=rig, simulation=0)
    except can.CanInitializationError:  # a period that the simulated drive's loop doesn't divide
        return False
    settings = Settings("kalman", True, sample_period_s(rig), PAPER_TRAJECTORY, stamps_are_host_time(rig))
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder) / "run.mcap", Path(folder) / "bus.log"
        plan = Plan(rig, settings, machine, service_config(rig, DURATION_S), *files, {})
        result = run_session(Connection(VirtualTimeLink(bus), VirtualClock(bus), True, ()), plan).service
    counters = result.counters
    found = maker_profile(rig)
    host = counters["host"]
    lost = {"lost": host["lost_feedback"]} if found is None else damage(host, found[0].promises(rig, found[1]))
    lost.pop("asked_again", None)  # a Dynamixel, while it is stopped
    dropped = counters["link"]["queue_full"] + host.get("syncs_withheld", 0) + sum(lost.values())
    ticks = DURATION_S / rig.bench.host_period_s
    references = counters["service"]["references_sent"]
    return result.ok and not dropped and min(host["samples"], references) >= MIN_SAMPLES_PER_TICK * ticks


def tried_Hz(rig: Rig) -> float | None:
    """Return the largest rate that was carried; None where none of `PERIODS_S` was."""
    return next((1.0 / period_s for period_s in PERIODS_S if is_carried(at_period(rig, period_s))), None)
