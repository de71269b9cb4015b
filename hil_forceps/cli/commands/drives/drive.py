"""`hil-forceps drive`: the simulated drive as a process."""

from importlib.metadata import entry_points
from typing import Annotated

from cyclopts import Parameter

from hil_forceps.rig.errors import UserError

GROUP = "hil_forceps.drive"


def drive(
    *arguments: Annotated[str, Parameter(allow_leading_hyphen=True)],
    kind: str = "simulated",
) -> int:
    """Start a drive process; everything else on the line goes to it.

    Parameters
    ----------
    kind
        Which installed drive to start; packages add theirs under the entry point group `hil_forceps.drive`.
    """
    # By entry point and not by import: the service must not know the world it is tested in.
    found = {point.name: point for point in entry_points(group=GROUP)}
    if kind not in found:
        raise UserError(f"no drive '{kind}' is installed; there is: {', '.join(sorted(found)) or 'none'}")
    result = found[kind].load()(list(arguments))
    return result if isinstance(result, int) else 0
