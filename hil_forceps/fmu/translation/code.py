"""A piece of C while it is put together, and what can be wrong with the Python that it is made of."""

import ast
from dataclasses import dataclass, field
from types import FunctionType
from typing import NoReturn

from hil_forceps.fmu.translation.types import Type

# A name of Python that would mean something else in C.
# fmt: off
_TAKEN = frozenset((
    "auto", "char", "const", "default", "do", "double", "enum", "extern", "float", "goto", "inline", "int", "long",
    "register", "restrict", "short", "signed", "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned",
    "void", "volatile", "bool", "true", "false", "arena",
))
# fmt: on


@dataclass(frozen=True, slots=True)
class Value:
    """An expression of C and its type."""

    code: str
    kind: Type


@dataclass(slots=True)
class Body:
    """The body of a function while it is put together."""

    where: str  # for messages
    function: FunctionType
    variables: dict[str, Type]  # parameters too
    lines: list[str] = field(default_factory=list)
    depth: int = 1
    temporaries: int = 0
    returned: Type | None = None
    uses_arena: bool = False

    def put(self, line: str) -> None:
        """Add a line."""
        self.lines.append("    " * self.depth + line)

    def temporary(self, value: Value) -> Value:
        """Return a name for a value, which is computed here."""
        self.temporaries += 1
        name = f"t{self.temporaries}_"
        self.put(f"{value.kind.c} {name} = {value.code};")
        return Value(name, value.kind)

    def refuse(self, node: ast.AST, why: str) -> NoReturn:
        """Raise NotImplementedError for what isn't translated: a mistake of ours, told with function and line."""
        line = getattr(node, "lineno", 0)
        raise NotImplementedError(f"{self.where}, line {line} of it: {why}: {ast.unparse(node)}")


def c_name(name: str) -> str:
    """Return a name of Python as one of C."""
    return f"{name}_" if name in _TAKEN else name
