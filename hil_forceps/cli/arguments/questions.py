"""Questions on a terminal, each with a default where there is one, in place of options that were not given."""

import sys
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

from hil_forceps.rig.errors import UserError

T = TypeVar("T")


class Question(NamedTuple, Generic[T]):
    """What is asked in place of an option."""

    option: str  # as it is given, with what comes behind it
    text: str
    read: Callable[[str], T]  # UserError where the answer makes no sense
    default: str = ""


def can_ask() -> bool:
    """Tell whether somebody sits at a terminal."""
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def missing(questions: Sequence[Question[T]]) -> UserError:
    """Return the one line for options that are missing where nobody can be asked."""
    return UserError(f"missing: {', '.join(each.option for each in questions)}; give them, or run it on a terminal")


def ask(question: Question[T]) -> T:
    """Ask until the answer makes sense; UserError at the end of the input."""
    shown = f" [{question.default}]" if question.default else ""
    while True:
        sys.stderr.write(f"{question.text}{shown}: ")
        sys.stderr.flush()
        line = sys.stdin.readline()
        if not line:
            sys.stderr.write("\n")
            raise missing([question])
        answer = line.strip() or question.default
        if not answer:
            continue
        try:
            return question.read(answer)
        except UserError as error:
            sys.stderr.write("".join(f"  {problem}\n" for problem in error.problems))
