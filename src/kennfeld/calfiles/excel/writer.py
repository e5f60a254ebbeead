"""Writes parameters as an Excel workbook with one sheet per table."""

import re
from collections.abc import Iterator, Sequence
from datetime import datetime
from io import BytesIO
from itertools import product
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import holds_control_characters, size_text
from kennfeld.base.workbooks import column_letters
from kennfeld.calfiles.content import stored_breakpoints, turn
from kennfeld.calfiles.excel import layout
from kennfeld.calfiles.excel.layout import sheet_names
from kennfeld.calfiles.format import FileFindings, Item, WriteResult
from kennfeld.calfiles.storable import USE_JSON, differing_groups, report_repeated, value_faults
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text

_MAX_ROWS, _MAX_COLUMNS, _MAX_TEXT = 1_048_576, 16_384, 32_767  # limits of Excel
# Excel takes 65 530 links a sheet
_MAX_LINKS = 60_000
# xlsxwriter takes text between <r> and </r> for markup
_UNFIT = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff\ufffe\uffff]|\A<r>(?=.*</r>\Z)", re.DOTALL)
_FIXED_DATE = datetime(2000, 1, 1)  # the same set gives the same bytes
_COLOURS = {"min_color": "#63BE7B", "mid_color": "#FFEB84", "max_color": "#F8696B"}


def write_excel(parameters: ParameterSet, file: str) -> WriteResult:
    """Return a set as .xlsx: an index, lists of single values and texts, one sheet per table and variant.

    Numbers read back exactly. Bounds, locks and extrapolation have no place. Raises `InputError` naming every
    parameter that does not fit: expansions, non-finite values, tables beyond the size of a sheet.
    """
    import xlsxwriter

    _refuse(parameters, file)
    stream = BytesIO()
    options = {"in_memory": True, "strings_to_formulas": False, "strings_to_urls": False, "strings_to_numbers": False}
    with xlsxwriter.Workbook(stream, options) as book:
        book.set_properties({"created": _FIXED_DATE})
        _WorkbookWriter(book, parameters).write()
    return WriteResult(stream.getvalue())


