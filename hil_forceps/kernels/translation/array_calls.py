"""What kernels do with whole arrays: make them, copy them, compute with them element by element."""

import ast
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hil_forceps.kernels.translation.code import Body, Value, c_name
from hil_forceps.kernels.translation.numbers import arithmetic, number
from hil_forceps.kernels.translation.types import DOUBLE, INT, NUMBERS, Array, Scalar, Struct
from hil_forceps.kernels.translation.views import element

_Call = Callable[[Value | None, list[Value], Scalar, ast.AST, Body], Value]


def made(element_kind: Scalar, sizes: list[str], body: Body) -> Value:
    """Return a new array in the arena, of zeros."""
    body.uses_arena = True
    kind = Array(len(sizes), element_kind)
    held = [body.held(Value(size, INT)).code if not size.isdigit() else size for size in sizes]
    steps = [" * ".join(held[axis + 1 :]) for axis in range(len(held) - 1)]
    fields = [f"({element_kind.c} *)hf_room(arena, {' * '.join(held)})", *held, *steps]
    return replace(body.temporary(Value(f"({kind.c}){{{', '.join(fields)}}}", kind)), is_new=True)


def for_each(a: Value, body: Body, line: Callable[[list[str]], str]) -> None:
    """Put a line in for each element of an array; the line is made of the element's places."""
    assert isinstance(a.kind, Array)
    names = [body.name() for _ in range(a.kind.dims)]
    for axis, name in enumerate(names):
        body.put(f"for (int64_t {name} = 0; {name} < {a.code}.size{axis}; {name}++) {{")
        body.depth += 1
    body.put(line(names))
    for _ in names:
        body.depth -= 1
        body.put("}")


def sizes_of(a: Value) -> list[str]:
    """Return the sizes of an array."""
    assert isinstance(a.kind, Array)
    return [f"{a.code}.size{axis}" for axis in range(a.kind.dims)]


def elementwise(operator: ast.operator, left: Value, right: Value, node: ast.AST, body: Body) -> Value:
    """Return an operation on arrays of the same size, or on an array and a number."""
    a, b = body.held(left), body.held(right)
    shape = a if isinstance(a.kind, Array) else b
    assert isinstance(shape.kind, Array)
    if any(isinstance(each.kind, Array) and each.kind.dims < shape.kind.dims for each in (a, b)):
        body.refuse(node, "arrays of different dimensions are not translated together")
    kinds = [each.kind.element if isinstance(each.kind, Array) else each.kind for each in (a, b)]
    result = arithmetic(operator, Value("a", kinds[0]), Value("b", kinds[1]), node, body).kind
    assert isinstance(result, Scalar)
    out = made(result, _common_sizes(a, b, shape), body)

    def line(places: list[str]) -> str:
        # A single row or column goes along with all of the other array, as numpy broadcasts it.
        x, y = (Value(_broadcast(each, places), kind) for each, kind in zip((a, b), kinds, strict=True))
        return f"{element(out, places)} = {arithmetic(operator, x, y, node, body).code};"

    for_each(out, body, line)
    return out


def _common_sizes(a: Value, b: Value, shape: Value) -> list[str]:
    if not (isinstance(a.kind, Array) and isinstance(b.kind, Array)):
        return sizes_of(shape)
    pairs = zip(sizes_of(a), sizes_of(b), strict=True)
    return [f"hf_common(arena, {mine}, {its})" for mine, its in pairs]


def _broadcast(a: Value, places: list[str]) -> str:
    """Return an element, or the only one along an axis, as numpy broadcasts it."""
    if not isinstance(a.kind, Array):
        return a.code
    return element(a, [f"({a.code}.size{axis} == 1 ? 0 : {i})" for axis, i in enumerate(places)])


def fill(target: Value, value: Value, node: ast.AST, body: Body) -> None:
    """Put the assignment of an array, or of a number, to all elements of an array or a part of one into a body."""
    to, given = body.held(target), body.held(value)
    assert isinstance(to.kind, Array)
    if not isinstance(given.kind, Array):
        for_each(to, body, lambda places: f"{element(to, places)} = {given.code};")
        return
    if given.kind.dims != to.kind.dims:
        body.refuse(node, "an array of other dimensions")
    body.uses_arena = True
    for mine, its in zip(sizes_of(to), sizes_of(given), strict=True):
        body.put(f"if ({its} != {mine} && {its} != 1) {{ arena->unequal = true; }}")
    source = given if value.is_new else _copied(given, body)  # it may be a part of what is written to
    body.put("if (!arena->unequal) {")
    body.depth += 1
    for_each(to, body, lambda places: f"{element(to, places)} = {_broadcast(source, places)};")
    body.depth -= 1
    body.put("}")


def _copied(of: Value, body: Body) -> Value:
    assert isinstance(of.kind, Array)
    out = made(of.kind.element, sizes_of(of), body)
    for_each(out, body, lambda places: f"{element(out, places)} = {element(of, places)};")
    return out


