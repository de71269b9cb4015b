"""A maker's simulated drive on a bus in virtual time, with the suite in front of it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from firmware_protocol.conformance.port import VIRTUAL
from hil_forceps.bridge.drive_conformance.session import Session
from hil_forceps.bridge.drive_conformance.suite import Suite
from hil_forceps.bridge.links.adapters import LinkSpec, open_link
from hil_forceps.bridge.links.conformance_port import LinkPort
from hil_forceps.drives.port import DriveMachine
from hil_forceps.drives.registry import machine_for, maker_profile
from hil_forceps.rig import Rig, load_rig
from virtual_bus.drives.registry import SIMULATED_DRIVES, SimulatedMotorDriver
from virtual_bus.plant.load import paper_load

CONFIGS = Path(__file__).parents[3] / "configs" / "drives"


def rig_of(profile: str) -> Rig:
    return load_rig(CONFIGS / f"{profile}.yaml")


def drive_of(rig: Rig) -> SimulatedMotorDriver:
    """Return the rig's drive, without a load."""
    return SIMULATED_DRIVES[rig.drive_profile](rig, paper_load(0))


@contextmanager
def suite_for(rig: Rig, options: dict[str, object], machine: DriveMachine | None = None) -> Iterator[Suite]:
    """Yield the suite over a bus that is made of `options`; the line is closed at the end."""
    found = maker_profile(rig)
    assert found is not None
    spec = LinkSpec("virtual_forceps", f"makers {id(options)}", options=options)
    port = LinkPort(open_link(spec._replace(fd=rig.bench.transport == "fd")), rig.bench.transport == "fd")
    try:
        yield Suite(Session(port, rig, machine or machine_for(rig), *found, VIRTUAL), allow_motion=True)
    finally:
        port.close()
