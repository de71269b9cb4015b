"""A C program out of kernels: each is translated when it is first called, for the types that it is called with."""

import ast
import inspect
import textwrap
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any

import numpy as np

from hil_forceps.kernels.translation.code import Body, Value, c_name
from hil_forceps.kernels.translation.expressions import cast, passed
from hil_forceps.kernels.translation.numbers import number
from hil_forceps.kernels.translation.statements import statements
from hil_forceps.kernels.translation.types import (
    VOID,
    Array,
    Scalar,
    Struct,
    Type,
    by_address,
    has_array,
    joined,
    of_annotation,
)

_Function = Callable[..., object]


class Translation:
    """The program while it is put together: structs, constants and functions in the order that C wants."""

    def __init__(self) -> None:
        self._structs: dict[str, Struct] = {}
        self._kinds: dict[Type, None] = {}  # in the order in which they were met
        self._constants: dict[bytes, tuple[str, str]] = {}  # the text of each by its bytes
        self._functions: dict[tuple[_Function, tuple[Type, ...]], tuple[str, Type, bool]] = {}
        self._texts: list[str] = []

    def text(self) -> str:
        """Return the C text of all that was called."""
        declared: dict[str, str] = {}
        for kind in self._kinds:
            _declare(kind, declared)
        constants = [text for _, text in self._constants.values()]
        return "\n".join([*declared.values(), *constants, "", *self._texts])

    def entry(self, function: _Function, kinds: Sequence[Type], name: str) -> None:
        """Translate a function that is called from outside, under a name of its own.

        It takes an arena, and then arguments: numbers, and the addresses of all else.
        """
        for kind in kinds:
            self._note(kind)
        inner, returned, uses_arena = self._translated(getattr(function, "py_func", function), tuple(kinds))
        told = inspect.get_annotations(getattr(function, "py_func", function), eval_str=True).get("return")
        wanted = of_annotation(told) or VOID
        if not isinstance(returned, Scalar) or joined(wanted, returned) != wanted:
            raise NotImplementedError(f"{inner} returns {returned.c}, and says that it is {told}")
        given = "".join(f", {_outer(f'a{i}', kind)}" for i, kind in enumerate(kinds))
        handed_on = [
            f"*a{i}" if not isinstance(kind, Scalar) and not by_address(kind) else f"a{i}"
            for i, kind in enumerate(kinds)
        ]
        arena = "arena->used = 0;" if uses_arena else "(void)arena;"
        call = f"{inner}({', '.join([*(['arena'] if uses_arena else []), *handed_on])})"
        result = f"{call};" if returned == VOID else f"return {call};"
        self._texts.append(f"{wanted.c} {name}(Arena *arena{given}) {{\n    {arena}\n    {result}\n}}\n")

    def call(self, function: _Function, arguments: list[Value], body: Body) -> Value:
        """Return a call of a kernel."""
        hints = inspect.get_annotations(function, eval_str=True)
        names = list(inspect.signature(function).parameters)
        if len(names) != len(arguments):
            raise NotImplementedError(f"{body.where}: {function.__name__} takes {len(names)} values")
        given = []
        for name, argument in zip(names, arguments, strict=True):
            wanted = of_annotation(hints.get(name))
            given.append(argument if wanted is None else cast(argument, wanted, ast.Name(name), body))
        c, returned, uses_arena = self._translated(function, tuple(each.kind for each in given))
        body.uses_arena |= uses_arena
        codes = (["arena"] if uses_arena else []) + [passed(each, body) for each in given]
        return Value(f"{c}({', '.join(codes)})", returned)

    def struct(self, named_tuple: type, kinds: list[Type]) -> Struct:
        """Return the struct of a named tuple."""
        names = list(named_tuple._fields)  # type: ignore[attr-defined]
        hints = inspect.get_annotations(named_tuple, eval_str=True)
        if len(names) != len(kinds):
            raise NotImplementedError(f"{named_tuple.__name__} has {len(names)} fields, {len(kinds)} are given")
        fields: list[tuple[str, Type]] = []
        for name, kind in zip(names, kinds, strict=True):
            wanted = of_annotation(hints[name]) or kind
            if joined(wanted, kind) != wanted:
                raise NotImplementedError(f"{named_tuple.__name__}.{name} is {wanted.c}, not {kind.c}")
            fields.append((name, wanted))
        return self.use(Struct(named_tuple.__name__.lstrip("_"), tuple(fields)))

    def use(self, struct: Struct) -> Struct:
        """Return a struct, which is declared."""
        if self._structs.setdefault(struct.c, struct) != struct:
            raise NotImplementedError(f"two structs are called {struct.c}")
        self._note(struct)
        return struct

    def _note(self, kind: Type) -> None:
        self._kinds.setdefault(kind)
        if isinstance(kind, Struct):
            for _, each in kind.fields:
                self._note(each)

    def constant(self, array: np.ndarray[Any, np.dtype[np.float64]]) -> Value:
        """Return an array that never changes."""
        if array.dtype != np.float64:
            raise NotImplementedError("constant arrays hold doubles")
        data, kind = np.ascontiguousarray(array).ravel(), Array(array.ndim)
        self._note(kind)
        key = data.tobytes()
        if key not in self._constants:
            name = f"constant_{len(self._constants)}"
            numbers = textwrap.fill(", ".join(map(number, data.tolist())), 110)
            self._constants[key] = name, f"static double {name}[] = {{\n{textwrap.indent(numbers, '    ')}}};"
        steps = [int(np.prod(array.shape[axis + 1 :])) for axis in range(array.ndim - 1)]
        fields = [self._constants[key][0], *map(str, (*array.shape, *steps))]
        return Value(f"({kind.c}){{{', '.join(fields)}}}", kind)

    def _translated(self, function: _Function, kinds: tuple[Type, ...]) -> tuple[str, Type, bool]:
        key = (function, kinds)
        if key not in self._functions:
            self._functions[key] = self._translate(function, kinds)
        return self._functions[key]

    def _translate(self, function: _Function, kinds: tuple[Type, ...]) -> tuple[str, Type, bool]:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        assert isinstance(function, FunctionType)
        names = [each.arg for each in tree.args.args]
        types = dict(zip(names, kinds, strict=True))
        addressed = frozenset(name for name, kind in types.items() if by_address(kind))
        changed = addressed & _assigned(tree)
        where = f"{function.__module__}.{function.__name__}"
        body = Body(where, function, dict(types), by_address=addressed - changed)
        statements(tree.body, body, self)
        returned = body.returned or VOID
        for kind in (*body.variables.values(), returned, *body.made):
            self._note(kind)
        name = self._name(function)
        parameters = [
            _parameter(c_name(each) + ("_given" if each in changed else ""), kind) for each, kind in types.items()
        ]
        head = ", ".join([*(["Arena *arena"] if body.uses_arena else []), *parameters]) or "void"
        summary = (inspect.getdoc(function) or "").partition("\n")[0]
        comment = (
            f"/* {function.__module__}.{function.__qualname__} */" if not summary.isascii() else f"/* {summary} */"
        )
        lines = [comment, f"static {returned.c} {name}({head}) {{"]
        lines += [f"    {types[each].c} {c_name(each)} = *{c_name(each)}_given;" for each in sorted(changed)]
        lines += [f"    (void){c_name(each)};" for each in names]
        lines += [_variable(each, kind) for each, kind in body.variables.items() if each not in names]
        # What a kernel made and doesn't return is given back to the arena.
        frees = body.uses_arena and not has_array(returned)
        lines += ["    size_t arena_used_ = arena->used;"] if frees else []
        for line in body.lines:
            lines += _returning(line, returned, frees=frees)
        if frees and returned == VOID:
            lines.append("    arena->used = arena_used_;")
        self._texts.append("\n".join([*lines, "}", ""]))
        return name, returned, body.uses_arena

    def _name(self, function: _Function) -> str:
        module = function.__module__.removeprefix("hil_forceps.").replace(".", "_")
        taken = {name for name, _, _ in self._functions.values()}
        name = f"{module}_{function.__name__.lstrip('_')}"
        number_ = 1
        while name in taken:
            number_ += 1
            name = f"{module}_{function.__name__.lstrip('_')}_{number_}"
        return name