def _blank(_: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    if any(size.kind != INT for size in values):
        body.refuse(node, "sizes must be integers")
    return made(kind, [value.code for value in values], body)


def _ones(_: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    out = _blank(None, values, kind, node, body)
    fill(out, Value("1", INT), node, body)
    return out


def _full(_: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    if values[-1].kind != DOUBLE:
        body.refuse(node, "only doubles are filled in")
    out = _blank(None, values[:-1], kind, node, body)
    fill(out, values[-1], node, body)
    return out


def _eye(_: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    if len(values) != 1:
        body.refuse(node, "only square")
    size = body.held(values[0])
    out = _blank(None, [size, size], kind, node, body)
    place = body.name()
    body.put(f"for (int64_t {place} = 0; {place} < {size.code}; {place}++) {{")
    body.put(f"    {element(out, [place, place])} = {number(1.0)};")
    body.put("}")
    return out


def _diag(_: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    of = body.held(values[0])
    if len(values) != 1 or not isinstance(of.kind, Array) or of.kind.dims != 1:
        body.refuse(node, "only numbers in a row are made a diagonal")
    out = made(kind, [f"{of.code}.size0"] * 2, body)
    for_each(of, body, lambda places: f"{element(out, places * 2)} = {element(of, places)};")
    return out


def _array(_: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    """Return an array of numbers, or of the fields of a struct."""
    if len(values) == 1 and isinstance(values[0].kind, Struct):
        held = body.held(values[0])
        values = [Value(f"{held.code}.{c_name(name)}", each) for name, each in values[0].kind.fields]
    if any(value.kind not in NUMBERS for value in values) or {value.kind for value in values} == {INT}:
        body.refuse(node, "an array of what are no doubles")
    numbers = [body.temporary(value).code for value in values]  # before the array: they may be made of it
    out = made(kind, [str(len(values))], body)
    for place, code in enumerate(numbers):
        body.put(f"{element(out, [str(place)])} = {code};")
    return out


def _like(_: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    of = body.held(values[0])
    if not isinstance(of.kind, Array):
        body.refuse(node, "only of an array another one like it is made")
    del kind
    return made(of.kind.element, sizes_of(of), body)


def _copy(owner: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    of = body.held(values[0] if owner is None else owner)
    if not isinstance(of.kind, Array) or len(values) > (owner is None):
        body.refuse(node, "only an array is copied, and as it is")
    del kind
    return _copied(of, body)


def _stack(_: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    rows = [body.held(each) for each in values]
    if any(not isinstance(row.kind, Array) or row.kind.dims != 1 for row in rows):
        body.refuse(node, "only numbers in rows are stacked")
    out = made(kind, [str(len(rows)), f"{rows[0].code}.size0"], body)
    for i, row in enumerate(rows):
        _put_row(out, i, row, body)
    return out


def _put_row(out: Value, i: int, row: Value, body: Body) -> None:
    for_each(row, body, lambda places: f"{element(out, [str(i), *places])} = {element(row, places)};")


def _reshape(owner: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    del kind
    if owner is None or owner.kind != Array(1) or len(values) != 2:
        body.refuse(node, "only an array of one dimension is given two")
    if values[1].code.startswith("(-"):
        body.refuse(node, "the second size must be told")
    a, columns = body.held(owner), body.held(values[1])
    rows = f"{a.code}.size0 / {columns.code}" if values[0].code == "(-1)" else values[0].code
    return Value(f"({Array(2).c}){{{a.code}.at, {rows}, {columns.code}, {columns.code}}}", Array(2))


def _sum(owner: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    del kind
    if owner is None or values:
        body.refuse(node, "only all of an array is added up")
    if not isinstance(owner.kind, Array) or owner.kind.element != DOUBLE:
        body.refuse(node, "only doubles are added up")
    a, total = body.held(owner), body.temporary(Value(number(0.0), DOUBLE))
    for_each(a, body, lambda places: f"{total.code} += {element(a, places)};")
    return total


def _min(owner: Value | None, values: list[Value], kind: Scalar, node: ast.AST, body: Body) -> Value:
    del kind
    if owner is None or values or owner.kind != Array(1):
        body.refuse(node, "only of one row of numbers the least one is taken")
    a = body.held(owner)
    body.uses_arena = True
    body.put(f"if ({a.code}.size0 == 0) {{ arena->unequal = true; }}")
    least = body.temporary(Value(f"({a.code}.size0 == 0 ? NAN : {element(a, ['0'])})", DOUBLE))
    for_each(a, body, lambda places: f"{least.code} = hf_least({least.code}, {element(a, places)});")
    return least


ARRAY_CALLS: dict[Any, _Call] = {
    np.empty: _blank,
    np.zeros: _blank,
    np.ones: _ones,
    np.eye: _eye,
    np.full: _full,
    np.array: _array,
    np.diag: _diag,
    np.stack: _stack,
    np.empty_like: _like,
    np.zeros_like: _like,
    np.ascontiguousarray: _copy,
    "copy": _copy,
    "reshape": _reshape,
    "sum": _sum,
    "min": _min,
}
