"""Who owns an array within kernels: what counts no references hands no array on, for that would be freed twice.

numba can't tell. So annotations are read: of `subroutine` and `inlined`, which count none. `as_its_caller` isn't looked
at: given arrays it makes some, and that doesn't compile where references aren't counted.
"""

import ast
from functools import cache
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[3]
UNCOUNTED = {"subroutine", "inlined"}
COUNTED = {"kernel", "with_work_arrays", "returning_arrays"}
ARRAYS = {"Vector", "Matrix", "NDArray", "Flags", "Mask", "Columns", "Gains"}


class Function(NamedTuple):
    """A function that is compiled for kernels."""

    where: str
    decorator: str
    node: ast.FunctionDef

    @property
    def returned(self) -> set[str]:
        """Names in what it returns."""
        return {n.id for n in ast.walk(self.node.returns or ast.Constant(None)) if isinstance(n, ast.Name)}


@cache
def _trees() -> tuple[tuple[Path, ast.Module], ...]:
    paths = [path for package in ("hil_forceps", "virtual_bus") for path in (ROOT / package).rglob("*.py")]
    return tuple((path, ast.parse(path.read_text(encoding="utf-8"))) for path in paths)


def _holders() -> set[str]:
    """Return names of arrays, and of tuples that hold any, by themselves or by others."""
    fields = {
        node.name: {n.id for item in node.body for n in ast.walk(item) if isinstance(n, ast.Name)}
        for _, tree in _trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and any(isinstance(b, ast.Name) and b.id == "NamedTuple" for b in node.bases)
    }
    holders = set(ARRAYS)
    while more := {name for name, used in fields.items() if used & holders} - holders:
        holders |= more
    return holders


def _functions() -> list[Function]:
    return [
        Function(f"{path.relative_to(ROOT)}: {node.name}", decorator.id, node)
        for path, tree in _trees()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        for decorator in node.decorator_list
        if isinstance(decorator, ast.Name) and decorator.id in {*UNCOUNTED, *COUNTED}
    ]


def test_what_counts_no_references_returns_no_array() -> None:
    functions, holders = _functions(), _holders()
    assert {"Stepper", "Linear", "Work"} <= holders
    assert len(functions) > 150
    handed_on = [f.where for f in functions if f.decorator in {*UNCOUNTED, "with_work_arrays"} and f.returned & holders]
    assert handed_on == []


def test_what_counts_no_references_gets_no_array_from_others() -> None:
    functions, holders = _functions(), _holders()
    givers = {f.node.name for f in functions if f.decorator in COUNTED and f.returned & holders}
    assert {"transition", "_transitions"} <= givers
    takers = [
        f"{f.where} calls {node.func.id}"
        for f in functions
        if f.decorator in UNCOUNTED
        for node in ast.walk(f.node)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in givers
    ]
    assert takers == []
