"""Files that come with the package: pages of the documents, example rig files."""

from collections.abc import Mapping
from typing import TypeVar

from hil_forceps.rig.errors import UserError
from hil_forceps.rig.validation.problems import nearest

T = TypeVar("T")


def chosen(wanted: str, name: str, found: Mapping[str, T], kind: str, command: str) -> T:
    """Return the file of a name; UserError with the nearest one, or with the command that lists them.

    `wanted`: the name as it was typed; `kind`: what is missing, in the singular.
    """
    if name in found:
        return found[name]
    near = nearest(name, found)
    remedy = f"did you mean {near}?" if near else f"`hil-forceps {command}` lists all {kind}s"
    raise UserError(f"{wanted}: no such {kind}; {remedy}")
