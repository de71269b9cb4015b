"""Blocks of code in the documents: Python runs, YAML is YAML and rigs load, what isn't run says why."""

from pathlib import Path

import pytest
import yaml

from hil_forceps.rig import UserError, load_rig
from tests.unit.docs.code_blocks import Block, blocks_of

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
# Pages whose Python runs from top to bottom in a test of its own.
RUN_ELSEWHERE = {
    "README.md": "tests/unit/api/test_documented_examples.py",
    "docs/python-api.md": "tests/unit/api/test_documented_examples.py",
}
LANGUAGES = {"", "python", "yaml", "sh", "text", "math", "matlab", "json"}


def run(block: Block, folder: Path) -> None:
    """Run a block of Python from a file of its own: numba looks there for what it has compiled."""
    path = folder / f"line_{block.line}.py"
    path.write_text(block.text, encoding="utf-8")
    exec(compile(block.text, str(path), "exec"), {"__name__": "an_example"})


def check_yaml(text: str, folder: Path) -> None:
    """Read YAML; what has a section `forceps:` must be a rig."""
    content = yaml.safe_load(text)
    if isinstance(content, dict) and "forceps" in content:
        path = folder / "rig.yaml"
        path.write_text(text, encoding="utf-8")
        load_rig(path)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_python_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = str(page.relative_to(ROOT))
    blocks = [block for block in blocks_of(page.read_text(encoding="utf-8")) if block.language == "python"]
    if name in RUN_ELSEWHERE:
        assert name in (ROOT / RUN_ELSEWHERE[name]).read_text(encoding="utf-8")
        return
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    for block in blocks:
        if not block.why_not_run:
            run(block, tmp_path)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_yaml_is_yaml_and_rigs_load(page: Path, tmp_path: Path) -> None:
    for block in blocks_of(page.read_text(encoding="utf-8")):
        if block.language == "yaml":
            check_yaml(block.text, tmp_path)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_blocks_end_and_have_a_known_language(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    opened = [line for line in text.splitlines() if line.startswith("```")]
    assert len(opened) == 2 * len(list(blocks_of(text)))
    assert {line[3:] for line in opened[::2]} <= LANGUAGES


def test_wrong_blocks_fail(tmp_path: Path) -> None:
    right = "<!-- not run: no file -->\n```python\nopen('x')\n```\n"
    page = "```python\nimport hil_forceps as hf\nhf.load_rigs\n```\n" + right
    wrong, marked = blocks_of(page)
    assert (wrong.line, wrong.why_not_run, marked.why_not_run) == (2, "", "no file")
    with pytest.raises(AttributeError):
        run(wrong, tmp_path)
    with pytest.raises(UserError, match="forceps"):
        check_yaml("forceps: {motor_pulley_radius_m: 2.0}\n", tmp_path)
    with pytest.raises(yaml.YAMLError):
        check_yaml("a: [1\n", tmp_path)
