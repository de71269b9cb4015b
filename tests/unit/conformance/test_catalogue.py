"""The catalogue is the spec's list: same numbers, same levels, and each either checked or excused."""

import re
from pathlib import Path

from firmware_protocol.conformance import suite
from firmware_protocol.conformance.catalogue import REQUIREMENTS, SHOULD, TITLES, UNTESTABLE
from firmware_protocol.conformance.port import REAL, VIRTUAL
from firmware_protocol.conformance.registry import CHECKS

SPEC = (Path(__file__).parents[3] / "docs" / "protocol.md").read_text(encoding="utf-8")
REQUIREMENT = re.compile(r"^- \*\*HFP-(\d{3})\*\* (.+?)(?=\n- |\n\n)", re.MULTILINE | re.DOTALL)


def test_same_numbers_and_levels_as_the_spec() -> None:
    found = {int(number): text for number, text in REQUIREMENT.findall(SPEC)}
    assert list(TITLES) == list(found)
    assert {number for number, text in found.items() if "SHOULD" in text and "MUST" not in text} == set(SHOULD)


def test_each_requirement_is_checked_or_excused() -> None:
    assert suite.SUITE_VERSION
    assert {each.requirement for each in CHECKS} == set(REQUIREMENTS) - set(UNTESTABLE)
    assert len({each.name for each in CHECKS}) == len(CHECKS)
    for requirement in REQUIREMENTS.values():
        assert 0 < len(requirement.title) <= 64


def test_what_binds_the_host_says_so() -> None:
    texts = {int(number): text for number, text in REQUIREMENT.findall(SPEC)}
    for number, reason in UNTESTABLE.items():
        of_host = texts[number].startswith("A host") or "A connected host" in texts[number]
        of_host |= texts[number].startswith("`sample_sequence`")
        assert of_host == (reason == "binds the host"), number


DOCS = (Path(__file__).parents[3] / "docs" / "conformance.md").read_text(encoding="utf-8")


def test_docs_name_what_can_not_be_seen_and_why() -> None:
    section = DOCS.split("## What can't be seen from outside")[1].split("Seen in part")[0]
    listed: dict[int, str] = {}
    for numbers, reason in re.findall(r"^\| (HFP-.+?) \| (.+?) \|$", section, re.MULTILINE):
        for part in numbers.split(", "):
            ends = [int(number) for number in re.findall(r"HFP-(\d{3})", part)]
            listed |= {number: reason for number in TITLES if ends[0] <= number <= ends[-1]}
    assert listed == UNTESTABLE


def test_docs_have_the_margins() -> None:
    rows = re.findall(r"^\| (\w+_(?:ns|ppm|raw)) \| ([\d.]+) ?(\w*) \| ([\d.]+)", DOCS, re.MULTILINE)
    assert len(rows) == 7
    scale = {"ms": 1e6, "s": 1e9, "mA": 5.0, "": 1.0}
    for name, virtual, unit, real in rows:
        assert float(virtual) * scale[unit] == getattr(VIRTUAL, name)
        assert float(real) * scale[unit] == getattr(REAL, name)
