"""Options that several commands take."""

from collections.abc import Sequence

from hil_forceps.rig.errors import UserError


def interface_options(pairs: Sequence[str]) -> dict[str, object]:
    """Split each --option KEY=VALUE; UserError when one is none."""
    broken = [pair for pair in pairs if "=" not in pair]
    if broken:
        raise UserError([f"--option {pair}: must be KEY=VALUE" for pair in broken])
    return {key: value for key, _, value in (pair.partition("=") for pair in pairs)}
