"""Tables on standard output."""

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from hil_forceps.identification.instrument.report import Table as Cells

FILE_COLUMNS = 160


def print_cells(cells: Cells, title: str, texts: int) -> None:
    """Print a table whose first `texts` columns are words."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    for place, header in enumerate(cells.headers):
        table.add_column(header.replace(" (", "\n("), justify="right" if place >= texts else "left", no_wrap=place == 0)
    for row in cells.rows:
        table.add_row(*row)
    print_table(table, FILE_COLUMNS)


def print_table(table: Table, file_columns: int) -> None:
    """Print a table as wide as the terminal is; a file or a pipe, which has no width, gets so many columns."""
    console = Console()
    Console(width=None if console.is_terminal else file_columns).print(table)
