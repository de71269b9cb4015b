"""Statements of kernels as C."""

import ast
from collections.abc import Iterator
from contextlib import contextmanager

from hil_forceps.kernels.translation.array_calls import fill
from hil_forceps.kernels.translation.code import Body, Value, c_name
from hil_forceps.kernels.translation.expressions import (
    Program,
    cast,
    condition,
    constant,
    expression,
    operation,
    pack,
    static,
)
from hil_forceps.kernels.translation.types import (
    BOOL,
    DOUBLE,
    FLOAT,
    INT,
    NUMBERS,
    Array,
    Struct,
    Type,
    has_array,
    joined,
    tuple_of,
)


def statements(nodes: list[ast.stmt], body: Body, program: Program) -> None:
    """Put statements into a body."""
    for node in nodes:
        _statement(node, body, program)


def _statement(node: ast.stmt, body: Body, program: Program) -> None:
    match node:
        case ast.Expr(value=ast.Constant()) | ast.Pass():  # a docstring
            pass
        case ast.Expr(value=call):
            body.put(f"{expression(call, body, program).code};")
        case ast.AnnAssign(target=ast.Name() as target, value=ast.expr() as given):
            assign(target, _annotated(node, expression(given, body, program), body), body, program)
        case ast.Assign(targets=targets, value=given):
            _assign_all(targets, given, body, program)
        case ast.AugAssign(target=target, op=operator, value=given):
            before = expression(_read(target), body, program)
            after = operation(operator, before, expression(given, body, program), node, body)
            if isinstance(before.kind, Array):
                fill(before, after, node, body)
            else:
                assign(target, after, body, program)
        case ast.Return(value=given):
            _give_back(given, node, body, program)
        case ast.If(test=test, body=yes, orelse=no):
            body.put(f"if ({condition(test, body, program).code}) {{")
            _block(yes, body, program)
            if no:
                body.put("} else {")
                _block(no, body, program)
            body.put("}")
        case ast.While(test=test, body=inner, orelse=[]):
            with _loop("while (true) {", node, body):
                body.put(f"if (!{condition(test, body, program).code}) {{ break; }}")
                statements(inner, body, program)
        case ast.For(orelse=[]):
            _for(node, body, program)
        case ast.Break():
            body.put("break;")
        case ast.Continue():
            body.put("continue;")
        case _:
            body.refuse(node, "is not translated")


def _block(nodes: list[ast.stmt], body: Body, program: Program) -> None:
    body.depth += 1
    statements(nodes, body, program)
    body.depth -= 1


def _read(target: ast.expr) -> ast.expr:
    """Return what is assigned to, as what is read."""
    return ast.parse(ast.unparse(target), mode="eval").body


def _annotated(node: ast.AnnAssign, value: Value, body: Body) -> Value:
    wanted = {"float": DOUBLE, "int": INT, "bool": BOOL}.get(ast.unparse(node.annotation))
    return value if wanted is None else cast(value, wanted, node, body)


def _assign_all(targets: list[ast.expr], given: ast.expr, body: Body, program: Program) -> None:
    if len(targets) == 1 and isinstance(targets[0], ast.Tuple) and isinstance(given, ast.Tuple):
        pairs = list(zip(targets[0].elts, given.elts, strict=True))
        # All of the right side first: it may name what stands on the left.
        values = [body.temporary(expression(each, body, program)) for _, each in pairs]
        for (target, _), value in zip(pairs, values, strict=True):
            assign(target, value, body, program)
        return
    value = expression(given, body, program)
    if len(targets) > 1:
        value = body.temporary(value)
    for target in targets:
        assign(target, value, body, program)


def assign(target: ast.expr, value: Value, body: Body, program: Program) -> None:
    """Put an assignment into a body; a name that is new becomes a variable."""
    match target:
        case ast.Name(id="_"):
            body.put(f"(void){value.code};")
        case ast.Name(id=name):
            kind = body.variables.setdefault(name, value.kind)
            assert name not in body.by_address
            if joined(kind, value.kind) != kind:
                body.refuse(target, f"{kind.c} becomes {value.kind.c}")
            body.put(f"{c_name(name)} = {cast(value, kind, target, body).code};")
        case ast.Tuple(elts=parts):
            held = body.temporary(value)
            if not isinstance(held.kind, Struct) or len(held.kind.fields) != len(parts):
                body.refuse(target, "is not as many values")
            for part, (name, kind) in zip(parts, held.kind.fields, strict=True):
                assign(part, Value(f"{held.code}.{c_name(name)}", kind), body, program)
        case ast.Subscript():
            place = expression(_read(target), body, program)
            if isinstance(place.kind, Array):
                fill(place, value, target, body)
            else:
                body.put(f"{place.code} = {_stored(value, place.kind, target, body)};")
        case _:
            body.refuse(target, "can't be assigned to")


