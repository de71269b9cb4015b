"""`hil-forceps open`: the newest report in the browser."""

import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hil_forceps.rig.errors import UserError

USUAL_FOLDER = Path("out")
REPORT_NAMES = ("report.html", "trend.html")


def open_(
    folder: Path = USUAL_FOLDER, *, print_: Annotated[bool, Parameter(name="--print", negative="")] = False
) -> int:
    """Open the newest report below a folder in the browser, and print its path. Without a display only print the path.

    Parameters
    ----------
    folder
        Folder with results, or a report.
    print_
        Only print the path.
    """
    report = newest_report(folder)
    sys.stdout.write(f"{report}\n")
    sys.stdout.flush()
    if not print_ and has_display():
        webbrowser.open(report.resolve().as_uri())
    return 0


def newest_report(folder: Path) -> Path:
    """Return the report that was written last; UserError if there is none."""
    if folder.is_file():
        return folder
    if not folder.is_dir():
        raise UserError(f"{folder}: no such folder; name the folder that --out had")
    found = [path for name in REPORT_NAMES for path in folder.rglob(name) if path.is_file()]
    if not found:
        raise UserError(f"{folder}: contains no report.html; `hil-forceps diagnose` writes one to the folder of --out")
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path))


def has_display() -> bool:
    """Return whether there is a display; outside Linux always True."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
