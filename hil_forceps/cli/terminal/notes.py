"""Notes and progress on standard error, which `--quiet` silences; errors never are."""

import sys
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.console import Console

QUIET: Final = "--quiet"


class _Notes:
    def __init__(self) -> None:
        self.is_quiet = False


_NOTES: Final = _Notes()


def without_quiet(arguments: list[str]) -> list[str]:
    """Take `--quiet` out of a command line, and remember whether it was there."""
    _NOTES.is_quiet = QUIET in arguments
    return [each for each in arguments if each != QUIET]


def is_quiet() -> bool:
    """Tell whether nothing but errors goes to standard error."""
    return _NOTES.is_quiet


def note(text: str) -> None:
    """Tell something that is no error."""
    if not _NOTES.is_quiet:
        sys.stderr.write(f"note: {text}\n")


def note_console() -> "Console":
    """Return the console for progress, on standard error."""
    from rich.console import Console  # noqa: PLC0415 - not for `--help`

    return Console(stderr=True, quiet=_NOTES.is_quiet)
