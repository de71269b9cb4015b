"""A diagnosis as one HTML page that opens offline, and its figures as files."""

import gc
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.report.diagnosis_page import page
from hil_forceps.report.diagnosis_words import escaped

Progress = Callable[[int, int, str], None]  # figures done, of how many, which one comes now

SHARE = 4  # one figure in so many is drawn where the page is put together, the others by a helper


def draughtsman() -> ProcessPoolExecutor:
    """Return a process that helps to draw the figures; it loads what it draws with at once, while others compute."""
    helper = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
    helper.submit(_ready)
    return helper


def _ready() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who draws beside ends it
    from hil_forceps.report import diagnosis_figures  # noqa: F401, PLC0415

    gc.freeze()


def begun(diagnosis: Diagnosis, helper: Executor) -> Future[dict[str, str]]:
    """Have a helper draw three of four figures of the page, while what else the page tells is still looked for."""
    return helper.submit(_some_images, diagnosis)


def _some_images(diagnosis: Diagnosis) -> dict[str, str]:
    names = _names(diagnosis)
    return _images(diagnosis, [name for name in names if name not in names[::SHARE]])


def write_report(
    diagnosis: Diagnosis, path: Path, *, drawing: Future[dict[str, str]] | None = None, progress: Progress | None = None
) -> None:
    """Write the page with its figures inside, folders made where missing; raises OSError.

    `drawing`: of the same diagnosis, as it was `begun`. The same diagnosis gives the same bytes.
    """
    names = _names(diagnosis)
    drawn = _images(diagnosis, names[::SHARE] if drawing else names, progress)
    if drawing:
        drawn |= drawing.result()
    images = {name: drawn[name] for name in names if name in drawn}  # the page has them in this order
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(diagnosis, images), encoding="utf-8")


def _names(diagnosis: Diagnosis) -> list[str]:
    """Return the names of its figures, in the order of the page."""
    from hil_forceps.report import diagnosis_figures  # noqa: PLC0415 - matplotlib takes a while to load

    return [panel.name for panel in diagnosis_figures.panels(diagnosis)]


def _images(diagnosis: Diagnosis, names: Sequence[str], progress: Progress | None = None) -> dict[str, str]:
    """Draw the figures of these names, ready for the page."""
    from hil_forceps.report import diagnosis_figures  # noqa: PLC0415 - as above

    panels = [panel for panel in diagnosis_figures.panels(diagnosis) if panel.name in names]
    images: dict[str, str] = {}
    for done, panel in enumerate(panels):
        _tell(progress, done, len(panels), panel.name)
        figure = panel.draw()
        if figure is not None:
            caption = escaped(panel.caption)
            image = diagnosis_figures.svg_image(figure, caption)
            images[panel.name] = f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
    _tell(progress, len(panels), len(panels), "page")
    return images


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
