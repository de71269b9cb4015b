"""Elements and parts of arrays, and of tuples."""

import ast
from collections.abc import Callable

from hil_forceps.kernels.translation.code import Body, Value, c_name
from hil_forceps.kernels.translation.types import INT, Array, Struct

_Translate = Callable[[ast.expr], Value]


def subscript(of: Value, index: ast.expr, node: ast.expr, body: Body, translate: _Translate) -> Value:
    """Return an element or a part of an array, or an element of a tuple."""
    if isinstance(of.kind, Struct):
        return _of_tuple(of, of.kind, index, node, body, translate)
    if not isinstance(of.kind, Array):
        body.refuse(node, f"{of.kind.c} has no places")
    a, kind = body.held(of), of.kind
    places = index.elts if isinstance(index, ast.Tuple) else [index]
    offsets, kept = [], []  # axes that stay: their number, and their size
    for axis, place in enumerate(places):
        step = kind.step(a.code, axis)
        if isinstance(place, ast.Slice):
            first, end = _ends(place, f"{a.code}.size{axis}", node, body, translate)
            offsets += [] if first == "0" else [_times(first, step)]
            kept.append((axis, end if first == "0" else f"hf_span({first}, {end})"))
        else:
            offsets.append(_times(_place(place, a, axis, body, translate), step))
    if len(places) < kind.dims or kept:
        kept += [(axis, f"{a.code}.size{axis}") for axis in range(len(places), kind.dims)]
        return _view(a.code, kind, offsets, kept)
    return Value(f"{a.code}.at[{' + '.join(offsets)}]", kind.element)


def element(a: Value, places: list[str]) -> str:
    """Return an element of an array, of which a place is given along each dimension."""
    assert isinstance(a.kind, Array)
    return f"{a.code}.at[{' + '.join(_times(i, a.kind.step(a.code, axis)) for axis, i in enumerate(places))}]"


def transposed(of: Value, body: Body) -> Value:
    """Return a view of an array with two dimensions, the other way round."""
    a = body.held(of)
    assert isinstance(a.kind, Array)
    return _view(a.code, a.kind, [], [(1, f"{a.code}.size1"), (0, f"{a.code}.size0")])


def _view(code: str, kind: Array, offsets: list[str], kept: list[tuple[int, str]]) -> Value:
    steps = [kind.step(code, axis) for axis, _ in kept]
    part = Array(len(kept), kind.element, stepped=steps[-1] != "1")
    at = " + ".join([f"{code}.at", *offsets])
    fields = [at, *(size for _, size in kept), *(steps if part.stepped else steps[:-1])]
    return Value(f"({part.c}){{{', '.join(fields)}}}", part)


def _of_tuple(of: Value, kind: Struct, index: ast.expr, node: ast.expr, body: Body, translate: _Translate) -> Value:
    if isinstance(index, ast.Constant) and isinstance(index.value, int) and 0 <= index.value < len(kind.fields):
        name, field = kind.fields[index.value]
        return Value(f"{of.code}.{c_name(name)}", field)
    kinds = {each for _, each in kind.fields}
    if len(kinds) != 1:
        body.refuse(node, "the place in a tuple of several types must be a number")
    held, found = body.held(of), translate(index)
    if found.kind != INT:
        body.refuse(node, "a place must be an integer")
    place = body.temporary(Value(_counted(index, found.code, str(len(kind.fields))), INT))
    code = f"{held.code}.{kind.fields[-1][0]}"
    for i, (name, _) in reversed(list(enumerate(kind.fields[:-1]))):
        code = f"({place.code} == {i} ? {held.code}.{name} : {code})"
    return Value(code, kinds.pop())


def _times(place: str, step: str) -> str:
    return place if step == "1" else f"{place} * {step}"


def _place(node: ast.expr, a: Value, axis: int, body: Body, translate: _Translate) -> str:
    """Return a place; one that may be negative is counted from the end. Variables hold places from 0 on."""
    value = translate(node)
    if value.kind != INT:
        body.refuse(node, "a place must be an integer")
    return _counted(node, value.code, f"{a.code}.size{axis}")


def _counted(node: ast.expr, code: str, size: str) -> str:
    differs = any(isinstance(each, ast.Sub | ast.USub) for each in ast.walk(node))
    return f"hf_place({code}, {size})" if differs or "-" in code else code


def _ends(part: ast.Slice, size: str, node: ast.expr, body: Body, translate: _Translate) -> tuple[str, str]:
    if part.step is not None:
        body.refuse(node, "a step of a slice is not translated")
    first = "0" if part.lower is None else f"hf_end({translate(part.lower).code}, {size})"
    return first, size if part.upper is None else f"hf_end({translate(part.upper).code}, {size})"
