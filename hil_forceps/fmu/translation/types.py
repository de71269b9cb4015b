"""Types of C that kernels come to."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Scalar:
    """A number or a truth value."""

    c: str


@dataclass(frozen=True, slots=True)
class Array:
    """Doubles over one or two dimensions: `Array1` or `Array2` of arrays.h."""

    dims: int

    @property
    def c(self) -> str:
        """Its name in C."""
        return f"Array{self.dims}"


@dataclass(frozen=True, slots=True)
class Struct:
    """A named tuple, or a tuple, whose fields are f0, f1 and so on."""

    c: str
    fields: tuple[tuple[str, "Type"], ...]


Type = Scalar | Array | Struct

DOUBLE, INT, BOOL, VOID = Scalar("double"), Scalar("int64_t"), Scalar("bool"), Scalar("void")
_OF_ANNOTATION: dict[Any, Scalar] = {float: DOUBLE, int: INT, bool: BOOL}


def of_annotation(annotation: object) -> Scalar | None:
    """Return the scalar that an annotation names; None for all else, whose type is that of what is handed over."""
    return _OF_ANNOTATION.get(annotation) if isinstance(annotation, type) else None


def has_array(kind: Type) -> bool:
    """Tell whether values of a type point to memory."""
    return isinstance(kind, Array) or (isinstance(kind, Struct) and any(has_array(each) for _, each in kind.fields))


def joined(a: Type, b: Type) -> Type | None:
    """Return the type that holds values of both; None where there is none."""
    if a == b:
        return a
    return DOUBLE if {a, b} == {DOUBLE, INT} else None


def tuple_of(kinds: tuple[Type, ...]) -> Struct:
    """Return the struct of a tuple."""
    return Struct("Tuple_" + "_".join(kind.c for kind in kinds), tuple((f"f{i}", k) for i, k in enumerate(kinds)))
