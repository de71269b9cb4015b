"""Equations in ```math blocks and $`…`$ as MathML, made while the site is built: no script draws them, none is loaded."""

from typing import Any

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor


def block(source: str, *_: Any, **__: Any) -> str:
    """Return a block of TeX as a displayed formula; the form that `pymdownx.superfences` asks for."""
    return f'<div class="equation">{convert(source.strip(), display="block")}</div>'


class _Inline(InlineProcessor):
    def handleMatch(self, m: Any, data: str) -> tuple[str, int, int]:  # type: ignore[override]  # noqa: ARG002, N802
        return self.md.htmlStash.store(convert(m[1].strip(), display="inline")), m.start(0), m.end(0)


class Equations(Extension):
    """Formulas within a line, between $` and `$, as git forges write them."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802
        """Add it before inline code is looked for."""
        md.inlinePatterns.register(_Inline(r"\$`([^`\n]+)`\$", md), "equation", 200)


def makeExtension(**settings: Any) -> Equations:  # noqa: N802
    """Return the extension: the name that Python-Markdown calls."""
    return Equations(**settings)
