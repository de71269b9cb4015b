"""Expressions of kernels as C."""

import ast
import builtins
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np

from hil_forceps.kernels.translation.array_calls import ARRAY_CALLS, elementwise, sizes_of
from hil_forceps.kernels.translation.code import Body, Value, c_name
from hil_forceps.kernels.translation.numbers import arithmetic, function_of_numbers, number
from hil_forceps.kernels.translation.types import (
    BOOL,
    DOUBLE,
    INT,
    NUMBERS,
    Array,
    Scalar,
    Struct,
    Type,
    by_address,
    joined,
    of_dtype,
    tuple_of,
)
from hil_forceps.kernels.translation.views import subscript, transposed

_COMPARISONS = {ast.Eq: "==", ast.NotEq: "!=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">="}


class Program(Protocol):
    """What expressions ask of the program that they are part of."""

    def call(self, function: Callable[..., object], arguments: list[Value], body: Body) -> Value:
        """Return a call of a kernel, which is translated for it."""

    def struct(self, named_tuple: type, kinds: list[Type]) -> Struct:
        """Return the struct of a named tuple."""

    def use(self, struct: Struct) -> Struct:
        """Return a struct, which is declared."""

    def constant(self, array: np.ndarray[Any, np.dtype[np.float64]]) -> Value:
        """Return an array that never changes."""


class Unknown:
    """What a name means that is known only when the program runs."""


def static(node: ast.expr, body: Body) -> object:
    """Return what a name means in the kernel's own module or closure; `Unknown` for a variable."""
    if isinstance(node, ast.Name):
        if node.id in body.variables:
            return Unknown
        code, cells = body.function.__code__, body.function.__closure__ or ()
        if node.id in code.co_varnames:
            body.refuse(node, "is read before it is given a value")
        if node.id in code.co_freevars:
            return cells[code.co_freevars.index(node.id)].cell_contents
        return body.function.__globals__.get(node.id, getattr(builtins, node.id, Unknown))
    if isinstance(node, ast.Attribute):
        owner = static(node.value, body)
        return Unknown if owner is Unknown else getattr(owner, node.attr, Unknown)
    return Unknown


def expression(node: ast.expr, body: Body, program: Program) -> Value:
    """Return an expression as C; what has to happen before it is put into `body`."""
    known = static(node, body)
    if known is not Unknown:
        return constant(known, node, body, program)
    match node:
        case ast.Constant(value=value):
            return constant(value, node, body, program)
        case ast.Name(id=name):
            if name not in body.variables:
                body.refuse(node, "is not known here")
            read = f"(*{c_name(name)})" if name in body.by_address else c_name(name)
            return Value(read, body.variables[name])
        case ast.Attribute(value=owner, attr=name):
            return _attribute(expression(owner, body, program), name, node, body, program)
        case ast.Subscript(value=owner, slice=index):
            of = expression(owner, body, program)
            return subscript(of, index, node, body, lambda each: expression(each, body, program))
        case ast.Tuple(elts=elements):
            values = [expression(each, body, program) for each in elements]
            return pack(program.use(tuple_of(tuple(value.kind for value in values))), values)
        case ast.IfExp(test=test, body=yes, orelse=no):
            return _choice(test, yes, no, node, body, program)
        case ast.Call():
            return _call(node, body, program)
        case ast.Compare() | ast.BoolOp():
            return condition(node, body, program)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return Value(f"!{condition(operand, body, program).code}", BOOL)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            positive = expression(operand, body, program)
            if isinstance(positive.kind, Array):
                return elementwise(ast.Mult(), Value(number(-1.0), DOUBLE), positive, node, body)
            return Value(f"(-{positive.code})", positive.kind)
        case ast.BinOp(left=left, op=operator, right=right):
            first, second = expression(left, body, program), expression(right, body, program)
            return operation(operator, first, second, node, body)
    body.refuse(node, "is not translated")


def operation(operator: ast.operator, a: Value, b: Value, node: ast.AST, body: Body) -> Value:
    """Return an operation on numbers or arrays."""
    if isinstance(a.kind, Array) or isinstance(b.kind, Array):
        return elementwise(operator, a, b, node, body)
    return arithmetic(operator, a, b, node, body)


def constant(value: object, node: ast.AST, body: Body, program: Program) -> Value:
    """Return a value that Python knows already."""
    match value:
        case bool():
            return Value("true" if value else "false", BOOL)
        case int():
            return Value(f"({value})" if value < 0 else str(value), INT)
        case float():
            return Value(number(value), DOUBLE)
        case np.ndarray():
            return program.constant(value)
        case tuple() if hasattr(value, "_fields"):
            fields = [constant(each, node, body, program) for each in value]
            return pack(program.struct(type(value), [field.kind for field in fields]), fields)
        case tuple():
            fields = [constant(each, node, body, program) for each in value]
            return pack(program.use(tuple_of(tuple(field.kind for field in fields))), fields)
    body.refuse(node, f"a constant of type {type(value).__name__} is not translated")


def pack(struct: Struct, values: list[Value]) -> Value:
    """Return a struct of values."""
    return Value(f"({struct.c}){{{', '.join(value.code for value in values)}}}", struct)


def cast(value: Value, kind: Type, node: ast.AST, body: Body) -> Value:
    """Return a value as another type; NotImplementedError where that would lose something."""
    if value.kind == kind:
        return value
    if value.kind in NUMBERS and kind == DOUBLE:
        return Value(f"(double){value.code}", DOUBLE)
    if isinstance(kind, Array) and joined(kind, value.kind) == kind:
        a = body.held(value)
        assert isinstance(a.kind, Array)
        steps = [a.kind.step(a.code, axis) for axis in range(kind.dims)]
        return Value(f"({kind.c}){{{', '.join([f'{a.code}.at', *sizes_of(a), *steps])}}}", kind)
    body.refuse(node, f"{value.kind.c} where {kind.c} is expected")


def condition(node: ast.expr, body: Body, program: Program) -> Value:
    """Return a truth value."""
    match node:
        case ast.BoolOp(op=operator, values=parts):
            return _joined_conditions(operator, parts, body, program)
        case ast.Compare(left=left, ops=[ast.In()], comparators=[ast.Set(elts=members) | ast.Tuple(elts=members)]):
            value = expression(left, body, program)
            equal = [f"{value.code} == {expression(member, body, program).code}" for member in members]
            return Value(f"({' || '.join(equal)})", BOOL)
        case ast.Compare(left=left, ops=operators, comparators=others):
            values = [expression(each, body, program) for each in (left, *others)]
            values[1:-1] = [body.held(each) for each in values[1:-1]]  # read twice
            signs = [_COMPARISONS.get(type(each)) for each in operators]
            if None in signs or any(not isinstance(value.kind, Scalar) for value in values):
                body.refuse(node, "a comparison that is not translated")
            pairs = zip(values, signs, values[1:], strict=False)
            return Value(f"({' && '.join(f'{a.code} {sign} {b.code}' for a, sign, b in pairs)})", BOOL)
    value = expression(node, body, program)
    if value.kind != BOOL:
        body.refuse(node, "must be a truth value")
    return value


def _attribute(owner: Value, name: str, node: ast.AST, body: Body, program: Program) -> Value:
    if isinstance(owner.kind, Array):
        held = body.held(owner)
        if name == "T" and owner.kind.dims == 2:
            return transposed(held, body)
        sizes = sizes_of(held)
        if name == "size":
            return Value(f"({' * '.join(sizes)})", INT)
        if name == "shape":
            shape = [Value(size, INT) for size in sizes]
            return pack(program.use(tuple_of((INT,) * owner.kind.dims)), shape)
    if isinstance(owner.kind, Struct):
        for field, kind in owner.kind.fields:
            if field == name:
                return Value(f"{owner.code}.{c_name(name)}", kind)
    body.refuse(node, f"{owner.kind.c} has no {name}")


def _choice(test: ast.expr, yes: ast.expr, no: ast.expr, node: ast.AST, body: Body, program: Program) -> Value:
    asked = condition(test, body, program)
    a, for_a = body.apart(lambda: expression(yes, body, program))
    b, for_b = body.apart(lambda: expression(no, body, program))
    kind = joined(a.kind, b.kind)
    if kind is None:
        body.refuse(node, "two types")
    if not for_a and not for_b:
        return Value(f"({asked.code} ? {cast(a, kind, node, body).code} : {cast(b, kind, node, body).code})", kind)
    chosen = body.undecided(kind)
    for head, lines, value in ((f"if ({asked.code}) {{", for_a, a), ("} else {", for_b, b)):
        body.put(head)
        body.lines += [f"    {line}" for line in lines]
        body.put(f"    {chosen.code} = {cast(value, kind, node, body).code};")
    body.put("}")
    return chosen


def _joined_conditions(operator: ast.boolop, parts: list[ast.expr], body: Body, program: Program) -> Value:
    """Return conditions of which a later one is looked at only if the ones before leave it open."""
    sign, goes_on = (" && ", "") if isinstance(operator, ast.And) else (" || ", "!")
    code = condition(parts[0], body, program).code
    for part in parts[1:]:
        value, lines = body.apart(partial(condition, part, body, program))
        if lines:
            so_far = body.temporary(Value(code, BOOL))
            body.put(f"if ({goes_on}{so_far.code}) {{")
            body.lines += [f"    {line}" for line in lines]
            body.put(f"    {so_far.code} = {value.code};")
            body.put("}")
            code = so_far.code
        else:
            code = f"{code}{sign}{value.code}"
    return Value(f"({code})", BOOL)


def _call(node: ast.Call, body: Body, program: Program) -> Value:
    called = static(node.func, body)
    if called is Unknown and isinstance(node.func, ast.Attribute):
        return _of_arrays(node.func.attr, expression(node.func.value, body, program), node, body, program)
    if called in ARRAY_CALLS:
        return _of_arrays(called, None, node, body, program)
    if node.keywords:
        body.refuse(node, "keywords are not translated")
    arguments = _arguments(node.args, body, program)
    if isinstance(called, type) and hasattr(called, "_fields"):
        return pack(program.struct(called, [each.kind for each in arguments]), arguments)
    if (simple := function_of_numbers(called, arguments)) is not None:
        return simple
    function = getattr(called, "py_func", called)
    if not inspect.isfunction(function):
        body.refuse(node, "a call that is not translated")
    return program.call(function, arguments, body)


def _of_arrays(called: object, owner: Value | None, node: ast.Call, body: Body, program: Program) -> Value:
    kind = DOUBLE
    for keyword in node.keywords:
        if keyword.arg != "dtype" or called not in {np.empty, np.zeros, np.ones}:
            body.refuse(node, "keywords but the dtype of new arrays are not translated")
        kind = of_dtype(static(keyword.value, body))
    given = node.args[0].elts if node.args and isinstance(node.args[0], ast.Tuple | ast.List) else node.args
    rest = node.args[1:] if given is not node.args else []
    values = [expression(each, body, program) for each in (*given, *rest)]
    if called not in ARRAY_CALLS:
        body.refuse(node, "a call that is not translated")
    return ARRAY_CALLS[called](owner, values, kind, node, body)


def passed(value: Value, body: Body) -> str:
    """Return a value as it is handed to a function."""
    if not by_address(value.kind):
        return value.code
    return f"&{body.held(value).code}"


def _arguments(nodes: list[ast.expr], body: Body, program: Program) -> list[Value]:
    """Return arguments, with what stands behind a star taken apart."""
    arguments: list[Value] = []
    for each in nodes:
        if not isinstance(each, ast.Starred):
            arguments.append(expression(each, body, program))
        elif isinstance(each.value, ast.Call) and getattr(static(each.value.func, body), "__name__", "") == (
            "to_fixed_tuple"
        ):
            source = body.temporary(expression(each.value.args[0], body, program))
            count = static(each.value.args[1], body)
            assert isinstance(count, int)
            arguments += [Value(f"{source.code}.at[{i}]", DOUBLE) for i in range(count)]
        else:
            whole = expression(each.value, body, program)
            if not isinstance(whole.kind, Struct):
                body.refuse(each, "only a tuple can be taken apart")
            held = body.held(whole)
            arguments += [Value(f"{held.code}.{c_name(name)}", kind) for name, kind in whole.kind.fields]
    return arguments