class _WorkbookWriter:
    def __init__(self, book: Any, parameters: ParameterSet) -> None:
        self.book = book
        self.parameters = parameters
        self.items: list[Item] = [*parameters.chosen, *parameters.others]
        tables = [item for item in self.items if isinstance(item, Parameter) and not _is_single(item)]
        titles = [f"{table.name} {table.variant}" if table.variant else table.name for table in tables]
        self.tables = dict(zip(map(id, tables), sheet_names(titles), strict=True))
        self.axis_rows = {axis.name: row for row, axis in enumerate(parameters.axes, 1)}
        self.sheet_type = _exact_sheet_class()
        self.bold = book.add_format({"bold": True})
        self.head = book.add_format({"bold": True, "bg_color": "#D9D9D9", "bottom": 1})
        self.axis = book.add_format({"bold": True, "bg_color": "#DDEBF7", "border": 1, "border_color": "#BFBFBF"})
        self.group = book.add_format({"italic": True, "bg_color": "#E2EFDA", "border": 1, "border_color": "#BFBFBF"})
        self.link = book.add_format({"font_color": "#0563C1", "underline": 1})

    def write(self) -> None:
        """Write all sheets, the index first."""
        singles = [item for item in self.items if isinstance(item, Parameter) and _is_single(item)]
        texts = [item for item in self.items if isinstance(item, Text)]
        self._list(layout.INDEX, layout.INDEX_HEADING, map(self._index_row, self.items), links=True)
        if singles:
            numbers = ((m.name, m.values.item(), m.unit, m.description, *_labels(m), _size(m)) for m in singles)
            self._list(layout.SCALARS, layout.SCALARS_HEADING, numbers)
        if texts:
            words = ((text.name, text.text, text.description, *_labels(text)) for text in texts)
            self._list(layout.TEXTS, layout.TEXTS_HEADING, words)
        if self.parameters.axes:
            self._group_axes()
        for item in self.items:
            if isinstance(item, Parameter) and id(item) in self.tables:
                self._table(item)

    def _sheet(self, name: str) -> Any:
        return self.book.add_worksheet(name, worksheet_class=self.sheet_type)

    def _list(self, name: str, heading: Sequence[str], rows: Any, links: bool = False) -> None:
        sheet = self._sheet(name)
        last = 0
        for last, row in enumerate([heading, *rows]):
            for column, cell in enumerate(row):
                if isinstance(cell, float):
                    sheet.write_number(last, column, cell)
                elif links and 0 < last < _MAX_LINKS and column == len(heading) - 1:
                    self._link(sheet, last, column, cell)
                else:
                    sheet.write_string(last, column, cell, self.head if last == 0 else None)
        sheet.freeze_panes(1, 1)
        sheet.autofilter(0, 0, max(last, 1), len(heading) - 1)
        sheet.set_column(0, 0, 32)
        sheet.set_column(1, len(heading) - 1, 14)
        sheet.set_column(heading.index("description"), heading.index("description"), 48)

    def _link(self, sheet: Any, row: int, column: int, target: str, text: str = "") -> None:
        quoted = target.replace("'", "''")
        sheet.write_url(row, column, f"internal:'{quoted}'!A1", self.link, text or target)

    def _index_row(self, item: Item) -> tuple[str, ...]:
        sheet = layout.TEXTS if isinstance(item, Text) else self.tables.get(id(item), layout.SCALARS)
        return (item.name, item.kind, _size(item), item.unit, item.description, *_labels(item), sheet)

    def _group_axes(self) -> None:
        sheet = self._sheet(layout.AXES)
        sheet.write_row(0, 0, layout.AXES_HEADING, self.head)
        for row, axis in enumerate(self.parameters.axes, 1):
            for column, word in enumerate((axis.name, axis.unit, axis.input)):
                sheet.write_string(row, column, word, self.bold if column == 0 else None)
            sheet.write_row(row, len(layout.AXES_HEADING) - 1, stored_breakpoints(axis).tolist(), self.axis)
        sheet.freeze_panes(1, 1)
        sheet.set_column(0, 0, 32)

    def _table(self, table: Parameter) -> None:
        sheet = self._sheet(self.tables[id(table)])
        self._link(sheet, 0, 0, layout.INDEX, table.name)
        sheet.write_string(0, 1, f"{table.kind} [{table.unit}]" if table.unit else table.kind, self.bold)
        sheet.write_string(1, 0, table.description)
        row = self._axis_rows(sheet, table) if table.axes else 2
        self._pages(sheet, table, row + 1)
        sheet.set_column(0, 0, 24)

    def _axis_rows(self, sheet: Any, table: Parameter) -> int:
        sheet.write_row(3, 0, layout.AXIS_HEADING, self.head)
        for row, (letter, axis) in enumerate(zip(AXIS_LETTERS, table.axes, strict=False), 4):
            for column, word in enumerate((letter, axis.input, axis.unit)):
                sheet.write_string(row, column, word)
            if axis.name:
                self._link(sheet, row, 3, layout.AXES, axis.name)
        return 4 + len(table.axes)

    def _pages(self, sheet: Any, table: Parameter, row: int) -> None:
        """Write the numbers of a table, a page for each of its breakpoints beyond x and y."""
        x, *others = table.index_axes
        y, further = others[:1], others[1:]
        stored = turn(table.values, table.axes)
        # a curve is a page with a single row
        values = stored if y else stored[:, None]
        first = row + bool(further)  # of the corner of the first page
        written: dict[tuple[int, int], tuple[int, int]] = {}  # the cell of each breakpoint beyond x and y
        # z runs fastest
        for page, reversed_indices in enumerate(product(*(range(len(axis)) for axis in further[::-1]))):
            indices = reversed_indices[::-1]
            for number, (letter, axis, at) in enumerate(zip(AXIS_LETTERS[2:], further, indices, strict=False)):
                # the row `z | 0.5 | w | 7` above a page; a breakpoint that comes again follows the first one
                cell = (row, 2 * number + 1)
                sheet.write_string(row, 2 * number, letter, self.head)
                self._point(sheet, cell, axis, at, written.get((number, at)))
                written.setdefault((number, at), cell)
            row += bool(further)
            sheet.write_string(row, 0, _corner(table), self.head)
            for at in range(len(x)):
                self._point(sheet, (row, at + 1), x, at, (first, at + 1) if page else None)
            for at in range(len(y[0]) if y else 0):
                self._point(sheet, (row + at + 1, 0), y[0], at, (first + at + 1, 0) if page else None)
            if not y:
                sheet.write_string(row + 1, 0, f"values [{table.unit}]" if table.unit else "values", self.axis)
            # transposed, the further axes come first, so that their indices choose a page
            self._numbers(sheet, row + 1, values.T[reversed_indices].T)
            row += 2 + values.shape[1]
        sheet.freeze_panes(0 if further else first + 1, 1)

    def _point(self, sheet: Any, cell: tuple[int, int], axis: Axis, at: int, original: tuple[int, int] | None) -> None:
        """Write a breakpoint; it follows the cell `original` of an earlier page, or the sheet of group axes."""
        point = float(stored_breakpoints(axis)[at])
        source = "" if original is None else _cell_name(*original)
        if axis.name and not source:
            source = f"{layout.AXES}!{_cell_name(self.axis_rows[axis.name], at + len(layout.AXES_HEADING) - 1)}"
        if source:
            sheet.write_formula(*cell, f"={source}", self.group, point)
        else:
            sheet.write_number(*cell, point, self.axis)

    def _numbers(self, sheet: Any, row: int, values: Float) -> None:
        """Write a page of numbers with its heat colours; `values` is indexed x, y."""
        width, height = values.shape
        for at, line in enumerate(values.T.tolist()):
            sheet.write_row(row + at, 1, line)
        sheet.conditional_format(row, 1, row + height - 1, width, {"type": "3_color_scale", **_COLOURS})


