"""The numbers of a table on its sheet, with every cell that is wrong named."""

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.excel.layout import AXIS_HEADING, CORNERS, LETTERS, Sheet, number_fault
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import count_noun

__all__ = ["AxisCells", "Grid", "read_grid", "read_number"]


@dataclass
class AxisCells:
    """The breakpoints of one direction, the cell of each, and what the sheet says about the axis."""

    points: list[float]
    cells: list[tuple[int, int]]
    input: str = ""
    unit: str = ""
    group: str = ""


@dataclass
class Grid:
    """All numbers of a table, `values[i, j, ...]` at x number i, y number j; `axes` in the same order."""

    values: Float
    axes: list[AxisCells] = field(default_factory=list)


@dataclass(frozen=True)
class _Page:
    """One rectangle of numbers, with the breakpoints beyond x and y in the row above it."""

    row: int
    further: list[float]
    further_cells: list[tuple[int, int]]
    x: AxisCells
    y: AxisCells | None
    values: Float


def read_number(sheet: Sheet, row: int, column: int, notes: Findings) -> float | None:
    """The number of a cell; None with a finding where it holds none."""
    value = sheet.cell(row, column)
    fault = number_fault(value)
    if fault:
        remedy = "Write a number." if not _has_comma(value) else "Write it as a number: the cell holds text."
        notes.error(0, "", f"{sheet.place(row, column)} {fault}", remedy)
        return None
    assert isinstance(value, (int, float))
    number = float(value)
    if not np.isfinite(number):
        notes.error(0, "", f"{sheet.place(row, column)} holds {number}, which is not finite")
        return None
    return number


def _has_comma(value: object) -> bool:
    if not isinstance(value, str):
        return False
    try:
        float(value.replace(",", "."))
    except ValueError:
        return False
    return True


def read_grid(sheet: Sheet, notes: Findings) -> Grid | None:
    """The table of a sheet; None with findings where it is broken.

    A table ends where its breakpoints end, so that notes and sums may stand beside it or below it, apart from it.
    """
    corners = [row for row in range(len(sheet.rows)) if _is_corner(sheet, row)]
    if not corners:
        message = f"Sheet {sheet.name} holds no table"
        notes.error(
            0, "", message, f"Write {CORNERS[1]!r} into the cell left above the numbers, {CORNERS[0]!r} for a row."
        )
        return None
    pages = [_page(sheet, row, notes) for row in corners]
    whole = [page for page in pages if page is not None]
    if len(whole) < len(pages):
        return None
    grid = _stacked(sheet, whole, notes)
    if grid is not None:
        _describe(sheet, corners[0], grid)
    return grid


def _is_corner(sheet: Sheet, row: int) -> bool:
    cell = sheet.cell(row, 0)
    return isinstance(cell, str) and " ".join(cell.split()).casefold().startswith(CORNERS)


def _page(sheet: Sheet, row: int, notes: Findings) -> _Page | None:
    """One page, whose corner is in a row."""
    x = _across(sheet, row, notes)
    downwards = sheet.text(row, 0).strip().casefold().startswith("y")
    y = _down(sheet, row, notes) if downwards else None
    further = _further(sheet, row, notes)
    if x is None or further is None or (downwards and y is None):
        return None
    rows = [cell[0] for cell in y.cells] if y else [row + 1]
    columns = [cell[1] for cell in x.cells]
    numbers = [[read_number(sheet, r, c, notes) for c in columns] for r in rows]
    _stray(sheet, row, rows, columns, downwards, notes)
    if any(number is None for line in numbers for number in line):
        return None
    values = np.array(numbers, dtype=np.float64).reshape(len(rows), len(columns)).T
    return _Page(row, further[0], further[1], x, y, values)


def _across(sheet: Sheet, row: int, notes: Findings) -> AxisCells | None:
    end = 1
    while sheet.cell(row, end) is not None:
        end += 1
    return _axis(sheet, [(row, column) for column in range(1, end)], (row, 1), "x", notes)


def _down(sheet: Sheet, row: int, notes: Findings) -> AxisCells | None:
    end = row + 1
    while sheet.cell(end, 0) is not None and not _ends(sheet, end):
        end += 1
    return _axis(sheet, [(at, 0) for at in range(row + 1, end)], (row + 1, 0), "y", notes)


def _ends(sheet: Sheet, row: int) -> bool:
    """Whether a row below a table is no row of it: a note, or the beginning of the next page."""
    return _is_corner(sheet, row) or (
        number_fault(sheet.cell(row, 0)) != ""
        and (number_fault(sheet.cell(row, 1)) != "" or sheet.text(row, 0).strip().casefold() == LETTERS[2])
    )


def _axis(
    sheet: Sheet, cells: list[tuple[int, int]], first: tuple[int, int], letter: str, notes: Findings
) -> AxisCells | None:
    if not cells:
        notes.error(0, "", f"{sheet.place(*first)} is empty; the {letter} breakpoints begin here")
        return None
    points = [read_number(sheet, *cell, notes) for cell in cells]
    known = [point for point in points if point is not None]
    return AxisCells(known, cells) if len(known) == len(points) else None