def _declare(kind: Type, declared: dict[str, str]) -> None:
    """Add the declaration of a type, behind those of what it is made of."""
    if isinstance(kind, Scalar) or kind.c in declared:
        return
    if isinstance(kind, Array):
        fields = f"    {kind.element.c} *at;\n    int64_t {', '.join(kind.fields)};\n"
    else:
        for _, each in kind.fields:
            _declare(each, declared)
        fields = "".join(f"    {each.c} {c_name(name)};\n" for name, each in kind.fields)
    declared[kind.c] = f"typedef struct {{\n{fields}}} {kind.c};\n"


def _assigned(tree: ast.FunctionDef) -> set[str]:
    """Return the names that a function assigns to."""
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def _outer(name: str, kind: Type) -> str:
    return f"{kind.c} {name}" if isinstance(kind, Scalar) else f"const {kind.c} *restrict {name}"


def _parameter(name: str, kind: Type) -> str:
    return f"const {kind.c} *restrict {name}" if by_address(kind) else f"{kind.c} {name}"


def _variable(name: str, kind: Type) -> str:
    return f"    {kind.c} {c_name(name)} = {'0' if not isinstance(kind, Struct | Array) else '{0}'};"


def _returning(line: str, returned: Type, *, frees: bool) -> list[str]:
    """Return a line with its return written out."""
    indent = line[: len(line) - len(line.lstrip())]
    if not line.lstrip().startswith("RETURN"):
        return [line]
    value = line.strip().removeprefix("RETURN").strip().removesuffix(";").strip()
    if not frees:
        return [f"{indent}return {value};" if value else f"{indent}return;"]
    if not value:
        return [f"{indent}arena->used = arena_used_;", f"{indent}return;"]
    return [
        f"{indent}{returned.c} returned_ = {value};",
        f"{indent}arena->used = arena_used_;",
        f"{indent}return returned_;",
    ]
