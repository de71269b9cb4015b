"""Types of C that kernels come to."""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Scalar:
    """A number or a truth value."""

    c: str


@dataclass(frozen=True, slots=True)
class Array:
    """Scalars over one to three dimensions: a struct of a pointer, the sizes and the steps between elements.

    The last dimension has a step of its own where it is `stepped`; else its elements lie side by side.
    """

    dims: int
    element: Scalar = Scalar("double")
    stepped: bool = False

    @property
    def c(self) -> str:
        """Its name in C."""
        return f"{_ARRAYS[self.element.c]}{self.dims}{'Stepped' if self.stepped else ''}"

    @property
    def fields(self) -> tuple[str, ...]:
        """The names of sizes and steps, in the order of the struct."""
        sizes = tuple(f"size{i}" for i in range(self.dims))
        return (*sizes, *(f"step{i}" for i in range(self.dims - (not self.stepped))))

    def step(self, code: str, axis: int) -> str:
        """Return the step between elements along an axis of the array `code`."""
        return "1" if axis == self.dims - 1 and not self.stepped else f"{code}.step{axis}"


@dataclass(frozen=True, slots=True)
class Struct:
    """A named tuple, or a tuple, whose fields are f0, f1 and so on."""

    c: str
    fields: tuple[tuple[str, "Type"], ...]


Type = Scalar | Array | Struct

DOUBLE, FLOAT, INT, BOOL, VOID = Scalar("double"), Scalar("float"), Scalar("int64_t"), Scalar("bool"), Scalar("void")
NUMBERS = frozenset({DOUBLE, FLOAT, INT})
_ARRAYS = {"double": "Doubles", "float": "Floats", "int64_t": "Ints", "bool": "Bools"}
_OF_ANNOTATION: dict[Any, Scalar] = {float: DOUBLE, int: INT, bool: BOOL}
_OF_NUMPY = {np.float64: DOUBLE, np.float32: FLOAT, np.int64: INT, np.bool_: BOOL}
_IN_REGISTERS = 4  # scalars: a larger struct is handed over by its address


def of_annotation(annotation: object) -> Scalar | None:
    """Return the scalar that an annotation names; None for all else, whose type is that of what is handed over."""
    return _OF_ANNOTATION.get(annotation) if isinstance(annotation, type) else None


def of_dtype(kind: object) -> Scalar:
    """Return the scalar for elements of a numpy array; NotImplementedError for others than those that kernels use."""
    found = _OF_NUMPY.get(kind if isinstance(kind, type) else np.dtype(kind).type)  # type: ignore[call-overload]
    if found is None:
        raise NotImplementedError(f"arrays of {kind} are not translated")
    return found


def has_array(kind: Type) -> bool:
    """Tell whether values of a type point to memory."""
    return isinstance(kind, Array) or (isinstance(kind, Struct) and any(has_array(each) for _, each in kind.fields))


def by_address(kind: Type) -> bool:
    """Tell whether functions are handed the address of a value instead of the value."""
    return isinstance(kind, Struct) and _scalars(kind) > _IN_REGISTERS


def _scalars(kind: Type) -> int:
    if isinstance(kind, Struct):
        return sum(_scalars(each) for _, each in kind.fields)
    return 1 if isinstance(kind, Scalar) else 1 + len(kind.fields)


def joined(a: Type, b: Type) -> Type | None:
    """Return the type that holds values of both; None where there is none."""
    if a == b:
        return a
    if a in NUMBERS and b in NUMBERS:
        return DOUBLE
    if isinstance(a, Array) and isinstance(b, Array) and (a.dims, a.element) == (b.dims, b.element):
        return Array(a.dims, a.element, stepped=True)
    return None


def tuple_of(kinds: tuple[Type, ...]) -> Struct:
    """Return the struct of a tuple."""
    return Struct("Tuple_" + "_".join(kind.c for kind in kinds), tuple((f"f{i}", k) for i, k in enumerate(kinds)))