def _stray(sheet: Sheet, corner: int, rows: list[int], columns: list[int], downwards: bool, notes: Findings) -> None:
    """Numbers right beside a table that belong to no breakpoint: one was deleted, or is still missing."""
    right, below = columns[-1] + 1, rows[-1] + 1
    if any(not number_fault(sheet.cell(row, right)) for row in rows):
        message = f"{sheet.place(corner, right)} is empty; the numbers below it have no x breakpoint"
        notes.error(0, "", message, "Write the breakpoint, or leave a column free beside the table.")
    is_page = sheet.text(below, 0).strip().casefold() == LETTERS[2]
    if downwards and not is_page and any(not number_fault(sheet.cell(below, column)) for column in columns):
        message = f"{sheet.place(below, 0)} is empty; the numbers beside it have no y breakpoint"
        notes.error(0, "", message, "Write the breakpoint, or leave a row free below the table.")


def _further(sheet: Sheet, row: int, notes: Findings) -> tuple[list[float], list[tuple[int, int]]] | None:
    """The breakpoints in the row `z | 0.5 | w | 7` above a page; empty where there is none."""
    cells = []
    for column, letter in enumerate(LETTERS[2:]):
        if row == 0 or sheet.text(row - 1, 2 * column).strip().casefold() != letter:
            break
        if letter == LETTERS[2] and not number_fault(sheet.cell(row - 1, 0)):
            break
        cells.append((row - 1, 2 * column + 1))
    points = [read_number(sheet, *cell, notes) for cell in cells]
    known = [point for point in points if point is not None]
    return (known, cells) if len(known) == len(points) else None


def _stacked(sheet: Sheet, pages: list[_Page], notes: Findings) -> Grid | None:
    """The pages as one table; they must have the same breakpoints and fill every place."""
    first = pages[0]
    wrong = False
    for page in pages[1:]:
        pairs = [(page.x, first.x), (page.y, first.y)]
        differing = [pair for pair in pairs if pair[0] and pair[1] and _differs(sheet, pair[0], pair[1], notes)]
        wrong |= bool(differing)
        if (page.y is None) != (first.y is None) or len(page.further) != len(first.further):
            notes.error(0, "", f"{sheet.place(page.row, 0)} begins a page of another form than the first one")
            wrong = True
    if wrong:
        return None
    if len(pages) > 1 and not first.further:
        message = f"{sheet.place(pages[1].row, 0)} begins a second table"
        notes.error(0, "", message, "Keep one of the two, or write 'z' and a breakpoint above each page.")
        return None
    return _cube(sheet, pages, notes)


def _differs(sheet: Sheet, axis: AxisCells, first: AxisCells, notes: Findings) -> bool:
    if len(axis.points) != len(first.points):
        found, wanted = count_noun(len(axis.points), "breakpoint"), len(first.points)
        notes.error(
            0, "", f"{sheet.place(*axis.cells[0])} begins an axis of {found}, that of the first page has {wanted}"
        )
        return True
    for point, cell, known, where in zip(axis.points, axis.cells, first.points, first.cells, strict=True):
        if point != known:
            message = f"{sheet.place(*cell)} holds {point:.15g}, {sheet.place(*where)} holds {known:.15g}"
            notes.error(
                0, "", message, "All pages of a table have the same breakpoints: change those of the first page."
            )
            return True
    return False


def _cube(sheet: Sheet, pages: list[_Page], notes: Findings) -> Grid | None:
    first = pages[0]
    axes = [first.x, *([first.y] if first.y else [])]
    known: dict[tuple[float, ...], _Page] = {}
    for page in pages:
        if tuple(page.further) in known:
            notes.error(
                0, "", f"{sheet.place(page.row - 1, 1)} gives a page that was there before", "Keep one of the two."
            )
            return None
        known[tuple(page.further)] = page
    for direction in range(len(first.further)):
        found: dict[float, tuple[int, int]] = {}
        for page in pages:
            found.setdefault(page.further[direction], page.further_cells[direction])
        axes.append(AxisCells(list(found), list(found.values())))
    beyond = [axis.points for axis in axes[len(axes) - len(first.further) :]]
    missing = next((place for place in product(*beyond) if place not in known), None)
    if missing is not None:
        said = ", ".join(f"{letter} = {point:.15g}" for letter, point in zip(LETTERS[2:], missing, strict=False))
        notes.error(0, "", f"Sheet {sheet.name} has no page for {said}", "Add it.")
        return None
    pages_in_order = [known[place].values for place in product(*beyond)]
    values = np.stack(pages_in_order, axis=-1).reshape(*first.values.shape, *map(len, beyond))
    return Grid(values if first.y else values[:, 0], axes)


def _describe(sheet: Sheet, corner: int, grid: Grid) -> None:
    """What the lines above the numbers say about each axis."""
    head = [word.casefold() for word in AXIS_HEADING]
    start = next((row for row in range(corner) if sheet.text(row, 0).strip().casefold() == head[0]), None)
    if start is None:
        return
    columns = {sheet.text(start, column).strip().casefold(): column for column in range(sheet.width(start))}
    for row in range(start + 1, corner):
        letter = sheet.text(row, 0).strip().casefold()
        if not letter:
            return
        if letter in LETTERS[: len(grid.axes)]:
            axis = grid.axes[LETTERS.index(letter)]
            said = {word: sheet.text(row, columns[word]) for word in head[1:] if word in columns}
            axis.input, axis.unit, axis.group = (said.get(word, "") for word in head[1:])
