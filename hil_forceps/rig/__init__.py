"""The rig file: parameters with units, and their validation."""

from typing import TYPE_CHECKING

from hil_forceps.rig.errors import UserError

if TYPE_CHECKING:
    from hil_forceps.rig.loading import dump_rig, load_rig, parse_rig
    from hil_forceps.rig.quantities import Parameter
    from hil_forceps.rig.schema import Rig

__all__ = ["Parameter", "Rig", "UserError", "dump_rig", "load_rig", "parse_rig"]


def __getattr__(name: str) -> object:
    # pydantic takes longer to import than `hil-forceps --help` may take: only when a rig is really wanted.
    if name in __all__:
        from hil_forceps.rig import loading, quantities, schema  # noqa: PLC0415

        for module in (loading, quantities, schema):
            if hasattr(module, name):
                return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
