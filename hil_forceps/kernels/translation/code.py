"""A piece of C while it is put together, and what can be wrong with the Python that it is made of."""

import ast
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from types import FunctionType
from typing import NoReturn

from hil_forceps.kernels.translation.types import Type

# A name of Python that would mean something else in C.
# fmt: off
_TAKEN = frozenset((
    "auto", "char", "const", "default", "do", "double", "enum", "extern", "float", "goto", "inline", "int", "long",
    "register", "restrict", "short", "signed", "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned",
    "void", "volatile", "bool", "true", "false", "arena", "NAN", "INFINITY", "sqrt", "exp", "expm1", "log", "log1p",
    "sin", "cos", "atan2", "tanh", "erf", "erfc", "hypot", "copysign", "pow", "fabs", "floor", "ceil", "trunc", "rint",
    "isnan", "isfinite", "calloc", "memset",
))
# fmt: on
_PLACE = re.compile(r"(\(\*\w+\)|[A-Za-z_]\w*)(\.[A-Za-z_]\w*)*")


@dataclass(frozen=True, slots=True)
class Value:
    """An expression of C and its type."""

    code: str
    kind: Type
    is_new: bool = False  # an array that nothing else has a part of

    @property
    def is_place(self) -> bool:
        """It names a variable or a field of one: nothing is computed when it is read, and it has an address."""
        return _PLACE.fullmatch(self.code) is not None


@dataclass(slots=True)
class Body:
    """The body of a function while it is put together."""

    where: str  # for messages
    function: FunctionType
    variables: dict[str, Type]  # parameters too
    by_address: frozenset[str] = frozenset()  # parameters that are read where their caller has them
    lines: list[str] = field(default_factory=list)
    depth: int = 1
    temporaries: int = 0
    returned: Type | None = None
    uses_arena: bool = False
    made: list[Type] = field(default_factory=list)  # types of temporaries

    def put(self, line: str) -> None:
        """Add a line."""
        self.lines.append("    " * self.depth + line)

    def name(self) -> str:
        """Return a name that nothing else has."""
        self.temporaries += 1
        return f"t{self.temporaries}_"

    def temporary(self, value: Value) -> Value:
        """Return a name for a value, which is computed here."""
        name = self.name()
        self.made.append(value.kind)
        self.put(f"{value.kind.c} {name} = {value.code};")
        return Value(name, value.kind)

    def undecided(self, kind: Type) -> Value:
        """Return a variable that is given its value later."""
        name = self.name()
        self.made.append(kind)
        self.put(f"{kind.c} {name};")
        return Value(name, kind)

    def apart(self, translate: Callable[[], Value]) -> tuple[Value, list[str]]:
        """Return an expression, and the lines that it takes, which are not put in."""
        before, self.lines = self.lines, []
        value = translate()
        lines, self.lines = self.lines, before
        return value, lines

    def held(self, value: Value) -> Value:
        """Return a value that can be read more than once: where it is, or computed here."""
        return value if value.is_place else self.temporary(value)

    def refuse(self, node: ast.AST, why: str) -> NoReturn:
        """Raise NotImplementedError for what isn't translated: a mistake of ours, told with function and line."""
        line = getattr(node, "lineno", 0)
        raise NotImplementedError(f"{self.where}, line {line} of it: {why}: {ast.unparse(node)}")


def c_name(name: str) -> str:
    """Return a name of Python as one of C."""
    return f"{name}_" if name in _TAKEN else name
