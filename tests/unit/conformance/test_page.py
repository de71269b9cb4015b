"""The matrix that docs/conformance.md publishes: every target and requirement exists, and its sums are its marks."""

from collections import Counter

from firmware_protocol.conformance.catalogue import REQUIREMENTS, UNTESTABLE
from firmware_protocol.conformance.fuzz import FUZZERS, campaign
from tests.targets.page import PAGE, column, published
from tests.targets.record import TARGETS
from tools.targets.target_table import HEADER, MARKS

IN_VIRTUAL_TIME = ("python-virtual-time", "unicorn-bxcan")


def test_every_requirement_and_only_targets_that_there_are() -> None:
    figures, (heading, *rows) = published()
    assert figures[0] == list(HEADER)
    assert heading[0] == "requirement"
    assert set(heading[1:]) <= set(TARGETS)
    assert heading[1:] == [row[0] for row in figures[1:]]
    assert set(IN_VIRTUAL_TIME) <= set(heading)
    assert [row[0] for row in rows] == [requirement.name for requirement in REQUIREMENTS.values()]
    assert {mark for row in rows for mark in row[1:]} <= set(MARKS.values()) - {MARKS["fail"]}


def test_the_figures_count_the_marks() -> None:
    figures, (heading, *_) = published()
    for row in figures[1:]:
        counted = Counter(column(row[0]).values())
        for name, verdict in zip(HEADER[2:6], MARKS, strict=True):
            assert int(row[HEADER.index(name)]) == counted[MARKS[verdict]], (row[0], verdict)
    assert len(heading) == len(figures)


def test_what_can_not_be_judged_was_not_and_nothing_is_open_in_virtual_time() -> None:
    _, (heading, *_) = published()
    for target in heading[1:]:
        marks = column(target)
        assert {marks[REQUIREMENTS[number].name] for number in UNTESTABLE} == {MARKS["not run"]}
    for target in IN_VIRTUAL_TIME:
        assert set(column(target).values()) == {MARKS["pass"], MARKS["not run"]}


def test_every_target_is_explained() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for target in TARGETS:
        assert target in text or f"{target.partition('-')[0]}-*" in text, target


def test_the_fuzzers_of_the_page_are_those_that_there_are() -> None:
    text = PAGE.read_text(encoding="utf-8").split("## Fuzzing the Python side")[1]
    rows = [line for line in text.splitlines() if line.startswith("| ")][1:]
    assert len(rows) == len(FUZZERS)
    total = sum(int(row.split("|")[2].replace(",", "")) for row in rows)
    assert total >= 10_000_000
    assert len(campaign(6_000)) == len(FUZZERS)
