"""What a kernel is called with, as C has it: types of values, and values as the bytes of a struct."""

import ctypes
import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from hil_forceps.kernels.translation.program import Translation
from hil_forceps.kernels.translation.types import (
    BOOL,
    DOUBLE,
    INT,
    Array,
    Scalar,
    Struct,
    Type,
    of_dtype,
    tuple_of,
)

CTYPES: dict[str, Any] = {
    "double": ctypes.c_double,
    "float": ctypes.c_float,
    "int64_t": ctypes.c_int64,
    "bool": ctypes.c_bool,
    "void": None,
}
_DTYPES = {"double": np.float64, "float": np.float32, "int64_t": np.int64, "bool": np.bool_}
_FORMATS = {"double": "d", "float": "f", "int64_t": "q", "bool": "?"}


_LEAST_INT, _MOST_INT = -(2**63), 2**63 - 1
_Flatten = Callable[[Any, list[Any]], None]
_address = ctypes.addressof
_char: Any = ctypes.c_char.from_buffer  # of an array's memory


class OtherTypeError(Exception):
    """A value is not of the type that a kernel was compiled for."""


def type_of(value: object, program: Translation) -> Type:
    """Return the type of a value in C; TypeError for what no kernel takes.

    Structs are declared in `program`.
    """
    match value:
        case bool() | np.bool_():
            return BOOL
        case int() | np.integer():
            return INT
        case float() | np.floating():
            return DOUBLE
        case np.ndarray():
            if not value.flags.c_contiguous:
                raise TypeError("a kernel for a whole run takes arrays whose elements lie side by side")
            return Array(value.ndim, of_dtype(value.dtype))
        case tuple() if hasattr(value, "_fields"):
            return program.struct(type(value), [type_of(each, program) for each in value])
        case tuple():
            return program.use(tuple_of(tuple(type_of(each, program) for each in value)))
    raise TypeError(f"a kernel takes numbers, arrays and tuples, no {type(value).__name__}")


class Argument:
    """How a value of one type is handed to C: as a number, or as the address of a struct's bytes."""

    def __init__(self, kind: Type) -> None:
        self._kind = kind
        self.ctype: Any = CTYPES[kind.c] if isinstance(kind, Scalar) else ctypes.c_void_p
        self._pack = struct.Struct(_format(kind)).pack
        self._flatten = None if _is_flat(kind) else _flattener(kind)

    def packed(self, value: Any) -> Any:
        """Return the value, or its bytes, which must live as long as the call; OtherTypeError for another type."""
        if isinstance(self._kind, Scalar):
            return _number(value, self._kind)
        flat = value
        if self._flatten is None:
            if not _is_of(value, self._kind):
                raise OtherTypeError
        else:
            flat = []
            self._flatten(value, flat)
        try:
            return self._pack(*flat)
        except struct.error as problem:
            raise OtherTypeError from problem


def _is_flat(kind: Type) -> bool:
    return isinstance(kind, Struct) and all(each == DOUBLE for _, each in kind.fields)


def _number(value: Any, kind: Scalar) -> Any:
    whole = isinstance(value, int | np.integer | np.bool_)
    if not whole and not (kind == DOUBLE and isinstance(value, float | np.floating)):
        raise OtherTypeError(f"{value!r} where {kind.c} is expected")
    if kind == INT and not _LEAST_INT <= value <= _MOST_INT:
        raise OtherTypeError(f"{value} where an integer of 64 bits is expected")
    return int(value) if kind == INT else float(value) if kind == DOUBLE else bool(value)


def _flattener(kind: Type) -> _Flatten:
    """Return what appends the numbers that a value of this type is made of to a list."""
    if isinstance(kind, Scalar):
        return _flag if kind == BOOL else lambda value, flat: flat.append(value)
    if isinstance(kind, Array):
        return _array_flattener(np.dtype(_DTYPES[kind.element.c]), kind.dims)
    fields = [_flattener(each) for _, each in kind.fields]

    def flatten(value: Any, flat: list[Any]) -> None:
        if not _is_of(value, kind):
            raise OtherTypeError
        for flatten_field, each in zip(fields, value, strict=True):
            flatten_field(each, flat)

    return flatten


def _flag(value: Any, flat: list[Any]) -> None:
    if not isinstance(value, bool | np.bool_):
        raise OtherTypeError
    flat.append(value)


def _is_of(value: Any, kind: Type) -> bool:
    """Tell whether a value is a tuple of the kind that a struct was made of."""
    if not isinstance(kind, Struct) or not isinstance(value, tuple) or len(value) != len(kind.fields):
        return False
    made_of = type(value)
    return kind.c.startswith("Tuple_") if made_of is tuple else made_of.__name__.lstrip("_") == kind.c


def _array_flattener(dtype: np.dtype[Any], dims: int) -> _Flatten:
    def flatten(value: Any, flat: list[Any]) -> None:
        if not isinstance(value, np.ndarray) or value.dtype != dtype or value.ndim != dims:
            raise OtherTypeError
        if not value.flags.c_contiguous:
            raise OtherTypeError
        try:  # a third of the time of the other way, which takes all arrays
            flat.append(_address(_char(value)))
        except (TypeError, ValueError):  # read-only, or empty
            flat.append(value.ctypes.data)
        shape = value.shape
        flat += shape
        if dims == 2:
            flat.append(shape[1])
        elif dims == 3:
            flat += (shape[1] * shape[2], shape[2])

    return flatten


def _format(kind: Type) -> str:
    """Return the format of a value's bytes for `struct`, aligned as C aligns it."""
    if isinstance(kind, Scalar):
        return _FORMATS[kind.c]
    if isinstance(kind, Array):
        return "P" + "q" * len(kind.fields)
    parts = "".join(_format(each) for _, each in kind.fields)
    wide = set(parts) - set("?f")
    return f"0q{parts}0q" if wide else f"0f{parts}0f" if "f" in parts else parts
