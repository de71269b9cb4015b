"""Equations as MathML and symbols with their indices, made while the site is built: no script draws them.

Equations are TeX in ```math blocks, as git forges draw them. Symbols in the text, such as θ_m, are plain there.
"""

import re
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from latex2mathml.converter import convert
from markdown import Markdown
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from pymdownx.superfences import SuperFencesException

# A letter, perhaps with a hat, and its index: θ_m, τ̂_w, θ_j^ref. A word with an underscore is none.
_SYMBOL = r"(?<![\w^])(\w[\u0300-\u0302\u0307\u0308]?)_([a-zA-Z]{1,2}|int|ex)(?:\^(ref))?(?![\w(])"
_NOT_TRANSLATED = re.compile(r"<m\w+>(?:&|&amp;|\\[^<]*)</m\w+>")


def block(source: str, *_: Any, **__: Any) -> str:
    """Return a block of TeX as a displayed formula: the form that `pymdownx.superfences` asks for.

    SuperFencesException, which ends the build, for what the translation leaves as it is.
    """
    told = convert(source.strip(), display="block")
    if _NOT_TRANSLATED.search(told):
        raise SuperFencesException(f"no MathML for all of this equation: {source.strip()}")
    return f'<div class="equation">{told}</div>'


class _Symbol(InlineProcessor):
    def handleMatch(self, m: re.Match[str], data: str) -> tuple[Element, int, int]:  # noqa: ARG002
        symbol = Element("span")
        symbol.text = m[1]
        SubElement(symbol, "sub").text = m[2]
        if m[3]:
            SubElement(symbol, "sup").text = m[3]
        return symbol, m.start(0), m.end(0)


class Symbols(Extension):
    """Symbols with an index within a line, wherever no code is."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Add it behind code and links, and before emphasis."""
        md.inlinePatterns.register(_Symbol(_SYMBOL, md), "symbol", 75)


def makeExtension(**settings: Any) -> Symbols:
    """Return the extension: the name that Python-Markdown calls."""
    return Symbols(**settings)
