"""The layers of the import contracts as a drawing: boxes in rows, what may import above what it may import from."""

from collections.abc import Sequence

BOX, GAP, ROW, LEFT, TOP = 118, 10, 48, 20, 46
_HEAD = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="14">
<title>Layers of the packages</title>
<style>text {{ text-anchor: middle; dominant-baseline: central }} .box {{ fill: #eef2f5; stroke: #546e7a }}
.frame {{ fill: none; stroke: #546e7a; stroke-dasharray: 4 3 }} .arrow {{ stroke: #333; marker-end: url(#tip) }}
.rig {{ fill: #fff3d6 }}</style>
<defs><marker id="tip" markerWidth="8" markerHeight="8" refX="7" refY="4" orient="auto">\
<path d="M0 0 8 4 0 8z" fill="#333"/></marker></defs>
<rect width="{width}" height="{height}" fill="white"/>"""


def drawing(layers: Sequence[Sequence[str]], open_to_the_world: Sequence[str]) -> str:
    """Return an SVG of the layers of hil_forceps, the highest first, and of the two packages beside it.

    What `virtual_bus` may import of hil_forceps, `open_to_the_world`, has a colour of its own.
    """
    widest = max(map(len, layers))
    inner = widest * BOX + (widest - 1) * GAP
    width, bottom = inner + 2 * LEFT + 260, TOP + len(layers) * ROW
    parts = [_HEAD.format(width=width, height=bottom + 130)]
    parts.append(f'<rect class="frame" x="{LEFT - 10}" y="10" width="{inner + 20}" height="{bottom - 10}"/>')
    parts.append(f'<text x="{LEFT + inner / 2}" y="28" font-weight="bold">hil_forceps</text>')
    for number, layer in enumerate(layers):
        start = LEFT + (inner - len(layer) * BOX - (len(layer) - 1) * GAP) / 2
        for place, name in enumerate(layer):
            kind = "box rig" if name in open_to_the_world else "box"
            parts += _box(start + place * (BOX + GAP), TOP + number * ROW, BOX, name, kind)
    world, below = LEFT + inner + 40, bottom + 40
    parts += _box(world, TOP + 3 * ROW, 190, "virtual_bus", "box")
    parts.append(f'<text x="{world + 95}" y="{TOP + 3 * ROW + 48}" font-size="12">the simulated world</text>')
    parts += _box(LEFT, below, inner, "firmware_protocol: the wire", "box")
    parts.append(_arrow(LEFT + inner / 2, bottom, LEFT + inner / 2, below))
    parts.append(_arrow(world + 60, TOP + 3 * ROW + 62, LEFT + inner - 30, below))
    parts.append(_arrow(LEFT + inner + 10, TOP + 3 * ROW + 16, world, TOP + 3 * ROW + 16, dashed=True))
    parts.append(f'<text x="{world + 95}" y="{TOP + 3 * ROW - 30}" font-size="12">python-can, serial,</text>')
    parts.append(f'<text x="{world + 95}" y="{TOP + 3 * ROW - 14}" font-size="12">entry points</text>')
    legend = "A box imports from boxes below it. Yellow: what virtual_bus imports of hil_forceps."
    parts.append(f'<text x="{width / 2}" y="{bottom + 108}" font-size="12">{legend}</text>')
    return "\n".join((*parts, "</svg>", ""))


def _box(x: float, y: float, width: float, name: str, kind: str) -> tuple[str, str]:
    return (
        f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{width:g}" height="34" rx="4"/>',
        f'<text x="{x + width / 2:g}" y="{y + 17:g}">{name}</text>',
    )


def _arrow(x1: float, y1: float, x2: float, y2: float, *, dashed: bool = False) -> str:
    dashes = ' stroke-dasharray="5 4"' if dashed else ""
    return f'<line class="arrow" x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}"{dashes}/>'
