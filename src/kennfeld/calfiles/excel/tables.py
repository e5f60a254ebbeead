"""Reads the numbers of a table from its sheet and reports every wrong cell."""

from dataclasses import field
from itertools import product

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.excel.layout import AXIS_HEADING, CORNERS, AxisCells, Sheet
from kennfeld.domain.axis import AXIS_LETTERS


@dataclass
class Grid:
    """All numbers of a table, `values[i, j, ...]` at x number i, y number j; `axes` in the same order."""

    values: Float
    axes: list[AxisCells] = field(default_factory=list)


@dataclass(frozen=True)
class _Page:
    """One rectangle of numbers, with the breakpoints beyond x and y in the row above it."""

    row: int
    further: AxisCells
    x: AxisCells
    y: AxisCells | None
    values: Float


def read_grid(sheet: Sheet) -> Grid | None:
    """Return the table of a sheet; None, with findings, if it is broken.

    A table ends where its breakpoints end, so that notes and sums may stand next to it or below it, apart from it.
    """
    corners = [row for row in range(len(sheet.rows)) if _is_corner(sheet, row)]
    if not corners:
        single_row, table = CORNERS
        remedy = f"Write {table!r} into the cell above and left of the numbers, {single_row!r} for a single row."
        sheet.error(f"Sheet {sheet.name} contains no table", remedy)
        return None
    pages = [_page(sheet, row) for row in corners]
    complete = [page for page in pages if page is not None]
    grid = _stack_pages(sheet, complete) if len(complete) == len(pages) else None
    if grid is not None:
        _describe(sheet, corners[0], grid)
    return grid


def _is_corner(sheet: Sheet, row: int) -> bool:
    cell = sheet.cell(row, 0)
    return isinstance(cell, str) and " ".join(cell.split()).casefold().startswith(CORNERS)


def _page(sheet: Sheet, row: int) -> _Page | None:
    """Read the page whose corner is in a row."""
    right, below = 1, row + 1
    while sheet.cell(row, right) is not None:
        right += 1
    x = _read_axis(sheet, [(row, column) for column in range(1, right)], (row, 1), "x")
    downwards = sheet.text(row, 0).strip().casefold().startswith("y")
    # breakpoints end at an empty cell, a note or the next page
    while sheet.cell(below, 0) is not None and not _is_end_of_table(sheet, below):
        below += 1
    y = _read_axis(sheet, [(at, 0) for at in range(row + 1, below)], (row + 1, 0), "y") if downwards else None
    further = _read_higher_axes(sheet, row)
    if x is None or further is None or (downwards and y is None):
        return None
    rows = [cell[0] for cell in y.cells] if y else [row + 1]
    columns = [cell[1] for cell in x.cells]
    numbers = [[sheet.number(r, c) for c in columns] for r in rows]
    _report_stray_numbers(sheet, row, rows, columns, downwards)
    if any(number is None for line in numbers for number in line):
        return None
    # x runs to the right, and is the first index here
    values = np.array(numbers, dtype=np.float64).reshape(len(rows), len(columns)).T
    return _Page(row, further, x, y, values)


def _read_axis(sheet: Sheet, cells: list[tuple[int, int]], first: tuple[int, int], letter: str) -> AxisCells | None:
    if cells:
        return sheet.breakpoints(cells)
    sheet.error(f"{sheet.place(*first)} is empty; the {letter} breakpoints begin here")
    return None


def _is_end_of_table(sheet: Sheet, row: int) -> bool:
    """Check whether a row below a table is not part of it, but a note or the next page."""
    if _is_corner(sheet, row):
        return True
    return not sheet.has_number(row, 0) and (not sheet.has_number(row, 1) or _starts_page(sheet, row))


def _starts_page(sheet: Sheet, row: int) -> bool:
    return sheet.text(row, 0).strip().casefold() == AXIS_LETTERS[2]


def _report_stray_numbers(sheet: Sheet, corner: int, rows: list[int], columns: list[int], downwards: bool) -> None:
    """Report numbers next to a table without a breakpoint."""
    right, below = columns[-1] + 1, rows[-1] + 1
    if any(sheet.has_number(row, right) for row in rows):
        message = f"{sheet.place(corner, right)} is empty; the numbers below it have no x breakpoint"
        sheet.error(message, "Write the breakpoint, or leave an empty column next to the table.")
    if downwards and not _starts_page(sheet, below) and any(sheet.has_number(below, column) for column in columns):
        message = f"{sheet.place(below, 0)} is empty; the numbers next to it have no y breakpoint"
        sheet.error(message, "Write the breakpoint, or leave an empty row below the table.")


