"""Tables on standard output."""

import sys

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from hil_forceps.runs.instrument_report import Table as Cells

FILE_COLUMNS = 160


def print_cells(cells: Cells, title: str, texts: int) -> None:
    """Print a table whose first `texts` columns are words."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    for place, header in enumerate(cells.headers):
        table.add_column(header.replace(" (", "\n("), justify="right" if place >= texts else "left", no_wrap=place == 0)
    for row in cells.rows:
        table.add_row(*row)
    # A file or a pipe has no width: nothing is cut there.
    Console(width=None if sys.stdout.isatty() else FILE_COLUMNS).print(table)
