"""Figures as files: PDF for print, PNG for screens; the same figure gives the same bytes."""

from pathlib import Path

from matplotlib.figure import Figure

from hil_forceps.report.style import house_style


def save_figure(figure: Figure, folder: Path, name: str) -> tuple[Path, Path]:
    """Write `name.pdf` and `name.png` (200 dpi) to `folder`, which is created if missing; raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    pdf, png = folder / f"{name}.pdf", folder / f"{name}.png"
    with house_style():
        # lay out once and switch the engine off, which would draw everything twice more for each file
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        # no dates and no version: the same figure must give the same bytes
        figure.savefig(pdf, metadata={"CreationDate": None, "Producer": None, "Creator": None})
        figure.savefig(png, metadata={"Software": None})
    return pdf, png
