"""Reads the numbers of a table from its sheet and reports every wrong cell."""

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.excel.layout import AXIS_HEADING, CORNERS, LETTERS, Sheet, number_fault
from kennfeld.calfiles.format import Findings
from kennfeld.formatting import count_noun


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


def read_number(sheet: Sheet, row: int, column: int, findings: Findings) -> float | None:
    """Return the number of a cell; None with a finding where it holds none."""
    value = sheet.cell(row, column)
    fault = number_fault(value)
    if fault:
        remedy = "Write a number." if not _has_comma(value) else "Write it as a number: the cell contains text."
        findings.error(0, "", f"{sheet.place(row, column)} {fault}", remedy)
        return None
    assert isinstance(value, (int, float))
    number = float(value)
    if not np.isfinite(number):
        findings.error(0, "", f"{sheet.place(row, column)} must be finite, got {number}")
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


def read_grid(sheet: Sheet, findings: Findings) -> Grid | None:
    """Return the table of a sheet; None, with findings, if it is broken.

    A table ends where its breakpoints end, so that notes and sums may stand next to it or below it, apart from it.
    """
    corners = [row for row in range(len(sheet.rows)) if _is_corner(sheet, row)]
    if not corners:
        message = f"Sheet {sheet.name} contains no table"
        findings.error(
            0,
            "",
            message,
            f"Write {CORNERS[1]!r} into the cell above and left of the numbers, {CORNERS[0]!r} for a single row.",
        )
        return None
    pages = [_page(sheet, row, findings) for row in corners]
    whole = [page for page in pages if page is not None]
    if len(whole) < len(pages):
        return None
    grid = _stack_pages(sheet, whole, findings)
    if grid is not None:
        _describe(sheet, corners[0], grid)
    return grid


def _is_corner(sheet: Sheet, row: int) -> bool:
    cell = sheet.cell(row, 0)
    return isinstance(cell, str) and " ".join(cell.split()).casefold().startswith(CORNERS)


def _page(sheet: Sheet, row: int, findings: Findings) -> _Page | None:
    """Read the page whose corner is in a row."""
    x = _read_x_axis(sheet, row, findings)
    downwards = sheet.text(row, 0).strip().casefold().startswith("y")
    y = _read_y_axis(sheet, row, findings) if downwards else None
    further = _read_higher_axes(sheet, row, findings)
    if x is None or further is None or (downwards and y is None):
        return None
    rows = [cell[0] for cell in y.cells] if y else [row + 1]
    columns = [cell[1] for cell in x.cells]
    numbers = [[read_number(sheet, r, c, findings) for c in columns] for r in rows]
    _report_stray_numbers(sheet, row, rows, columns, downwards, findings)
    if any(number is None for line in numbers for number in line):
        return None
    values = np.array(numbers, dtype=np.float64).reshape(len(rows), len(columns)).T
    return _Page(row, further[0], further[1], x, y, values)


def _read_x_axis(sheet: Sheet, row: int, findings: Findings) -> AxisCells | None:
    end = 1
    while sheet.cell(row, end) is not None:
        end += 1
    return _axis(sheet, [(row, column) for column in range(1, end)], (row, 1), "x", findings)


def _read_y_axis(sheet: Sheet, row: int, findings: Findings) -> AxisCells | None:
    end = row + 1
    while sheet.cell(end, 0) is not None and not _is_end_of_table(sheet, end):
        end += 1
    return _axis(sheet, [(at, 0) for at in range(row + 1, end)], (row + 1, 0), "y", findings)


def _is_end_of_table(sheet: Sheet, row: int) -> bool:
    """Check whether a row below a table is not part of it, but a note or the next page."""
    return _is_corner(sheet, row) or (
        number_fault(sheet.cell(row, 0)) != ""
        and (number_fault(sheet.cell(row, 1)) != "" or sheet.text(row, 0).strip().casefold() == LETTERS[2])
    )


def _axis(
    sheet: Sheet, cells: list[tuple[int, int]], first: tuple[int, int], letter: str, findings: Findings
) -> AxisCells | None:
    if not cells:
        findings.error(0, "", f"{sheet.place(*first)} is empty; the {letter} breakpoints begin here")
        return None
    points = [read_number(sheet, *cell, findings) for cell in cells]
    known = [point for point in points if point is not None]
    return AxisCells(known, cells) if len(known) == len(points) else None


