"""Options that several commands take."""

from collections.abc import Sequence

from can.util import cast_from_string

from hil_forceps.rig.errors import UserError


def interface_options(pairs: Sequence[str]) -> dict[str, object]:
    """Split each --option KEY=VALUE; what is a number becomes one. UserError when one is no such pair."""
    broken = [pair for pair in pairs if "=" not in pair]
    if broken:
        raise UserError([f"--option {pair}: must be KEY=VALUE" for pair in broken])
    # Python's interfaces want numbers as numbers: udp_multicast its port, for one.
    return {key: cast_from_string(value) for key, _, value in (pair.partition("=") for pair in pairs)}
