"""Tables on standard output."""

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from hil_forceps.identification.instrument.report import Table as Cells

FILE_COLUMNS = 160
WIDE = 1000  # wider than any table


def print_cells(cells: Cells, title: str, texts: int) -> None:
    """Print a table; its first `texts` columns are left-aligned words."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    for place, header in enumerate(cells.headers):
        table.add_column(header.replace(" (", "\n("), justify="right" if place >= texts else "left", no_wrap=place == 0)
    for row in cells.rows:
        table.add_row(*row)
    print_table(table, FILE_COLUMNS)


def print_table(table: Table, file_columns: int) -> None:
    """Print a table in the width of the terminal, or in `file_columns` columns to a file or pipe.

    If the terminal is too narrow for the longest words, each row is printed as lines of header and cell.
    """
    console = Console()
    width = console.width if console.is_terminal else file_columns
    console = Console(width=width)
    if least_width(table) <= width:
        console.print(table)
    else:
        _print_rows(console, table)


def least_width(table: Table) -> int:
    """Return the width that a table needs so that no word is broken."""
    wide = Console(width=WIDE)
    return Measurement.get(wide, wide.options, table).minimum


def _print_rows(console: Console, table: Table) -> None:
    if table.title:
        console.print(table.title)
    headers = [str(column.header).replace("\n", " ") for column in table.columns]
    for row in zip(*(column.cells for column in table.columns), strict=True):
        grid = Table.grid(padding=(0, 2))
        grid.add_column(no_wrap=True)
        grid.add_column(overflow="fold")
        for header, cell in zip(headers, row, strict=True):
            grid.add_row(header, cell)
        console.print(grid)
        console.print()
