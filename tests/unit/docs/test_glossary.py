"""docs/glossary.md has every house word that the documents and `--help` use, and no entry that they don't use."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from tools.site.cli_page import page as help_of_all_commands

DOCS = Path(__file__).parents[3] / "docs"
GLOSSARY = DOCS / "glossary.md"
PAGES = [
    path
    for path in (DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md")))
    if path != GLOSSARY and "decisions" not in path.parts
]
# Words that the documents use in a sense of their own. Who brings another into the documents adds it here.
HOUSE_WORDS = (
    "approach", "audit", "axis", "bench", "bench file", "black box", "bridge", "bus log", "campaign", "candidate set",
    "catalogue", "certificate", "compensation", "confidence", "conformance", "control law", "doctor", "drive", "driven",
    "effect", "entry", "estimator", "extended rig", "fault campaign", "floor", "fresh", "gate", "held out",
    "hidden effect", "host", "innovation", "instrument", "invariant", "kernel", "lack of fit", "ladder", "latch",
    "law", "line", "live page", "load", "native", "paper", "peer", "plant", "profile", "promise", "recording",
    "reference", "rig", "rig file", "run", "runaway", "sample", "scenario", "service", "session", "setpoint", "shift",
    "stamp", "stroke", "target", "tick", "usual runs", "verdict", "virtual time", "wire", "world", "zero",
)  # fmt: skip
_CODE = re.compile(r"^```.*?^```|^ {4,}\S[^\n]*$|`[^`\n]+`", re.MULTILINE | re.DOTALL)


class Glossary(NamedTuple):
    """What the first column of its tables has; `a, b` are two words with one meaning."""

    symbols: tuple[str, ...]
    terms: tuple[str, ...]


def glossary_of(page: str) -> Glossary:
    """Read the tables: those below `## Symbols` have symbols, all others have terms."""
    symbols: list[str] = []
    terms: list[str] = []
    for section in page.split("\n## ")[1:]:
        title, _, text = section.partition("\n")
        rows = [line.split(" | ")[0].removeprefix("| ") for line in text.splitlines() if line.startswith("| ")]
        (symbols if title == "Symbols" else terms).extend(word for row in rows[1:] for word in row.split(", "))
    return Glossary(tuple(symbols), tuple(terms))


def uses(word: str, text: str) -> bool:
    """Tell whether a text uses a word, in singular or plural, with a capital or without."""
    stem = re.escape(word).replace(r"\ ", r"\s+")
    plural = rf"{stem}(?:e?s)?" if not word.endswith("y") else rf"(?:{stem}|{re.escape(word[:-1])}ies)"
    return re.search(rf"(?<![\w-]){plural}(?![\w-])", text, re.IGNORECASE) is not None


def undefined(words: Iterable[str], glossary: Glossary, prose: str) -> Iterator[str]:
    """Yield the house words that are used and that no entry defines."""
    return (word for word in words if word not in glossary.terms and uses(word, prose))


def unused(glossary: Glossary, text: str) -> Iterator[str]:
    """Yield what the glossary defines and nothing uses."""
    symbols = (symbol for symbol in glossary.symbols if not symbol.startswith(("a hat", "as in")))
    yield from (symbol for symbol in symbols if symbol not in text)
    yield from (term for term in glossary.terms if not uses(term, text))


def test_house_words_are_defined_and_entries_are_used() -> None:
    text = "\n\n".join([*(page.read_text(encoding="utf-8") for page in PAGES), help_of_all_commands()])
    glossary = glossary_of(GLOSSARY.read_text(encoding="utf-8"))
    assert list(undefined(HOUSE_WORDS, glossary, _CODE.sub("", text))) == []
    assert list(unused(glossary, text)) == []
    assert [word for word in HOUSE_WORDS if not uses(word, text)] == []  # a word that is gone leaves the list, too


def test_entries_are_in_order_and_none_comes_twice() -> None:
    glossary = glossary_of(GLOSSARY.read_text(encoding="utf-8"))
    assert len(set(glossary.terms)) == len(glossary.terms)
    for section in GLOSSARY.read_text(encoding="utf-8").split("\n## ")[2:]:
        firsts = [line.removeprefix("| ").partition(" |")[0] for line in section.splitlines() if line.startswith("| ")]
        assert firsts[1:] == sorted(firsts[1:], key=str.lower)


PAGE = """# G
## Symbols
| symbol | meaning |
|---|---|
| θ_m, ω_m | angle and speed |
## Words
| term | meaning |
|---|---|
| bus log | frames |
| peer, simulated peer | a drive |
"""


def test_missing_and_idle_entries_are_found() -> None:
    glossary = glossary_of(PAGE)
    assert glossary == Glossary(("θ_m", "ω_m"), ("bus log", "peer", "simulated peer"))
    page = "Of θ_m, two Bus\nlogs, ladders and `gates`\n\n    gate\n\nand entries, no peerage.\n```\ngate\n```\n"
    prose = _CODE.sub("", page)
    assert list(undefined(("gate", "ladder", "entry", "bus log"), glossary, prose)) == ["ladder", "entry"]
    assert list(unused(glossary, page)) == ["ω_m", "peer", "simulated peer"]
