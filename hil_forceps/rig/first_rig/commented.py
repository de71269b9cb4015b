"""The text of a first rig: each key with its meaning, its unit and where its value is from."""

import textwrap
from collections.abc import Iterator, Mapping

from hil_forceps.rig import units
from hil_forceps.rig.first_rig.answers import Answers
from hil_forceps.rig.first_rig.plan import Known, Sections
from hil_forceps.rig.json_schema import quantity_of, section_model
from hil_forceps.rig.schema import Rig

COLUMNS = 110
DIGITS = 6


def text_of(answers: Answers, found: Sections, schema: str, command: str) -> str:
    """Return the file; `schema` is the path or address of its JSON schema, `command` what made it."""
    return "\n".join([*_head(answers, schema, command), *_body(found)]) + "\n"


def _head(answers: Answers, schema: str, command: str) -> Iterator[str]:
    yield f"# yaml-language-server: $schema={schema}"
    yield "#"
    yield from _comment(f"Written by: {command}")
    yield "#"
    yield from _comment(f"motor: {answers.motor.title}. Source: {answers.motor.source}")
    if answers.motor.about:
        yield from _comment(answers.motor.about)
    yield from _comment(f"drive: {answers.drive.title}. {answers.drive.page} has what is to be set in it")
    yield from _comment("All values are at the motor pulley, in SI. docs/rig-file.md has every key.")
    yield from _comment(
        "Next: `hil-forceps check` this file; `hil-forceps doctor` before motion; `hil-forceps diagnose` on the first "
        "recordings fits what no data sheet has (docs/diagnosis.md)."
    )


def _body(found: Sections) -> Iterator[str]:
    for section, entries in found.items():
        model = section_model(Rig.model_fields[section])
        assert model is not None
        yield ""
        yield from _comment((model.__doc__ or "").replace("`", ""))
        yield f"{section}:"
        for entry in entries:
            field = model.model_fields[entry.key]
            quantity = quantity_of(field)
            unit = f" [{units.show_unit(quantity.unit)}]" if quantity and quantity.unit else ""
            yield from _comment(f"{(field.description or '').replace('`', '')}{unit}: {entry.source}", "  ")
            yield f"  {entry.key}: {_written(entry.value)}"


def _comment(text: str, indent: str = "") -> list[str]:
    start = f"{indent}# "
    return textwrap.wrap(text, COLUMNS, initial_indent=start, subsequent_indent=start, break_on_hyphens=False)


def _written(value: Known) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {_written(number)}" for key, number in value.items()) + "}"
    return value if isinstance(value, str) else f"{value:.{DIGITS}g}" if isinstance(value, float) else str(value)
