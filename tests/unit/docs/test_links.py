"""Every link of the documents leads to a file, and its anchor to a heading, in the repository and on the site alike."""

from pathlib import Path, PurePosixPath

import pytest

from tools.site.links import Link, anchors_of, links_of, problem_of, relinked

ROOT = Path(__file__).parents[3]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_links_lead_somewhere(page: Path) -> None:
    name = PurePosixPath(page.relative_to(ROOT))
    found = ((link, problem_of(link, name, ROOT)) for link in links_of(page.read_text(encoding="utf-8")))
    assert [f"{name}:{link.line}: {link.target}: {problem}" for link, problem in found if problem] == []


def test_the_readme_has_links_to_look_at() -> None:
    assert len(list(links_of((ROOT / "README.md").read_text(encoding="utf-8")))) > 10


PAGE = """# A page
[one](a.md) and `[no](b.md)`, ![a picture](c.png) beside `code that
goes on` [over [nested] text](d.md#there "title").

    [none](e.md)

`code` [first](f.md)

```sh
[none](g.md)
```

- item
  [in a list](h.md), <a href="i.md">html</a>, <https://example.org>, [out](https://example.org/x.md)

<!-- [none](j.md) -->
"""


def test_links_are_found_and_none_in_code() -> None:
    assert sorted(links_of(PAGE)) == [
        Link(2, "a.md"), Link(2, "c.png"), Link(3, "d.md#there"), Link(7, "f.md"), Link(14, "h.md"),
        Link(14, "https://example.org/x.md"), Link(14, "i.md"),
    ]  # fmt: skip


def test_links_are_changed_where_they_stand() -> None:
    changed = relinked(PAGE, lambda target: f"../{target}")
    assert "[one](../a.md)" in changed
    assert "`[no](b.md)`" in changed
    assert "[out](https://example.org/x.md)" in changed
    assert changed.count("../") == 6
    assert relinked(changed, lambda target: target.removeprefix("../")) == PAGE


def test_anchors_are_those_of_the_headings() -> None:
    page = "# Drive's law, `kp`\n## With τ_w\n## With τ_w\n```\n# none\n```\n"
    page += '## [Linked](a.md) and *more*\n<a id="own">'
    assert anchors_of(page) == {"drives-law-kp", "with-τ_w", "with-τ_w_1", "linked-and-more", "own"}


@pytest.mark.parametrize(
    ("target", "problem"),
    [
        ("docs/bench.md", ""),
        ("docs/bench.md#real-time-two-processes", ""),
        ("docs", ""),
        ("https://example.org", ""),
        ("docs/bensh.md", "docs/bensh.md is not there"),
        ("docs/bench.md#nowhere", "docs/bench.md has no heading #nowhere"),
        ("../elsewhere.md", "leads out of the repository"),
    ],
)
def test_what_is_wrong_with_a_link(target: str, problem: str) -> None:
    assert problem_of(Link(1, target), PurePosixPath("README.md"), ROOT) == problem