def _read_higher_axes(sheet: Sheet, row: int) -> AxisCells | None:
    """Return the breakpoints in the row `z | 0.5 | w | 7` above a page; empty if there is none."""
    cells = []
    for column, letter in enumerate(AXIS_LETTERS[2:]):
        if row == 0 or sheet.text(row - 1, 2 * column).strip().casefold() != letter:
            break
        cells.append((row - 1, 2 * column + 1))
    return sheet.breakpoints(cells)


def _stack_pages(sheet: Sheet, pages: list[_Page]) -> Grid | None:
    """Stack the pages into one table; they must have the same breakpoints and be complete."""
    first = pages[0]
    agree = True
    for page in pages[1:]:
        for axis, known in ((page.x, first.x), (page.y, first.y)):
            agree &= not (axis and known and _report_difference(sheet, axis, known))
        if (page.y is None) != (first.y is None) or len(page.further.points) != len(first.further.points):
            sheet.error(f"{sheet.place(page.row, 0)} starts a page with another layout than the first one")
            agree = False
    if agree and len(pages) > 1 and not first.further.points:
        message = f"{sheet.place(pages[1].row, 0)} starts a second table"
        sheet.error(message, "Keep one of the two, or write 'z' and a breakpoint above each page.")
        return None
    return _cube(sheet, pages) if agree else None


def _report_difference(sheet: Sheet, axis: AxisCells, first: AxisCells) -> bool:
    if len(axis.points) != len(first.points):
        size, expected = count_noun(len(axis.points), "breakpoint"), len(first.points)
        message = f"{sheet.place(*axis.cells[0])} starts an axis of {size}, but the first page has {expected}"
        sheet.error(message)
        return True
    for point, cell, known, place in zip(axis.points, axis.cells, first.points, first.cells, strict=True):
        if point != known:
            message = f"{sheet.place(*cell)} contains {point:.15g}, but {sheet.place(*place)} contains {known:.15g}"
            sheet.error(message, "All pages of a table have the same breakpoints: change those of the first page.")
            return True
    return False


def _cube(sheet: Sheet, pages: list[_Page]) -> Grid | None:
    first = pages[0]
    known: dict[tuple[float, ...], _Page] = {}
    for page in pages:
        if known.setdefault(tuple(page.further.points), page) is not page:
            sheet.error(f"{sheet.place(page.row - 1, 1)} repeats an earlier page", "Keep one of the two.")
            return None
    higher = []
    for direction in range(len(first.further.points)):
        cells: dict[float, tuple[int, int]] = {}
        for page in pages:
            # in the order in which the pages have them first
            cells.setdefault(page.further.points[direction], page.further.cells[direction])
        higher.append(AxisCells(list(cells), list(cells.values())))
    places = list(product(*(axis.points for axis in higher)))
    missing = next((place for place in places if place not in known), None)
    if missing is not None:
        place = ", ".join(f"{letter} = {point:.15g}" for letter, point in zip(AXIS_LETTERS[2:], missing, strict=False))
        sheet.error(f"Sheet {sheet.name} has no page for {place}", "Add it.")
        return None
    # Float[x, y, pages], the last axis running fastest, as `product` yields the pages
    values = np.stack([known[place].values for place in places], axis=-1)
    values = values.reshape(*first.values.shape, *(len(axis.points) for axis in higher))
    axes = [first.x, *([first.y] if first.y else []), *higher]
    return Grid(values if first.y else values[:, 0], axes)


def _describe(sheet: Sheet, corner: int, grid: Grid) -> None:
    """Read the attributes of each axis from the lines above the numbers."""
    head = [word.casefold() for word in AXIS_HEADING]
    start = next((row for row in range(corner) if sheet.text(row, 0).strip().casefold() == head[0]), None)
    if start is None:
        return
    columns = {word: column for column, word in enumerate(sheet.words(start))}
    for row in range(start + 1, corner):
        letter = sheet.text(row, 0).strip().casefold()
        if not letter:
            return
        if letter in AXIS_LETTERS[: len(grid.axes)]:
            axis = grid.axes[AXIS_LETTERS.index(letter)]
            labels = (sheet.text(row, columns[word]) if word in columns else "" for word in head[1:])
            axis.input, axis.unit, axis.group = labels
