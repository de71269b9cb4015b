"""Message for a wrong command line: one line, with the nearest known word if there is one."""

import difflib
from collections.abc import Iterable

from cyclopts import CycloptsError, UnknownCommandError, UnknownOptionError

MIN_SIMILARITY_RATIO = 0.6  # difflib's own bound for a close match


def told(error: CycloptsError, commands: Iterable[str]) -> str:
    """Return the line, without the program's name."""
    command = " ".join(error.command_chain or ())
    see = f"see hil-forceps {command} --help" if command else "see hil-forceps --help"
    if isinstance(error, UnknownCommandError):
        wrong = next(iter(error.unused_tokens or error.root_input_tokens or ["?"]))
        return f"{wrong}: unknown command{_meant(wrong, commands)}; {see} for the list"
    if isinstance(error, UnknownOptionError):
        known = [name for each in error.argument_collection for name in (*each.names, *each.negatives)]
        wrong = (error.token.keyword or error.token.value).partition("=")[0]
        return f"{wrong}: unknown option of {command or 'hil-forceps'}{_meant(wrong, known)}; {see}"
    return f"{' '.join(str(error).split()).rstrip('.')}; {see}"


def _meant(wrong: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(wrong, list(known), n=1, cutoff=MIN_SIMILARITY_RATIO)
    return f" (did you mean {close[0]}?)" if close else ""
