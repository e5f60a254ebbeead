"""Reader of spreadsheets: xlsx, xlsm, xlsb, xls and ods."""

from dataclasses import replace

import numpy as np

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import nearest
from kennfeld.base.workbooks import UnsavedFormulas, Workbook, column_letters, open_workbook
from kennfeld.measurement.header import find_header, header_remarks
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Column, ColumnBuilder, Selection, Table

_HEAD_ROWS = 200


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the numeric tables of a workbook, one per sheet, or that of the sheet that `source` names."""
    with source.path.open("rb") as stream:
        book = open_workbook(source.name, stream)
        sheets = _sheets(source, book)
        candidates = [_table(source, name, book.cells(name), selection) for name in sheets]
        unsaved = [book.unsaved_formulas(name) for name in sheets]
    pairs = zip(candidates, unsaved, strict=True)
    tables = [_with_warning(source, table, formulas) for table, formulas in pairs if table is not None]
    if not tables and any(unsaved):
        raise InputError(Finding(source.location, str(f), f.remedy) for f in unsaved if f is not None)
    if not tables:
        where = f"sheet {sheets[0]}" if len(sheets) == 1 else f"none of its {len(sheets)} sheets"
        message = f"{where} holds {'no' if len(sheets) == 1 else 'a'} row of names with numbers below"
        remedy = "Put the names of the channels into the row above the numbers."
        raise InputError.of(source.location, message, remedy)
    return tables


def _with_warning(source: MeasurementFile, table: Table, formulas: UnsavedFormulas | None) -> Table:
    if formulas is None:
        return table
    message = f"{formulas}; they are read as missing"
    finding = Finding(source.location, message, formulas.remedy, severity="warning")
    return replace(table, findings=(*table.findings, finding))


def _sheets(source: MeasurementFile, book: Workbook) -> list[str]:
    if source.sheet is None:
        return book.visible or book.names
    if source.sheet not in book.names:
        remedy = nearest(source.sheet, book.names) or f"It has {', '.join(book.names)}."
        raise InputError.of(source.location, f"has no sheet {source.sheet}", remedy)
    return [source.sheet]


def _table(source: MeasurementFile, sheet: str, grid: list[list[object]], selection: Selection) -> Table | None:
    header = find_header(grid[:_HEAD_ROWS])
    if header is None:
        return None
    rows = [i for i in range(header.data, len(grid)) if any(str(cell).strip() for cell in grid[i])]

    def build(index: int) -> Column:
        name = header.names[index]
        builder = ColumnBuilder(name, header.units[index], f"{column_letters(index)} ({name})")
        builder.add([grid[row][index] for row in rows])
        return builder.build()

    location = source.location.within(f"sheet {sheet}")
    return Table(
        location,
        tuple(map(build, selection.wants(header))),
        np.array(rows, dtype=np.int64) + 1,
        row_word="row",
        names=header.names,
        findings=tuple(header_remarks(location, header)),
        details=(("sheet", sheet), ("names in row", str(header.row + 1))),
    )