def _report_stray_numbers(
    sheet: Sheet, corner: int, rows: list[int], columns: list[int], downwards: bool, findings: Findings
) -> None:
    """Report numbers next to a table without a breakpoint."""
    right, below = columns[-1] + 1, rows[-1] + 1
    if any(not number_fault(sheet.cell(row, right)) for row in rows):
        message = f"{sheet.place(corner, right)} is empty; the numbers below it have no x breakpoint"
        findings.error(0, "", message, "Write the breakpoint, or leave an empty column next to the table.")
    is_page = sheet.text(below, 0).strip().casefold() == LETTERS[2]
    if downwards and not is_page and any(not number_fault(sheet.cell(below, column)) for column in columns):
        message = f"{sheet.place(below, 0)} is empty; the numbers next to it have no y breakpoint"
        findings.error(0, "", message, "Write the breakpoint, or leave an empty row below the table.")


def _read_higher_axes(sheet: Sheet, row: int, findings: Findings) -> tuple[list[float], list[tuple[int, int]]] | None:
    """Return the breakpoints in the row `z | 0.5 | w | 7` above a page; empty if there is none."""
    cells = []
    for column, letter in enumerate(LETTERS[2:]):
        if row == 0 or sheet.text(row - 1, 2 * column).strip().casefold() != letter:
            break
        if letter == LETTERS[2] and not number_fault(sheet.cell(row - 1, 0)):
            break
        cells.append((row - 1, 2 * column + 1))
    points = [read_number(sheet, *cell, findings) for cell in cells]
    known = [point for point in points if point is not None]
    return (known, cells) if len(known) == len(points) else None


def _stack_pages(sheet: Sheet, pages: list[_Page], findings: Findings) -> Grid | None:
    """Stack the pages into one table; they must have the same breakpoints and be complete."""
    first = pages[0]
    wrong = False
    for page in pages[1:]:
        pairs = [(page.x, first.x), (page.y, first.y)]
        differing = [
            pair for pair in pairs if pair[0] and pair[1] and _report_difference(sheet, pair[0], pair[1], findings)
        ]
        wrong |= bool(differing)
        if (page.y is None) != (first.y is None) or len(page.further) != len(first.further):
            findings.error(0, "", f"{sheet.place(page.row, 0)} starts a page with another layout than the first one")
            wrong = True
    if wrong:
        return None
    if len(pages) > 1 and not first.further:
        message = f"{sheet.place(pages[1].row, 0)} starts a second table"
        findings.error(0, "", message, "Keep one of the two, or write 'z' and a breakpoint above each page.")
        return None
    return _cube(sheet, pages, findings)


def _report_difference(sheet: Sheet, axis: AxisCells, first: AxisCells, findings: Findings) -> bool:
    if len(axis.points) != len(first.points):
        found, wanted = count_noun(len(axis.points), "breakpoint"), len(first.points)
        findings.error(
            0, "", f"{sheet.place(*axis.cells[0])} starts an axis of {found}, but the first page has {wanted}"
        )
        return True
    for point, cell, known, where in zip(axis.points, axis.cells, first.points, first.cells, strict=True):
        if point != known:
            message = f"{sheet.place(*cell)} contains {point:.15g}, but {sheet.place(*where)} contains {known:.15g}"
            findings.error(
                0, "", message, "All pages of a table have the same breakpoints: change those of the first page."
            )
            return True
    return False


def _cube(sheet: Sheet, pages: list[_Page], findings: Findings) -> Grid | None:
    first = pages[0]
    axes = [first.x, *([first.y] if first.y else [])]
    known: dict[tuple[float, ...], _Page] = {}
    for page in pages:
        if tuple(page.further) in known:
            findings.error(0, "", f"{sheet.place(page.row - 1, 1)} repeats an earlier page", "Keep one of the two.")
            return None
        known[tuple(page.further)] = page
    for direction in range(len(first.further)):
        results: dict[float, tuple[int, int]] = {}
        for page in pages:
            results.setdefault(page.further[direction], page.further_cells[direction])
        axes.append(AxisCells(list(results), list(results.values())))
    beyond = [axis.points for axis in axes[len(axes) - len(first.further) :]]
    missing = next((place for place in product(*beyond) if place not in known), None)
    if missing is not None:
        said = ", ".join(f"{letter} = {point:.15g}" for letter, point in zip(LETTERS[2:], missing, strict=False))
        findings.error(0, "", f"Sheet {sheet.name} has no page for {said}", "Add it.")
        return None
    pages_in_order = [known[place].values for place in product(*beyond)]
    values = np.stack(pages_in_order, axis=-1).reshape(*first.values.shape, *map(len, beyond))
    return Grid(values if first.y else values[:, 0], axes)


def _describe(sheet: Sheet, corner: int, grid: Grid) -> None:
    """Read the attributes of each axis from the lines above the numbers."""
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
