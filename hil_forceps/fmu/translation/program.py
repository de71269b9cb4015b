"""A C program out of kernels: each is translated when it is first called, for the types that it is called with."""

import ast
import inspect
import textwrap
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any

import numpy as np

from hil_forceps.fmu.translation.code import Body, Value, c_name
from hil_forceps.fmu.translation.expressions import cast
from hil_forceps.fmu.translation.numbers import number
from hil_forceps.fmu.translation.statements import statements
from hil_forceps.fmu.translation.types import (
    VOID,
    Array,
    Struct,
    Type,
    has_array,
    joined,
    of_annotation,
)

_Function = Callable[..., object]


class Translation:
    """The program while it is put together: structs, constants and functions in the order that C wants."""

    def __init__(self) -> None:
        self._structs: dict[str, Struct] = {}
        self._constants: dict[bytes, tuple[str, str]] = {}  # the text of each by its bytes
        self._functions: dict[tuple[_Function, tuple[Type, ...]], tuple[str, Type, bool]] = {}
        self._texts: list[str] = []

    def text(self) -> str:
        """Return the C text of all that was called."""
        structs = [_declaration(struct) for struct in self._structs.values()]
        constants = [text for _, text in self._constants.values()]
        return "\n".join([*structs, *constants, "", *self._texts])

    def entry(self, function: _Function, kinds: Sequence[Type], name: str) -> None:
        """Translate a function that is called from outside, under a name of its own."""
        inner, returned, uses_arena = self._translated(getattr(function, "py_func", function), tuple(kinds))
        given = ", ".join(f"{kind.c} a{i}" for i, kind in enumerate(kinds))
        passed = ", ".join(f"a{i}" for i in range(len(kinds)))
        arena = "arena->used = 0; " if uses_arena else "(void)arena; "
        call = f"{inner}({'arena, ' if uses_arena else ''}{passed})"
        self._texts.append(f"{returned.c} {name}(Arena *arena, {given}) {{\n    {arena}\n    return {call};\n}}\n")

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
        codes = (["arena"] if uses_arena else []) + [each.code for each in given]
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
        return struct

    def constant(self, array: np.ndarray[Any, np.dtype[np.float64]]) -> Value:
        """Return an array that never changes."""
        if array.ndim != 1:
            raise NotImplementedError("constant arrays have one dimension")
        data = np.ascontiguousarray(array, dtype=np.float64)
        key = data.tobytes()
        if key not in self._constants:
            name = f"constant_{len(self._constants)}"
            numbers = textwrap.fill(", ".join(map(number, data.tolist())), 110)
            self._constants[key] = name, f"static double {name}[] = {{\n{textwrap.indent(numbers, '    ')}}};"
        return Value(f"(Array1){{{self._constants[key][0]}, {data.size}}}", Array(1))

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
        body = Body(f"{function.__module__}.{function.__name__}", function, dict(zip(names, kinds, strict=True)))
        statements(tree.body, body, self)
        returned = body.returned or VOID
        name = self._name(function)
        parameters = [f"{kind.c} {c_name(each)}" for each, kind in zip(names, kinds, strict=True)]
        head = ", ".join([*(["Arena *arena"] if body.uses_arena else []), *parameters]) or "void"
        summary = (inspect.getdoc(function) or "").partition("\n")[0]
        comment = (
            f"/* {function.__module__}.{function.__qualname__} */" if not summary.isascii() else f"/* {summary} */"
        )
        lines = [comment, f"static {returned.c} {name}({head}) {{"]
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


def _declaration(struct: Struct) -> str:
    fields = "".join(f"    {kind.c} {c_name(name)};\n" for name, kind in struct.fields)
    return f"typedef struct {{\n{fields}}} {struct.c};\n"


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
