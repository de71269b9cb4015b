"""Notes and progress on standard error, which `--quiet` suppresses; errors are always printed."""

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
    """Remove `--quiet` from a command line, and remember whether it was given."""
    _NOTES.is_quiet = QUIET in arguments
    return [each for each in arguments if each != QUIET]


def is_quiet() -> bool:
    """Return whether only errors go to standard error."""
    return _NOTES.is_quiet


def note(text: str) -> None:
    """Print a note."""
    if not _NOTES.is_quiet:
        sys.stderr.write(f"note: {text}\n")


def note_console() -> "Console":
    """Return the console for progress, on standard error."""
    from rich.console import Console  # noqa: PLC0415 - not for `--help`

    return Console(stderr=True, quiet=_NOTES.is_quiet)
