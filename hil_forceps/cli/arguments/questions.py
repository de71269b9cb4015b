"""Questions on a terminal for options that were not given."""

import sys
from collections.abc import Callable, Sequence
from typing import Generic, NamedTuple, TypeVar

from hil_forceps.rig.errors import UserError

T = TypeVar("T")


class Question(NamedTuple, Generic[T]):
    """A question for the value of an option."""

    option: str  # with a placeholder for its value, as `--gear N`
    text: str
    read: Callable[[str], T]  # UserError for an invalid answer
    default: str = ""


def can_ask() -> bool:
    """Return whether standard input and error are a terminal."""
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def missing(questions: Sequence[Question[T]]) -> UserError:
    """Return the error for missing options if nobody can be asked."""
    names = ", ".join(each.option for each in questions)
    return UserError(f"missing options: {names}; add them, or run the command on a terminal")


def ask(question: Question[T]) -> T:
    """Ask until the answer is valid; UserError at the end of the input."""
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
