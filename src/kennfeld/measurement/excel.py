"""Reader of spreadsheets: xlsx, xlsm, xlsb, xls and ods."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.measurement.cells import is_missing
from kennfeld.measurement.file_kind import MeasurementFile
from kennfeld.measurement.header import Header, find_header
from kennfeld.measurement.table import ColumnBuilder, Selection, Table
from kennfeld.workbooks import Unsaved, Workbook, column_letters, opened

_HEAD_ROWS = 200


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the numeric tables of a workbook, one per sheet, or that of the sheet that `source` names."""
    with source.path.open("rb") as stream:
        book = opened(source.name, stream)
        sheets = _sheets(source, book)
        tables = [_table(source, name, book.cells(name), selection) for name in sheets]
        unsaved = [book.unsaved(name) for name in sheets]
    remarked = [
        _remarked(source, table, formulas) for table, formulas in zip(tables, unsaved, strict=True) if table is not None
    ]
    if not remarked and any(unsaved):
        raise InputError(Finding(source.name, str(one), one.remedy) for one in unsaved if one is not None)
    if not remarked:
        where = f"sheet {sheets[0]}" if len(sheets) == 1 else f"none of its {len(sheets)} sheets"
        message = f"{where} holds {'no' if len(sheets) == 1 else 'a'} row of names with numbers below"
        raise InputError.of(source.name, message, "Put the names of the channels into the row above the numbers.")
    return remarked


def _remarked(source: MeasurementFile, table: Table, unsaved: Unsaved | None) -> Table:
    if unsaved is None:
        return table
    message = f"{unsaved}; they are read as missing"
    return replace(table, remarks=(*table.remarks, Finding(source.name, message, unsaved.remedy, severity="warning")))


def _sheets(source: MeasurementFile, book: Workbook) -> list[str]:
    if source.sheet is None:
        return book.visible or book.names
    if source.sheet not in book.names:
        remedy = nearest(source.sheet, book.names) or f"It has {', '.join(book.names)}."
        raise InputError.of(source.name, f"has no sheet {source.sheet}", remedy)
    return [source.sheet]


def _table(source: MeasurementFile, sheet: str, grid: list[list[object]], selection: Selection) -> Table | None:
    header = find_header(grid[:_HEAD_ROWS])
    if header is None:
        return None
    rows = [i for i in range(header.data, len(grid)) if any(not _is_blank(cell) for cell in grid[i])]
    return Table(
        f"{source.name} sheet {sheet}",
        tuple(_column(header, i, [grid[row][i] for row in rows]) for i in selection.wants(header)),
        np.array(rows, dtype=np.int64) + 1,
        row_word="row",
        names=header.names,
        details=(("sheet", sheet), ("names in row", str(header.row + 1))),
    )


def _is_blank(cell: object) -> bool:
    return isinstance(cell, str) and is_missing(cell) and not cell.strip()


def _column(header: Header, index: int, cells: Sequence[object]) -> Any:
    name = header.names[index]
    builder = ColumnBuilder(name, header.units[index], f"{column_letters(index)} ({name})")
    builder.add(cells)
    return builder.built()
