"""The tutorials: every command in them is run, and prints what they say."""

import json
from pathlib import Path

import pytest

from tests.unit.docs.code_blocks import blocks_of
from tests.unit.docs.test_json_page import keys_told
from tests.unit.docs.tutorial import ROOT, VARY, difference, prepared, printed, steps_of

PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.md"))


def test_there_are_three() -> None:
    assert [page.stem for page in PAGES] == ["first-bench", "motor-on-the-desk", "your-own-logs"]


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("page", PAGES, ids=[page.stem for page in PAGES])
def test_commands_print_what_the_page_says(page: Path, tmp_path: Path) -> None:
    folder = prepared(tmp_path)
    problems = []
    for step in steps_of(page.read_text(encoding="utf-8")):
        told = printed(step.commands, folder)
        assert "Traceback" not in told, f"{page.name}:{step.line}: {told}"
        if step.expected is not None:
            problem = difference(step.expected.text, told, numbers_vary=step.expected.note == VARY)
            problems += [f"{page.name}:{step.expected.line}: {problem}\n{told}"] if problem else []
    assert problems == []
    for name in ("run.json", "summary.json", "diagnosis.json"):  # what came out is what docs/json.md says
        for path in (folder / "out").rglob(name):
            content = json.loads(path.read_text(encoding="utf-8"))
            keys = keys_told("summary.json and timing.json" if name == "summary.json" else name)
            assert set(content) <= keys, path
            assert all(set(run) <= keys for run in content.get("runs", ())), path


@pytest.mark.parametrize("page", PAGES, ids=[page.stem for page in PAGES])
def test_every_step_is_run_or_says_why_not(page: Path) -> None:
    blocks = list(blocks_of(page.read_text(encoding="utf-8")))
    assert sum(block.language == "sh" and not block.why_not_run for block in blocks) >= 4
    assert {block.language for block in blocks} <= {"sh", "text", "yaml", "python"}
    assert all(block.note.startswith("file: ") or block.language != "yaml" for block in blocks)


PAGE = """
```sh
echo 'one 1.00'; echo two >&2; false
```

```text
one 1.01
two
```

<!-- file: note.yaml -->
```yaml
a: 1
```

<!-- not run: needs hardware -->
```sh
exit 1
```

Words between.

```sh
cat note.yaml
```

Words.

```text
something else
```
"""


def test_steps_are_run_in_order_and_compared(tmp_path: Path) -> None:
    first, second, third = steps_of(PAGE)
    assert first.expected is not None
    assert difference(first.expected.text, printed(first.commands, tmp_path)) == ""
    assert printed(second.commands, tmp_path) == ""
    assert (printed(third.commands, tmp_path), third.expected) == ("a: 1\n", None)


@pytest.mark.parametrize(
    ("expected", "got", "is_same"),
    [
        ("a 1.00  b", "a 1.01 b\n\n", True),
        ("a 1.00 b", "a 1.03 b", False),
        ("a 1.00 b", "c 1.00 b", False),
        ("a\n...\nd", "a\nb\nc\nd", True),
        ("a\n...", "a\nb", True),
        ("a\n...\nd", "a\nb\nc", False),
        ("a", "a\nb", False),
        ("a\nb", "a", False),
        (" ─── ", "────── ", True),
        ("error 0.000", "error -0.001", True),
        ("0.001016", "0.0012", False),
        ("2.6e-05", "2.7e-05", True),
        ("speed … ×", "speed 3.7 ×", True),
        ("speed … ×", "speed ×", False),
    ],
)
def test_what_counts_as_the_same(expected: str, got: str, is_same: bool) -> None:
    assert (difference(expected, got) == "") is is_same


def test_numbers_may_vary_words_may_not() -> None:
    assert difference("in 3 s", "in 77 s", numbers_vary=True) == ""
    assert difference("in 3 s", "in 77 ms", numbers_vary=True) != ""
