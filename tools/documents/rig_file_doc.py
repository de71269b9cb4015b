"""Write docs/rig-file.md from the schema: `python tools/documents/rig_file_doc.py`, with `--check` to compare only."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from hil_forceps.rig import UserError, catalogue, load_rig, units
from hil_forceps.rig.catalogue import EFFECTS, Effect
from hil_forceps.rig.effects import quantity_of as effect_quantity
from hil_forceps.rig.json_schema import quantity_of
from hil_forceps.rig.quantities import Parameter, Quantity
from hil_forceps.rig.schema import Rig
from hil_forceps.rig.sections import IDEAL
from hil_forceps.rig.validation import consistency
from hil_forceps.rig.validation.problems import show_number

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / "docs" / "rig-file.md"
TEMPLATE = ROOT / "tools" / "documents" / "rig_file_doc.template.md"
BROKEN = ROOT / "tests" / "unit" / "rig" / "broken_rigs"
SHOWN_ERRORS = ("many_at_once", "values_in_other_units", "missing_key", "unclosed_brace")


def main(arguments: list[str]) -> int:
    """Write the page, or with `--check` tell whether it is up to date."""
    page = render()
    if arguments == ["--check"]:
        if TARGET.read_text(encoding="utf-8") != page:
            print(f"{TARGET} is out of date; run python tools/documents/rig_file_doc.py")
            return 1
        return 0
    TARGET.write_text(page, encoding="utf-8")
    return 0


def render() -> str:
    """Return the page."""
    page = TEMPLATE.read_text(encoding="utf-8")
    parts = {
        "sections": "\n".join(sections()),
        "rules": "\n".join(rules(consistency.RULES)),
        "bench_rules": "\n".join(rules((*consistency.BENCH_RULES, *consistency.NATIVE_RULES))),
        "equations": equations(),
        "effects": "\n".join(line for entry in EFFECTS for line in effect_rows(entry)),
        "errors": "\n".join(errors()),
    }
    for name, text in parts.items():
        page = page.replace(f"<!-- {name} -->", text)
    return page


def sections() -> Iterator[str]:
    """Yield a table for every section of the file."""
    for key, info in Rig.model_fields.items():
        model = next((kind for kind in (info.annotation, *get_args(info.annotation)) if is_model(kind)), None)
        if model is None:
            continue
        presence = "required" if info.is_required() else "optional"
        yield f"### `{key}:` ({presence})\n\n{model.__doc__}\n"
        yield "| key | unit | default | must be | meaning |\n|---|---|---|---|---|"
        yield from (row(name, field) for name, field in model.model_fields.items())
        yield ""


def is_model(kind: object) -> bool:
    """Tell whether an annotation is a section."""
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def row(name: str, field: FieldInfo) -> str:
    """Return the table row of one key."""
    quantity = quantity_of(field)
    unit = units.show_unit(quantity.unit) if quantity and quantity.unit else "–"
    default = (
        "required" if field.is_required() else "none" if field.default is None else f"`{show_default(field.default)}`"
    )
    parameter = " (*p*)" if field.annotation is Parameter else ""
    return f"| `{name}`{parameter} | {unit} | {default} | {range_of(field, quantity)} | {field.description} |"


def range_of(field: FieldInfo, quantity: Quantity | None) -> str:
    """Say what a value must be."""
    text = quantity.range_text().removesuffix(units.show_unit(quantity.unit)).strip() if quantity else ""
    annotation = field.annotation
    if get_origin(annotation) is tuple:
        entry = get_args(annotation)[0]
        return f"list of {text or choices(entry)}"
    literal = next((part for part in (annotation, *get_args(annotation)) if get_origin(part) is Literal), None)
    if literal is not None:
        return choices(literal)
    can_be_ideal = field.is_required() and type(None) in get_args(annotation)
    return f"{text} or `{IDEAL}`" if can_be_ideal else text


def choices(annotation: object) -> str:
    """Return the words that a literal allows."""
    return ", ".join(f"`{word}`" for word in get_args(annotation))


def show_default(value: object) -> str:
    """Return a default as a file would give it."""
    if isinstance(value, tuple):
        return f"[{', '.join(show_default(item) for item in value)}]"
    return show_number(value) if isinstance(value, int | float) else str(value)


def equations() -> str:
    """Return how the effects act together: the indented part of the catalogue's docstring."""
    lines = (catalogue.__doc__ or "").splitlines()
    return "\n".join(line.removeprefix("    ") for line in lines if line.startswith("    "))


def effect_rows(entry: Effect) -> Iterator[str]:
    """Yield the table rows of one effect: one for each parameter."""
    head = f"| `{entry.id}`: {entry.summary} | {entry.location} | {entry.equation.replace('|', chr(92) + '|')} |"
    for parameter in entry.parameters:
        quantity = effect_quantity(parameter)
        unit = units.show_unit(parameter.unit) or "–"
        reach = quantity.range_text().removesuffix(units.show_unit(quantity.unit)).strip()
        shape = " (*shape*)" if parameter.neutral is None else ""
        yield f"{head} `{parameter.name}`{shape} | {unit} | {reach} | {parameter.meaning} |"
        head = "| | | |"


def rules(table: consistency.Rules) -> Iterator[str]:
    """Yield what each rule between keys holds."""
    return (f"- {rule.__doc__}" for _, rule in table)


def errors() -> Iterator[str]:
    """Yield what is printed for some of the broken files of the tests."""
    for name in SHOWN_ERRORS:
        try:
            load_rig(BROKEN / f"{name}.yaml")
        except UserError as error:
            yield from (line.removeprefix(f"{BROKEN}/") for line in error.problems)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
