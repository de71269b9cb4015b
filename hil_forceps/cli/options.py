"""Options that several commands take."""

from collections.abc import Sequence

from hil_forceps.rig.errors import UserError


def interface_options(pairs: Sequence[str]) -> dict[str, object]:
    """Split each --option KEY=VALUE; what is a number becomes one. UserError when one is no such pair."""
    broken = [pair for pair in pairs if "=" not in pair]
    if broken:
        raise UserError([f"--option {pair}: must be KEY=VALUE" for pair in broken])
    return {key: _value(text) for key, _, text in (pair.partition("=") for pair in pairs)}


def _value(text: str) -> str | int:
    """Give python-can interfaces, which take no strings for numbers, a number; what str() would not give back stays."""
    return int(text) if text.isdecimal() and str(int(text)) == text else text
