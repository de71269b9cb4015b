"""A diagnosis as one HTML page that opens offline, and its figures as files."""

import gc
import signal
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from hil_forceps.diagnosis.result import Diagnosis
from hil_forceps.report.diagnosis.page import page
from hil_forceps.report.diagnosis.words import escaped

Progress = Callable[[int, int, str], None]  # figures done, number of figures, current figure


def draughtsman() -> ProcessPoolExecutor:
    """Return a process that draws figures; it loads matplotlib at once, in parallel with the computation."""
    helper = ProcessPoolExecutor(1, mp_context=get_context("spawn"))
    helper.submit(_ready)
    return helper


def _ready() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the waiting process ends it
    from hil_forceps.report.diagnosis.figures import captions  # noqa: F401, PLC0415

    gc.freeze()


def begun(diagnosis: Diagnosis, helper: Executor) -> Future[dict[str, str]]:
    """Begin to draw the figures of the page in a helper process, while the diagnosis continues."""
    return helper.submit(_by_two if sys.platform == "linux" else _images, diagnosis)


def _by_two(diagnosis: Diagnosis) -> dict[str, str]:
    """Draw all figures, every second one in a fork of this process, which has no threads and all modules loaded."""
    from hil_forceps.report.diagnosis.figures import captions  # noqa: PLC0415 - as below

    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as copy:
        others = copy.submit(_images, diagnosis, share=slice(1, None, 2))
        drawn = _images(diagnosis, share=slice(0, None, 2)) | others.result()
    return {panel.name: drawn[panel.name] for panel in captions.panels(diagnosis) if panel.name in drawn}


def write_report(
    diagnosis: Diagnosis, path: Path, *, drawing: Future[dict[str, str]] | None = None, progress: Progress | None = None
) -> None:
    """Write the page with embedded figures; missing folders are created. OSError if writing fails.

    `drawing`: of the same diagnosis, as it was `begun`. The same diagnosis gives the same bytes.
    """
    images = drawing.result() if drawing else _images(diagnosis, progress)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page(diagnosis, images), encoding="utf-8")


def _images(diagnosis: Diagnosis, progress: Progress | None = None, *, share: slice = slice(None)) -> dict[str, str]:
    """Draw all figures, or a part of them, in the order of the page, as HTML."""
    from hil_forceps.report.diagnosis.figures import captions  # noqa: PLC0415 - matplotlib takes a while to load

    panels = captions.panels(diagnosis)[share]
    images: dict[str, str] = {}
    for done, panel in enumerate(panels):
        _tell(progress, done, len(panels), panel.name)
        figure = panel.draw()
        if figure is not None:
            caption = escaped(panel.caption)
            image = captions.svg_image(figure, caption)
            images[panel.name] = f"<figure>{image}<figcaption>{caption}</figcaption></figure>"
    _tell(progress, len(panels), len(panels), "page")
    return images


def write_figures(diagnosis: Diagnosis, folder: Path, *, progress: Progress | None = None) -> list[Path]:
    """Write the figures of the page as PDF and PNG for papers; return the files. Raises OSError."""
    from hil_forceps.report import save  # noqa: PLC0415 - as above
    from hil_forceps.report.diagnosis.figures import captions  # noqa: PLC0415 - as above

    panels = captions.panels(diagnosis)
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