def _cell_name(row: int, column: int) -> str:
    return f"{column_letters(column)}{row + 1}"


def _exact_sheet_class() -> type:
    from xlsxwriter.worksheet import Worksheet

    class ExactSheet(Worksheet):  # type: ignore[misc]
        """A sheet whose numbers read back exactly: xlsxwriter itself writes 16 digits, some numbers need 17."""

        # xlsxwriter has no public setting for the digits; a test of exact round trips fails if this is not called
        def _xml_number_element(self, number: float, attributes: Sequence[tuple[str, str]] = ()) -> None:
            written = "".join(f' {key}="{value}"' for key, value in attributes)
            self.fh.write(f"<c{written}><v>{float(number)!r}</v></c>")

    return ExactSheet


def _is_single(member: Parameter) -> bool:
    """Check whether a parameter is a single value, which goes to the sheet of scalars."""
    return member.size == 1 and not member.axes


def _labels(item: Item) -> tuple[str, str, str]:
    return ", ".join(item.functions), item.display_name, item.variant


def _size(item: Item) -> str:
    return size_text(item.values.shape) if isinstance(item, Parameter) else ""


def _corner(table: Parameter) -> str:
    corner = layout.CORNERS[table.values.ndim > 1]
    if not table.axes:
        return corner
    labels = [f"{axis.input} [{axis.unit}]".replace("[]", "").strip() for axis in table.axes[:2][::-1]]
    return f"{corner}: {' / '.join(labels)}" if any(labels) else corner


def _refuse(parameters: ParameterSet, file: str) -> None:
    findings = FileFindings(file)
    report_repeated((item.name for item in parameters.chosen), findings)  # the index could not distinguish them
    for item in (*parameters.chosen, *parameters.others, *parameters.axes):
        if not item.name.strip() or item.name != item.name.strip() or holds_control_characters(item.name):
            findings.error(0, item.name, f"{item.name!r} is not a valid name in Excel", "Rename it.")
        for message in _text_faults(item):
            findings.error(0, item.name, message, USE_JSON)
        for message in _faults(item, parameters) if isinstance(item, Parameter) else ():
            findings.error(0, item.name, message, USE_JSON)
    findings.finish()


def _text_faults(item: Item | Axis) -> Iterator[str]:
    axes = item.axes if isinstance(item, Parameter) else (item,) if isinstance(item, Axis) else ()
    words = [item.name, *(word for axis in axes for word in (axis.name, axis.unit, axis.input))]
    if not isinstance(item, Axis):
        words += [item.description, *_labels(item), item.unit, *([item.text] if isinstance(item, Text) else [])]
        if any("," in name or name != name.strip() or not name for name in item.functions):
            names = ", ".join(item.functions)
            yield f"function names must not be empty or contain commas or surrounding blanks: {names!r}"
    if any(_UNFIT.search(word) for word in words):
        yield "an Excel cell cannot store text with control characters, or text between <r> and </r>"
    if any(len(word) > _MAX_TEXT for word in words):
        yield f"an Excel cell stores at most {_MAX_TEXT} characters"


def _faults(member: Parameter, parameters: ParameterSet) -> Iterator[str]:
    yield from value_faults(member, "Excel")
    if member.kind == "rbf":
        return
    sizes = [*member.values.shape, 1, 1]
    rows = (sizes[1] + 3) * int(np.prod(sizes[2:])) + 10
    if sizes[0] >= _MAX_COLUMNS - len(layout.AXES_HEADING) or rows >= _MAX_ROWS:
        yield f"an Excel sheet cannot store its {_size(member)} values"
    for name in differing_groups(member, parameters):
        yield f"the variant {member.variant!r} has other breakpoints for the group axis {name}"
