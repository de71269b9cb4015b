"""What kernels do with arrays: make them, cut them, copy them."""

import ast
from collections.abc import Callable
from typing import Any

import numpy as np

from hil_forceps.fmu.translation.code import Body, Value, c_name
from hil_forceps.fmu.translation.types import DOUBLE, INT, Array, Struct

_Translate = Callable[[ast.expr], Value]
_Call = Callable[[Value | None, list[Value], ast.AST, Body], Value]


def subscript(of: Value, index: ast.expr, node: ast.expr, body: Body, translate: _Translate) -> Value:
    """Return an element, a row or a part of an array, or an element of a tuple."""
    if isinstance(of.kind, Struct):
        if not (isinstance(index, ast.Constant) and isinstance(index.value, int)):
            body.refuse(node, "the place in a tuple must be a number")
        name, kind = of.kind.fields[index.value]
        return Value(f"{of.code}.{c_name(name)}", kind)
    if not isinstance(of.kind, Array):
        body.refuse(node, f"{of.kind.c} has no places")
    a = of if of.code.isidentifier() else body.temporary(of)
    places = index.elts if isinstance(index, ast.Tuple) else [index]
    if of.kind.dims == 1:
        if isinstance(index, ast.Slice):
            first, end = _ends(index, f"{a.code}.n", node, body, translate)
            return Value(f"hf_slice1({a.code}, {first}, {end})", of.kind)
        return Value(f"{a.code}.at[{_place(index, body, translate)}]", DOUBLE)
    if len(places) == 1 and not isinstance(index, ast.Slice):
        return Value(f"hf_row({a.code}, {_place(index, body, translate)})", Array(1))
    row, column = places
    if isinstance(row, ast.Slice) and isinstance(column, ast.Slice):
        bounds = [
            *_ends(row, f"{a.code}.rows", node, body, translate),
            *_ends(column, f"{a.code}.columns", node, body, translate),
        ]
        return Value(f"hf_slice2({a.code}, {', '.join(bounds)})", of.kind)
    i, j = _place(row, body, translate), _place(column, body, translate)
    return Value(f"{a.code}.at[{i} * {a.code}.row_step + {j} * {a.code}.column_step]", DOUBLE)


def _place(node: ast.expr, body: Body, translate: _Translate) -> str:
    value = translate(node)
    if value.kind != INT or value.code.startswith("(-"):
        body.refuse(node, "a place must be an integer from 0 on")
    return value.code


def _ends(part: ast.Slice, size: str, node: ast.expr, body: Body, translate: _Translate) -> tuple[str, str]:
    if part.step is not None:
        body.refuse(node, "a step of a slice is not translated")
    first = "0" if part.lower is None else _place(part.lower, body, translate)
    return first, size if part.upper is None else _place(part.upper, body, translate)


def _made(function: str, dims: int) -> _Call:
    def make(_: Value | None, values: list[Value], node: ast.AST, body: Body) -> Value:
        sizes, rest = values[:dims], values[dims:]
        if any(size.kind != INT for size in sizes) or len(sizes) < dims:
            body.refuse(node, "sizes must be integers")
        body.uses_arena = True
        return Value(f"{function}(arena, {', '.join(value.code for value in (*sizes, *rest))})", Array(dims))

    return make


def _blank(owner: Value | None, values: list[Value], node: ast.AST, body: Body) -> Value:
    return _made(f"hf_array{len(values)}", len(values))(owner, values, node, body)


def _eye(_: Value | None, values: list[Value], node: ast.AST, body: Body) -> Value:
    made = _made("hf_eye", 1)(None, values, node, body)
    return Value(made.code, Array(2))


def _full(_: Value | None, values: list[Value], node: ast.AST, body: Body) -> Value:
    return _made("hf_full", 1)(None, values, node, body)


def _array(_: Value | None, values: list[Value], node: ast.AST, body: Body) -> Value:
    """Return an array of numbers, or of the fields of a struct."""
    if len(values) == 1 and isinstance(values[0].kind, Struct):
        held = body.temporary(values[0])
        values = [Value(f"{held.code}.{c_name(name)}", kind) for name, kind in values[0].kind.fields]
    if any(value.kind not in {DOUBLE, INT} for value in values):
        body.refuse(node, "an array of what are no numbers")
    body.uses_arena = True
    numbers = [body.temporary(value).code for value in values]  # before the array: they may be made of it
    made = body.temporary(Value(f"hf_array1(arena, {len(values)})", Array(1)))
    for place, code in enumerate(numbers):
        body.put(f"{made.code}.at[{place}] = {code};")
    return made


def _copy(owner: Value | None, values: list[Value], node: ast.AST, body: Body) -> Value:
    of = values[0] if owner is None else owner
    if not isinstance(of.kind, Array):
        body.refuse(node, "only arrays are copied")
    body.uses_arena = True
    return Value(f"hf_copy{of.kind.dims}(arena, {of.code})", of.kind)


def _reshape(owner: Value | None, values: list[Value], node: ast.AST, body: Body) -> Value:
    if owner is None or owner.kind != Array(1) or len(values) != 2:
        body.refuse(node, "only an array of one dimension is given two")
    return Value(f"hf_shaped({owner.code}, {values[0].code}, {values[1].code})", Array(2))


ARRAY_CALLS: dict[Any, _Call] = {
    np.empty: _blank,
    np.zeros: _blank,
    np.eye: _eye,
    np.full: _full,
    np.array: _array,
    np.ascontiguousarray: _copy,
    "copy": _copy,
    "reshape": _reshape,
}
