"""`hil-forceps drive`: the simulated drive as a separate process."""

from importlib.metadata import entry_points
from typing import Annotated

from cyclopts import Parameter

from hil_forceps.rig.errors import UserError

GROUP = "hil_forceps.drive"


def drive(
    *arguments: Annotated[str, Parameter(allow_leading_hyphen=True)],
    kind: str = "simulated",
) -> int:
    """Start a simulated drive; all other arguments are passed to it.

    Parameters
    ----------
    kind
        Drive to start; packages register drives under the entry point group `hil_forceps.drive`.
    """
    # By entry point and not by import: the service must not depend on the simulated world.
    found = {point.name: point for point in entry_points(group=GROUP)}
    if kind not in found:
        raise UserError(f"--kind {kind}: no such drive is installed; installed: {', '.join(sorted(found)) or 'none'}")
    result = found[kind].load()(list(arguments))
    return result if isinstance(result, int) else 0
