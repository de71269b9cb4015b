"""A simulated moteus with its rig, in a run of the service or by itself."""

from pathlib import Path

from hil_forceps.rig import Rig, load_rig
from virtual_bus.drives.moteus import SimulatedMoteus
from virtual_bus.plant.load import paper_load

RIG_FILE = Path(__file__).parents[4] / "configs" / "drives" / "moteus.yaml"
RIG = load_rig(RIG_FILE)
NODE, MS = 5, 1_000_000


# -- the peer ---------------------------------------------------------------------------------------------------------


def peer(rig: Rig = RIG) -> SimulatedMoteus:
    return SimulatedMoteus(rig, paper_load(0))
