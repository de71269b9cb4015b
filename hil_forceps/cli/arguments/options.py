"""Options that several commands take."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from can.util import cast_from_string

from hil_forceps.rig.errors import UserError


def interface_options(pairs: Sequence[str]) -> dict[str, object]:
    """Split each --option KEY=VALUE; what is a number becomes one. UserError when one is no such pair."""
    broken = [pair for pair in pairs if "=" not in pair]
    if broken:
        raise UserError([f"--option {pair}: must be KEY=VALUE, such as --option bitrate=500000" for pair in broken])
    # Python's interfaces want numbers as numbers: udp_multicast its port, for one.
    return {key: cast_from_string(value) for key, _, value in (pair.partition("=") for pair in pairs)}


@contextmanager
def spoken_as_options(options: Mapping[str, str]) -> Iterator[None]:
    """Have errors about parameters of the API, named at their beginning, speak of options instead.

    `options`: from a parameter to the option without its dashes.
    """
    try:
        yield
    except UserError as error:
        raise UserError([_spoken(problem, options) for problem in error.problems]) from error


def _spoken(problem: str, options: Mapping[str, str]) -> str:
    # A parameter ends with a blank, or with a colon where no value is told.
    for parameter, option in options.items():
        for end in (" ", ":"):
            if problem.startswith(parameter + end):
                return f"--{option.replace('_', '-')}{problem.removeprefix(parameter)}"
    return problem