def _stored(value: Value, kind: Type, target: ast.expr, body: Body) -> str:
    """Return a value as an element of an array, which may have fewer digits."""
    if kind == FLOAT and value.kind in NUMBERS:
        return f"(float){value.code}"
    return cast(value, kind, target, body).code


def _give_back(given: ast.expr | None, node: ast.AST, body: Body, program: Program) -> None:
    if given is None:
        body.put("RETURN;")
        return
    value = expression(given, body, program)
    kind = value.kind if body.returned is None else joined(body.returned, value.kind)
    if kind is None or body.returned not in {None, kind}:
        body.refuse(node, "several types are returned")
    body.returned = kind
    body.put(f"RETURN {cast(value, kind, node, body).code};")


def _for(node: ast.For, body: Body, program: Program) -> None:
    if isinstance(node.iter, ast.Tuple):
        _unrolled(node, [(each, None) for each in node.iter.elts], body, program)
        return
    if isinstance(node.iter, ast.Call) and static(node.iter.func, body) is zip:
        lists = [static(each, body) for each in node.iter.args]
        together = list(zip(*lists, strict=True))
        _unrolled(node, [(None, constant(each, node, body, program)) for each in together], body, program)
        return
    called = static(node.iter.func, body) if isinstance(node.iter, ast.Call) else None
    if called is not range or not isinstance(node.iter, ast.Call) or not isinstance(node.target, ast.Name):
        body.refuse(node, "only a range or a tuple is gone through")
    given = node.iter.args
    if len(given) > 2 and not isinstance(_number_of(given[2]), int):
        body.refuse(node, "the step of a range must be a number")
    bounds = [body.temporary(cast(expression(each, body, program), INT, node, body)) for each in given[:2]]
    step = _number_of(given[2]) if len(given) > 2 else 1
    first, end = ("0", bounds[0].code) if len(bounds) == 1 else (bounds[0].code, bounds[1].code)
    counter = body.name()  # behind the loop, and where it is changed within, the variable is Python's
    sign = "<" if step is not None and step > 0 else ">"
    with _loop(f"for (int64_t {counter} = {first}; {counter} {sign} {end}; {counter} += {step}) {{", node, body):
        if node.target.id != "_":
            assign(node.target, Value(counter, INT), body, program)
        statements(node.body, body, program)


def _number_of(node: ast.expr) -> int | None:
    try:
        value = ast.literal_eval(node)
    except ValueError:
        return None
    return value if isinstance(value, int) else None


def _unrolled(node: ast.For, cases: list[tuple[ast.expr | None, Value | None]], body: Body, program: Program) -> None:
    """Put a few cases in, one after another; what they are is computed before the first."""
    if any(isinstance(each, ast.Break | ast.Continue) for each in _own(node.body)):
        body.refuse(node, "of a few cases none can be left out")
    values: list[Value] = []
    for each, known in cases:
        if isinstance(each, ast.Tuple):
            parts = [body.temporary(expression(part, body, program)) for part in each.elts]
            values.append(pack(program.use(tuple_of(tuple(part.kind for part in parts))), parts))
        elif each is not None:
            values.append(body.temporary(expression(each, body, program)))
        elif known is not None:
            values.append(known)
    for value in values:
        assign(node.target, value, body, program)
        statements(node.body, body, program)


def _own(nodes: list[ast.stmt]) -> Iterator[ast.AST]:
    """Yield statements, and those within them that are in no loop of their own."""
    for node in nodes:
        yield node
        if isinstance(node, ast.If):
            yield from _own([*node.body, *node.orelse])


@contextmanager
def _loop(head: str, node: ast.For | ast.While, body: Body) -> Iterator[None]:
    """Put a loop into a body; what is put in within is gone through again and again.

    Each time the arena is as before, where no variable can hold an array that was made there.
    """
    before, body.lines = body.lines, []
    body.depth += 1
    yield
    body.depth -= 1
    inner, body.lines = body.lines, before
    stored = {each.id for each in ast.walk(node) if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)}
    makes = any("arena" in line for line in inner)
    if makes and not any(has_array(body.variables[name]) for name in stored & set(body.variables)):
        mark = body.name()
        body.put(f"size_t {mark} = arena->used;")
        inner.insert(0, "    " * (body.depth + 1) + f"arena->used = {mark};")
    body.put(head)
    body.lines += inner
    body.put("}")
