"""Write docs/architecture.md from the import contracts; with `--check` only compare."""

import ast
import sys
import tomllib
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TARGET = ROOT / "docs" / "architecture.md"
TEMPLATE = ROOT / "tools" / "architecture_doc.template.md"


def main(arguments: list[str]) -> int:
    """Write the page, or with `--check` tell whether it is up to date."""
    page = render()
    if arguments == ["--check"]:
        if not TARGET.exists() or TARGET.read_text(encoding="utf-8") != page:
            print(f"{TARGET} is out of date; run python tools/architecture_doc.py")
            return 1
        return 0
    TARGET.write_text(page, encoding="utf-8")
    return 0


def render() -> str:
    """Return the page."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    page = TEMPLATE.read_text(encoding="utf-8")
    parts = {
        "diagram": "\n".join(diagram(settings["contracts"])),
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


def diagram(contracts: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of a flow chart: an arrow from each package to those of the next layer below it."""
    layers = layers_of(contracts)
    yield "flowchart TB"
    yield '    subgraph hil_forceps["hil_forceps"]'
    for layer in layers:
        for name in layer:
            yield f'        {name}["{name}"]'
    for upper, lower in pairwise(layers):
        for above in upper:
            for below in lower:
                yield f"        {above} --> {below}"
    yield "    end"
    yield '    virtual_bus["virtual_bus: the simulated world"]'
    yield '    firmware_protocol["firmware_protocol: the wire"]'
    yield "    hil_forceps --> firmware_protocol"
    yield "    virtual_bus --> firmware_protocol"
    barred = {
        name.removeprefix("hil_forceps.")
        for contract in contracts
        if contract["type"] == "forbidden" and contract["source_modules"] == ["virtual_bus"]
        for name in contract["forbidden_modules"]
    }
    for name in (name for layer in layers for name in layer if name not in barred):
        yield f"    virtual_bus --> {name}"
    yield "    hil_forceps -. python-can, serial, entry points .-> virtual_bus"


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
