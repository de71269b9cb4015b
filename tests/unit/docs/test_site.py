"""The site: what is laid out for the generator, and, built, that it is whole and loads nothing from elsewhere."""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import markdown
import pytest
import yaml
from pymdownx.superfences import SuperFencesException

import hil_forceps as hf
from hil_forceps.cli.examples import EXAMPLES
from tests.unit.docs.tutorial import ROOT
from tools.site.api_page import GROUPS
from tools.site.equations import block
from tools.site.links import links_of, problem_of
from tools.site.staging import OUTSIDE, decisions, place_of, stage


class _Settings(yaml.SafeLoader):
    """The settings, with the functions that they name as text."""


_Settings.add_multi_constructor("tag:yaml.org,2002:python/name:", lambda _, suffix, __: suffix)
SETTINGS = yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), _Settings)


def pages_of(nav: object) -> Iterator[str]:
    """Yield the pages that the menu names."""
    if isinstance(nav, str):
        yield nav
    elif isinstance(nav, list | dict):
        for each in nav.values() if isinstance(nav, dict) else nav:
            yield from pages_of(each)


@pytest.fixture(scope="module")
def laid_out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Lay the pages out, once."""
    folder = tmp_path_factory.mktemp("pages")
    stage(folder)
    return folder


def test_pages_are_laid_out_with_links_that_lead_somewhere(laid_out: Path) -> None:
    pages = sorted(laid_out.rglob("*.md"))
    named = set(pages_of(SETTINGS["nav"]))
    assert {str(page.relative_to(laid_out)) for page in pages if "decisions/0" not in str(page)} == named
    for page in pages:
        name = PurePosixPath(page.relative_to(laid_out))
        found = (problem_of(link, name, laid_out) for link in links_of(page.read_text(encoding="utf-8")))
        assert [problem for problem in found if problem] == [], name


def test_the_command_line_page_has_every_command(laid_out: Path) -> None:
    page = (laid_out / "command-line.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (\w+)$", page, re.MULTILINE) == list(EXAMPLES)
    assert all(f"\n{line}\n" in page for line in EXAMPLES.values())
    assert "* `--hold-out STR...`: Names of runs" in page  # of diagnose
    assert "--serial-pty" in page  # of drive, which has a parser of its own


def test_places() -> None:
    places = {path: str(place_of(PurePosixPath(path))) for path in ("README.md", "docs/bench.md", "docs/decisions")}
    assert places == {"README.md": "index.md", "docs/bench.md": "bench.md", "docs/decisions": "decisions/index.md"}
    assert all((ROOT / name).is_file() for name in OUTSIDE)
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(hf.__all__)
    assert decisions().count("\n- [") == len(list((ROOT / "docs" / "decisions").glob("0*.md"))) - 1


def test_equations_become_mathml() -> None:
    told = block(r"x = \frac{a}{b}")
    assert "<mfrac>" in told
    assert "\\frac" not in told
    for wrong in (r"\begin{aligned} a &= b \end{aligned}", r"a \unheardof b"):
        with pytest.raises(SuperFencesException, match="no MathML"):
            block(wrong)


def test_symbols_get_their_indices_and_names_stay() -> None:
    page = "θ_m, τ̂_w and θ_j^ref of `θ_m`, theta_m_rad, S_1 and r_m/r_j (I_m)"
    told = markdown.markdown(page, extensions=["tools.site.equations"])
    assert re.sub("</?span>", "", told) == (
        "<p>θ<sub>m</sub>, τ̂<sub>w</sub> and θ<sub>j</sub><sup>ref</sup> of <code>θ_m</code>, theta_m_rad, S_1 and "
        "r<sub>m</sub>/r<sub>j</sub> (I<sub>m</sub>)</p>"
    )


EXTERNAL = re.compile(r"""<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=["'](?:https?:)?//[^"']+""")


def test_what_is_loaded_from_elsewhere_is_seen() -> None:
    assert EXTERNAL.search('<script async src="https://unpkg.com/x"></script>')
    assert EXTERNAL.search("<link rel=stylesheet href='//fonts.example/css'>")
    assert not EXTERNAL.search('<a href="https://example.org">there</a><script src="assets/a.js"></script>')


@pytest.mark.long
@pytest.mark.timeout(1200)
def test_the_site_builds_without_a_warning_and_stands_alone() -> None:
    command = [sys.executable, "-m", "tools.site"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    site = ROOT / "build" / "site"
    pages = {path.relative_to(site).as_posix(): path.read_text(encoding="utf-8") for path in site.rglob("*.html")}
    assert {page.replace(".md", ".html") for page in pages_of(SETTINGS["nav"])} <= set(pages)
    assert {name: found[0] for name, text in pages.items() if (found := EXTERNAL.search(text))} == {}
    for name, text in pages.items():
        words = re.sub(r"<[^>]+>", " ", re.sub(r"<(pre|code|script|style|math)\b.*?</\1>", " ", text, flags=re.DOTALL))
        assert "$" not in words, name
        assert "```" not in words, name
    for name in ("diagnosis.html", "estimators.html"):
        assert "<math" in pages[name], name
    for name in hf.__all__:
        assert f'id="hil_forceps.{name}"' in pages["api.html"], name
