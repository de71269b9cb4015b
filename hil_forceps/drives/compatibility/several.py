"""Several axes in one service: whether their rigs go together on one line, and what the line can carry. Pure."""

from collections.abc import Mapping
from typing import Final

from hil_forceps.drives.compatibility.lint import MAX_BUS_LOAD
from hil_forceps.drives.profile import Finding
from hil_forceps.drives.registry import PROFILES, bus_load, ids_in_common, shared_load
from hil_forceps.rig import Rig

# One line, and one loop: what must be the same in all rigs.
SHARED: Final = ("transport", "bitrate_bit_per_s", "data_bitrate_bit_per_s", "host_period_s", "host_phase_s")


def findings(rigs: Mapping[str, Rig]) -> list[Finding]:
    """Return what doesn't go together in rigs, by their names; the last finding is the line's load."""
    found: list[Finding] = []
    names = list(rigs)
    first = rigs[names[0]]
    lines = {_line(rig) for rig in rigs.values()}
    if len(lines) > 1:
        found.append(
            Finding(
                "problem",
                "motor_driver.profile",
                "some drives are on a CAN bus, others on a serial line; use one kind of line",
            )
        )
    for key in SHARED:
        values = {name: getattr(rig.bench, key) for name, rig in rigs.items()}
        if len(set(values.values())) > 1:
            said = ", ".join(f"{value} in {name}" for name, value in values.items())
            found.append(
                Finding(
                    "problem",
                    f"bench.{key}",
                    f"is {said}, but the axes share one bus and one loop; set the same value in all rigs",
                )
            )
    for place, name in enumerate(names):
        for other in names[place + 1 :]:
            both = ids_in_common(rigs[name], rigs[other])
            if both:
                lowest = min(both)[0]
                text = (
                    f"{name} and {other} use the same ids, such as {lowest:03X}h; change one node id, or use two buses"
                )
                found.append(Finding("problem", "node_id", text))
    load = sum(bus_load(rig) for rig in rigs.values()) - shared_load(rigs.values())
    most_Hz = MAX_BUS_LOAD / load / first.bench.host_period_s
    text = (
        f"{len(names)} axes load the line by {100.0 * load:.0f} % at worst; {100.0 * MAX_BUS_LOAD:.0f} % is reached at "
        f"{most_Hz:.0f} Hz"
    )
    level = "problem" if load > MAX_BUS_LOAD else "note"
    found.append(Finding(level, "bench.bitrate_bit_per_s", text))  # type: ignore[arg-type]
    return found


def _line(rig: Rig) -> str:
    return "can" if rig.drive_profile == "native" else PROFILES[rig.drive_profile].link
