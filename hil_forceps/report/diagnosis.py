"""A diagnosis as one HTML page that opens offline, and its figures as files."""

from collections.abc import Callable
from pathlib import Path

from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.report.diagnosis_page import page
from hil_forceps.report.diagnosis_words import escaped

Progress = Callable[[int, int, str], None]  # figures done, of how many, which one comes now


def write_report(diagnosis: Diagnosis, path: Path, *, progress: Progress | None = None) -> None:
    """Write the page with its figures inside, folders made where missing; raises OSError.

    The same diagnosis gives the same bytes.
    """
    from hil_forceps.report import diagnosis_figures  # noqa: PLC0415 - matplotlib takes a while to load

    panels = diagnosis_figures.panels(diagnosis)
    images: dict[str, str] = {}
    for done, panel in enumerate(panels):
        _tell(progress, done, len(panels), panel.name)
        figure = panel.draw()
        if figure is not None:
            caption = escaped(panel.caption)
            image = diagnosis_figures.svg_image(figure, caption)
            images[panel.name] = f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
    _tell(progress, len(panels), len(panels), "page")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(diagnosis, images), encoding="utf-8")


def write_figures(diagnosis: Diagnosis, folder: Path, *, progress: Progress | None = None) -> list[Path]:
    """Write the figures of the page as PDF and PNG for papers; return the files. Raises OSError."""
    from hil_forceps.report import diagnosis_figures, save  # noqa: PLC0415 - as above

    panels = diagnosis_figures.panels(diagnosis)
    files: list[Path] = []
    for done, panel in enumerate(panels):
        _tell(progress, done, len(panels), panel.name)
        figure = panel.draw()
        if figure is not None:
            files += save.save_figure(figure, folder, panel.name)
    _tell(progress, len(panels), len(panels), "figures")
    return files


def _tell(progress: Progress | None, done: int, total: int, what: str) -> None:
    if progress:
        progress(done, total, what)
