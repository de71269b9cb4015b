"""Write docs/architecture.md and its drawing from the import contracts; with `--check` only compare."""

import ast
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # it is run as a file
from tools.documents.layer_drawing import drawing

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "docs" / "architecture.md"
DRAWING = ROOT / "docs" / "images" / "layers.svg"
TEMPLATE = ROOT / "tools" / "documents" / "architecture_doc.template.md"


def main(arguments: list[str]) -> int:
    """Write the page, or with `--check` tell whether it is up to date."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    contracts = settings["contracts"]
    wanted = {TARGET: render(), DRAWING: drawing(layers_of(contracts), open_to_the_world(contracts))}
    stale = [path for path, text in wanted.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    if arguments == ["--check"]:
        for path in stale:
            print(f"{path} is out of date; run python tools/documents/architecture_doc.py")
        return 1 if stale else 0
    for path in stale:
        path.write_text(wanted[path], encoding="utf-8")
    return 0


def render() -> str:
    """Return the page."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    page = TEMPLATE.read_text(encoding="utf-8")
    parts = {
        "rules": "\n".join(rules(settings["contracts"])),
        "rooms": "\n".join(rooms(settings["root_packages"])),
    }
    for name, text in parts.items():
        page = page.replace(f"<!-- {name} -->", text)
    return page


def layers_of(contracts: Sequence[dict[str, Any]]) -> list[list[str]]:
    """Return the packages of each layer, the highest first."""
    contract = next(each for each in contracts if each["type"] == "layers")
    return [[name.strip() for name in layer.split("|")] for layer in contract["layers"]]


def open_to_the_world(contracts: Sequence[dict[str, Any]]) -> list[str]:
    """Return the packages of hil_forceps that no contract keeps from virtual_bus."""
    barred = {
        name.removeprefix("hil_forceps.")
        for contract in contracts
        if contract["type"] == "forbidden" and contract["source_modules"] == ["virtual_bus"]
        for name in contract["forbidden_modules"]
    }
    return [name for layer in layers_of(contracts) for name in layer if name not in barred]


def rules(contracts: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield what the other contracts forbid."""
    for contract in contracts:
        if contract["type"] == "forbidden":
            sources = ", ".join(f"`{name}`" for name in contract["source_modules"])
            targets = ", ".join(f"`{name}`" for name in contract["forbidden_modules"])
            yield f"- **{contract['name']}**: {sources} never import {targets}."


def rooms(roots: Sequence[str]) -> Iterator[str]:
    """Yield a table of all packages with the first sentence of their docstrings."""
    yield "| package | what lives there |"
    yield "|---|---|"
    for root in roots:
        for file in sorted((ROOT / root).rglob("__init__.py")):
            name = file.parent.relative_to(ROOT).as_posix()
            summary = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").split("\n\n")[0]
            yield f"| `{name}` | {' '.join(summary.split())} |"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
