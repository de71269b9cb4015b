"""A trend as one HTML page that opens offline, and its figures as files."""

from pathlib import Path

from hil_forceps.drift.result import Trend
from hil_forceps.report.diagnosis.figures.captions import svg_image
from hil_forceps.report.diagnosis.words import escaped
from hil_forceps.report.save import save_figure
from hil_forceps.report.trend.figures import instrument_figure
from hil_forceps.report.trend.page import page


def write_report(trend: Trend, path: Path) -> None:
    """Write the page with embedded figures; raises OSError. The same trend gives the same bytes."""
    images = {}
    for instrument in trend.instruments:
        figure = instrument_figure(instrument)
        if figure is not None:
            caption = escaped(f"Parameters of {instrument.name} over days")
            image = svg_image(figure, caption)
            images[instrument.name] = f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(trend, images), encoding="utf-8")


def write_figures(trend: Trend, folder: Path) -> list[Path]:
    """Write a figure of each instrument as PDF and PNG; return the files. Raises OSError."""
    files: list[Path] = []
    for number, instrument in enumerate(trend.instruments, 1):
        figure = instrument_figure(instrument)
        if figure is not None:
            own = "".join(c if c.isalnum() or c in "-_" else "_" for c in instrument.name)[:80]
            files += save_figure(figure, folder, f"{number}_{own}")
    return files
