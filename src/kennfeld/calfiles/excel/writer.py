"""Writes parameters as an Excel workbook with one sheet per table."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from datetime import datetime
from io import BytesIO
from itertools import product
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.excel.layout import (
    AXES,
    AXES_HEADING,
    AXIS_HEADING,
    CORNERS,
    INDEX,
    INDEX_HEADING,
    LETTERS,
    SCALARS,
    SCALARS_HEADING,
    TEXTS,
    TEXTS_HEADING,
    sheet_names,
)
from kennfeld.calfiles.format import Findings, WriteResult
from kennfeld.formatting import holds_control_characters
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text
from kennfeld.workbooks import column_letters

Item = Parameter | Text
_MAX_ROWS, _MAX_COLUMNS, _MAX_TEXT = 1_048_576, 16_384, 32_767  # limits of Excel
_MAX_LINKS = 60_000
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
        self.tables = dict(zip(map(id, tables), sheet_names(_title(table) for table in tables), strict=True))
        self.axis_rows = {axis.name: row for row, axis in enumerate(parameters.axes, 1)}
        self.sheet_type = _exact_sheet_class()
        self.bold = book.add_format({"bold": True})
        self.head = book.add_format({"bold": True, "bg_color": "#D9D9D9", "bottom": 1})
        self.axis = book.add_format({"bold": True, "bg_color": "#DDEBF7", "border": 1, "border_color": "#BFBFBF"})
        self.group = book.add_format({"italic": True, "bg_color": "#E2EFDA", "border": 1, "border_color": "#BFBFBF"})
        self.link = book.add_format({"font_color": "#0563C1", "underline": 1})

    def write(self) -> None:
        """Write all sheets, the index first."""
        singles = [t for t in self.items if isinstance(t, Parameter) and _is_single(t)]
        texts = [t for t in self.items if isinstance(t, Text)]
        self._list(INDEX, INDEX_HEADING, map(self._index_row, self.items), links=True)
        if singles:
            self._list(SCALARS, SCALARS_HEADING, map(_scalar_row, singles))
        if texts:
            self._list(TEXTS, TEXTS_HEADING, map(_text_row, texts))
        if self.parameters.axes:
            self._group_axes()
        for item in self.items:
            if id(item) in self.tables:
                assert isinstance(item, Parameter)
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
        if isinstance(item, Text):
            return (item.name, item.kind, "", item.unit, item.description, *_labels(item), TEXTS)
        size = "" if item.kind == "scalar" else _size(item)
        sheet = self.tables.get(id(item), SCALARS)
        return (item.name, item.kind, size, item.unit, item.description, *_labels(item), sheet)

    def _group_axes(self) -> None:
        sheet = self._sheet(AXES)
        for column, word in enumerate(AXES_HEADING):
            sheet.write_string(0, column, word, self.head)
        for row, axis in enumerate(self.parameters.axes, 1):
            for column, word in enumerate((axis.name, axis.unit, axis.input)):
                sheet.write_string(row, column, word, self.bold if column == 0 else None)
            for column, point in enumerate(axis.breakpoints.tolist(), len(AXES_HEADING) - 1):
                sheet.write_number(row, column, point, self.axis)
        sheet.freeze_panes(1, 1)
        sheet.set_column(0, 0, 32)

    def _table(self, table: Parameter) -> None:
        sheet = self._sheet(self.tables[id(table)])
        self._link(sheet, 0, 0, INDEX, table.name)
        sheet.write_string(0, 1, f"{table.kind} [{table.unit}]" if table.unit else table.kind, self.bold)
        sheet.write_string(1, 0, table.description)
        row = 2
        if table.axes:
            row = self._axis_rows(sheet, table)
        values = table.values if table.values.ndim > 1 else table.values[:, None]
        axes = [*table.index_axes, *[None] * (table.values.ndim == 1)]
        self._pages(sheet, table, values, axes, row + 1)
        sheet.set_column(0, 0, 24)

    def _axis_rows(self, sheet: Any, table: Parameter) -> int:
        for column, word in enumerate(AXIS_HEADING):
            sheet.write_string(3, column, word, self.head)
        for row, (letter, axis) in enumerate(zip(LETTERS, table.axes, strict=False), 4):
            for column, word in enumerate((letter, axis.input, axis.unit)):
                sheet.write_string(row, column, word)
            if axis.name:
                self._link(sheet, row, 3, AXES, axis.name)
        return 4 + len(table.axes)

    def _pages(self, sheet: Any, table: Parameter, values: Float, axes: list[Axis | None], row: int) -> None:
        """Return the numbers of a table, a page for each of its breakpoints beyond x and y."""
        x, y, *further = axes
        assert x is not None
        first = row + bool(further)  # of the corner of the first page
        written: dict[tuple[int, int], str] = {}  # the cell of each breakpoint beyond x and y
        pages = product(*(range(len(axis)) for axis in further[::-1] if axis is not None))
        for page, indices in enumerate(pages):
            self._page_heading(sheet, further, indices[::-1], row, written)
            row += bool(further)
            sheet.write_string(row, 0, _corner(table), self.head)
            original = first if page else None
            self._across(sheet, x, row, original)
            if y is not None:
                self._down(sheet, y, row, original)
            elif len(axes) == 2:
                sheet.write_string(row + 1, 0, f"values [{table.unit}]" if table.unit else "values", self.axis)
            self._numbers(sheet, row + 1, values.T[indices].T)
            row += 2 + values.shape[1]
        sheet.freeze_panes(0 if further else first + 1, 1)

    def _page_heading(
        self,
        sheet: Any,
        axes: list[Axis | None],
        indices: tuple[int, ...],
        row: int,
        written: dict[tuple[int, int], str],
    ) -> None:
        """Return the row `z | 0.5 | w | 7` above a page; a breakpoint that comes again follows the first one."""
        for column, (letter, axis, at) in enumerate(zip(LETTERS[2:], axes, indices, strict=False)):
            assert axis is not None
            sheet.write_string(row, 2 * column, letter, self.head)
            known = written.get((column, at))
            if known:
                sheet.write_formula(row, 2 * column + 1, known, self.group, float(axis.breakpoints[at]))
            else:
                self._point(sheet, row, 2 * column + 1, axis, at)
                written[column, at] = f"={column_letters(2 * column + 1)}{row + 1}"

    def _across(self, sheet: Any, axis: Axis, row: int, original: int | None) -> None:
        """Return the x breakpoints in a row; those of a later page follow the ones in the row `original`."""
        for at, point in enumerate(axis.breakpoints.tolist()):
            if original is None:
                self._point(sheet, row, at + 1, axis, at)
            else:
                sheet.write_formula(row, at + 1, f"={column_letters(at + 1)}{original + 1}", self.group, point)

    def _down(self, sheet: Any, axis: Axis, row: int, original: int | None) -> None:
        """Return the y breakpoints below a row; those of a later page follow the ones below the row `original`."""
        for at, point in enumerate(axis.breakpoints.tolist(), 1):
            if original is None:
                self._point(sheet, row + at, 0, axis, at - 1)
            else:
                sheet.write_formula(row + at, 0, f"=A{original + at + 1}", self.group, point)

    def _point(self, sheet: Any, row: int, column: int, axis: Axis, at: int) -> None:
        point = float(axis.breakpoints[at])
        if axis.name:
            source = f"={AXES}!{column_letters(at + len(AXES_HEADING) - 1)}{self.axis_rows[axis.name] + 1}"
            sheet.write_formula(row, column, source, self.group, point)
        else:
            sheet.write_number(row, column, point, self.axis)

    def _numbers(self, sheet: Any, row: int, values: Float) -> None:
        """Return a page of numbers with its heat colours; `values` is indexed x, y."""
        width, height = values.shape
        for at, line in enumerate(values.T.tolist()):
            for column, number in enumerate(line, 1):
                sheet.write_number(row + at, column, number)
        sheet.conditional_format(row, 1, row + height - 1, width, {"type": "3_color_scale", **_COLOURS})


def _exact_sheet_class() -> type:
    from xlsxwriter.worksheet import Worksheet

    class ExactSheet(Worksheet):  # type: ignore[misc]
        """A sheet whose numbers read back exactly: xlsxwriter itself writes 16 digits, some numbers need 17."""

        def _xml_number_element(self, number: float, attributes: Sequence[tuple[str, str]] = ()) -> None:
            written = "".join(f' {key}="{value}"' for key, value in attributes)
            self.fh.write(f"<c{written}><v>{float(number)!r}</v></c>")

    return ExactSheet


def _is_single(member: Parameter) -> bool:
    """Check whether a parameter is a single value, which goes to the sheet of scalars."""
    return member.size == 1 and not member.axes


def _scalar_row(member: Parameter) -> tuple[str | float, ...]:
    size = "" if member.kind == "scalar" else _size(member)
    return (member.name, float(member.values.ravel()[0]), member.unit, member.description, *_labels(member), size)


def _text_row(text: Text) -> tuple[str, ...]:
    return (text.name, text.text, text.description, *_labels(text))


def _labels(item: Item) -> tuple[str, str, str]:
    return ", ".join(item.functions), item.display_name, item.variant


def _size(member: Parameter) -> str:
    return " x ".join(map(str, member.values.shape))


def _title(table: Parameter) -> str:
    return f"{table.name} {table.variant}" if table.variant else table.name


def _corner(table: Parameter) -> str:
    corner = CORNERS[table.values.ndim > 1]
    if not table.axes:
        return corner
    said = [f"{axis.input} [{axis.unit}]".replace("[]", "").strip() for axis in table.axes[:2][::-1]]
    return f"{corner}: {' / '.join(said)}" if any(said) else corner


def _refuse(parameters: ParameterSet, file: str) -> None:
    findings = Findings(file)
    _refuse_twice(parameters, findings)
    groups = {axis.name: axis for axis in parameters.axes}
    for item in (*parameters.chosen, *parameters.others, *parameters.axes):
        if not item.name.strip() or item.name != item.name.strip() or holds_control_characters(item.name):
            findings.error(0, item.name, f"{item.name!r} is not a valid name in Excel", "Rename it.")
        faults = [*_text_faults(item), *(_faults(item, groups) if isinstance(item, Parameter) else ())]
        for message in faults:
            findings.error(0, item.name, message, "Write it as .json.")
    findings.finish()


def _refuse_twice(parameters: ParameterSet, findings: Findings) -> None:
    """Report names used twice, which the index could not distinguish."""
    names = Counter([*parameters, *(text.name for text in parameters.texts)])
    for name in (name for name, count in names.items() if count > 1):
        findings.error(0, name, "is defined twice", "Rename one of the two.")


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


def _faults(member: Parameter, groups: dict[str, Axis]) -> Iterator[str]:
    if member.kind == "rbf":
        yield "Excel cannot store a radial basis function expansion"
        return
    if member.size == 0:
        yield "Excel cannot store an empty block"
    elif not np.isfinite(member.values).all():
        yield "Excel cannot store non-finite values"
    sizes = [*member.values.shape, 1, 1]
    rows = (sizes[1] + 3) * int(np.prod(sizes[2:])) + 10
    if sizes[0] >= _MAX_COLUMNS - len(AXES_HEADING) or rows >= _MAX_ROWS:
        yield f"an Excel sheet cannot store its {_size(member)} values"
    for axis in member.axes:
        known = groups.get(axis.name)
        if axis.name and (known is None or not np.array_equal(known.breakpoints, axis.breakpoints)):
            yield f"the variant {member.variant!r} has other breakpoints for the group axis {axis.name}"
