"""Tables on standard output."""

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from hil_forceps.runs.instrument_report import Table as Cells


def print_cells(cells: Cells, title: str, texts: int) -> None:
    """Print a table whose first `texts` columns are words."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    for place, header in enumerate(cells.headers):
        table.add_column(header.replace(" (", "\n("), justify="right" if place >= texts else "left", no_wrap=place == 0)
    for row in cells.rows:
        table.add_row(*row)
    Console().print(table)
