"""Numbers: how C writes them, operations on them, and the functions of them that C or arrays.h has."""

import ast
import math

import numpy as np

from hil_forceps.kernels.translation.code import Body, Value
from hil_forceps.kernels.translation.types import BOOL, DOUBLE, FLOAT, INT, NUMBERS, Scalar, joined

_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*"}
_BITS = {ast.BitAnd: "&", ast.BitOr: "|"}
_OF_MATH = ("sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "atan2", "tanh", "erf", "erfc", "hypot", "copysign")


def number(value: float) -> str:
    """Return a double as C writes it, exactly."""
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "(-INFINITY)"
    if math.isnan(value):
        return "NAN"
    return f"({float(value)!r})" if value < 0.0 else repr(float(value))


def arithmetic(operator: ast.operator, a: Value, b: Value, node: ast.AST, body: Body) -> Value:
    """Return an operation on numbers."""
    kind = joined(a.kind, b.kind)
    if not isinstance(kind, Scalar) or kind not in NUMBERS:
        body.refuse(node, f"{a.kind.c} and {b.kind.c} are not translated together")
    if kind == DOUBLE and DOUBLE not in {a.kind, b.kind}:  # float and int: C would compute in float
        a = Value(f"(double){a.code}", DOUBLE)
    elif kind == INT and a.code.isdigit():  # C's int is shorter
        a = Value(f"(int64_t){a.code}", INT)
    match operator:
        case ast.Add() | ast.Sub() | ast.Mult():
            return Value(f"({a.code} {_OPERATORS[type(operator)]} {b.code})", kind)
        case ast.Div():
            if kind == FLOAT:
                return Value(f"({a.code} / {b.code})", FLOAT)
            return Value(f"((double){a.code} / (double){b.code})" if kind == INT else f"({a.code} / {b.code})", DOUBLE)
        case ast.FloorDiv() if kind == INT:
            return Value(f"hf_floor_div({a.code}, {b.code})", INT)
        case ast.Mod() if kind == INT:
            return Value(f"hf_floor_mod({a.code}, {b.code})", INT)
        case ast.BitAnd() | ast.BitOr() if kind == INT:
            return Value(f"({a.code} {_BITS[type(operator)]} {b.code})", INT)
        case ast.Pow() if b.kind == INT and a.kind == DOUBLE:
            if b.code == "2":
                return Value(f"hf_square({a.code})", DOUBLE)
            return Value(f"hf_power({a.code}, {b.code})", DOUBLE)
        case ast.Pow() if kind == DOUBLE and FLOAT not in {a.kind, b.kind}:
            return Value(f"pow({a.code}, {b.code})", DOUBLE)
    body.refuse(node, "an operation that is not translated")


def function_of_numbers(called: object, arguments: list[Value]) -> Value | None:
    """Return a call of a function that C or arrays.h has; None for any other."""
    codes = ", ".join(each.code for each in arguments)
    kinds = {each.kind for each in arguments}
    if called in {min, max}:
        name = "hf_min" if called is min else "hf_max"
        kind = INT if kinds == {INT} else DOUBLE
        name = f"{name}_int" if kind == INT else name
        code = arguments[0].code
        for other in arguments[1:]:
            code = f"{name}({code}, {other.code})"
        return Value(code, kind)
    if called is abs and kinds == {DOUBLE}:
        return Value(f"fabs({codes})", DOUBLE)
    if called is float:
        return Value(f"(double){codes}", DOUBLE)
    if called is round and len(arguments) == 1:
        return Value(f"hf_integer(rint({codes}))", INT)
    if called is int and kinds == {INT}:
        return arguments[0]
    if called is int:
        return Value(f"hf_integer(trunc({codes}))", INT)
    if called in {math.floor, math.ceil}:
        return Value(f"hf_integer({'floor' if called is math.floor else 'ceil'}({codes}))", INT)
    if called is np.sign:
        return Value(f"hf_sign({codes})", DOUBLE)
    if called is math.isnan:
        return Value(f"(bool)isnan({codes})", BOOL)
    if called is math.isfinite:
        return Value(f"(bool)isfinite({codes})", BOOL)
    for name in _OF_MATH:
        if called is getattr(math, name) or called is getattr(np, name, math):
            return Value(f"{name}({codes})", DOUBLE)
    return None
