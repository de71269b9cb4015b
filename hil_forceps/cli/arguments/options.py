"""Options that several commands take."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from can.util import cast_from_string

from hil_forceps.rig.errors import UserError


def interface_options(pairs: Sequence[str]) -> dict[str, object]:
    """Split each --option KEY=VALUE, with numbers converted; UserError for one that is not such a pair."""
    broken = [pair for pair in pairs if "=" not in pair]
    if broken:
        raise UserError([f"--option {pair}: must be KEY=VALUE, such as --option bitrate=500000" for pair in broken])
    # Interfaces need numbers as numbers, for example udp_multicast its port.
    return {key: cast_from_string(value) for key, _, value in (pair.partition("=") for pair in pairs)}


@contextmanager
def spoken_as_options(options: Mapping[str, str]) -> Iterator[None]:
    """Replace the name of an API parameter at the beginning of an error by the option.

    `options`: parameter to option, without dashes.
    """
    try:
        yield
    except UserError as error:
        raise UserError([_spoken(problem, options) for problem in error.problems]) from error


def _spoken(problem: str, options: Mapping[str, str]) -> str:
    # A blank or a colon follows the parameter's name.
    for parameter, option in options.items():
        for end in (" ", ":"):
            if problem.startswith(parameter + end):
                return f"--{option.replace('_', '-')}{problem.removeprefix(parameter)}"
    return problem
