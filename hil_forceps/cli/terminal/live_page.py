"""The live page of a command, opened in the browser."""

import html
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from hil_forceps.cli.commands.open_ import has_display
from hil_forceps.cli.terminal.notes import note
from hil_forceps.live.description import Description
from hil_forceps.live.view import LiveOptions, View, live_view


@contextmanager
def shown(description: Description, options: LiveOptions | None) -> Iterator[View | None]:
    """Serve a live page while the block runs, note its address, and open it if there is a display."""
    if options is None:
        yield None
        return
    with TemporaryDirectory(prefix="hil-forceps-") as folder, live_view(description, options) as view:
        for each in view.notes():
            note(each)
        if has_display():
            webbrowser.open(_way_to(view.address, Path(folder)).as_uri())
        yield view


def _way_to(address: str, folder: Path) -> Path:
    """Return a file that redirects to the page.

    The address contains a token, and other users can read the command line of a browser. They can't read this folder.
    """
    path = folder / "live.html"
    path.write_text(f'<meta http-equiv="refresh" content="0; url={html.escape(address)}">\n', encoding="utf-8")
    return path
