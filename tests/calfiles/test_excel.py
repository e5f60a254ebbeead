"""Calibration workbooks: what a person does to them in Excel is read, or named with its cell."""

import re
import zipfile
from io import BytesIO

import numpy as np
import pytest
import python_calamine
import xlsxwriter

from kennfeld.base.errors import InputError
from kennfeld.calfiles import describe, read, write
from kennfeld.calfiles.excel.layout import holds_calibration, sheet_names
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Scalar
from kennfeld.domain.texts import Text
from kennfeld.files.head import read_head

SPEED = Axis([700, 1000, 1500], "n", "rpm", "AxisSpeed")
LOAD = Axis([0, 50], "rl", "%")
VALUES = np.array([[1.0, 2.0], [3.0, 0.1 + 0.2], [5.0, 5e-324]])
SET = ParameterSet(
    [
        Scalar("Kp", 0.08, unit="-", description="gain", functions=["IdleGov", "Trq"], display_name="KP"),
        Map("MapX", SPEED, LOAD, VALUES, unit="Nm", description="torque"),
        Curve("Eta[0].k", SPEED, [1.0, 0.9, 1e-300]),
        Block("Row", [1.0, 2.0, 3.0]),
        Block("One", [[4.0]]),
        Block("Many", np.arange(24.0).reshape(2, 3, 4)),
        Cube("Cube", [[1.0, 2.0], [3.0, 4.0, 5.0], Axis([6.0, 7.0], "t", "s")], np.arange(12.0).reshape(2, 3, 2)),
    ],
    [Text("Mode", "<auto> & =1+1", "which")],
    [SPEED, Axis([1.0, 2.0], "a", "b", "Spare")],
)


@pytest.fixture
def book(tmp_path):
    """Write the set, change cells and sheets as a person would, and give the file's name."""

    def change(cells=None, parameters=SET, sheets=lambda sheets: sheets):
        path = tmp_path / "start.xlsx"
        write(parameters, path)
        read_book = python_calamine.CalamineWorkbook.from_path(str(path))
        grids = {
            name: read_book.get_sheet_by_name(name).to_python(skip_empty_area=False) for name in read_book.sheet_names
        }
        for (sheet, cell), value in (cells or {}).items():
            put(grids[sheet], cell, value)
        save(path, sheets(grids))
        return path

    return change


def put(grid, cell, value):
    row, column = int(cell[1:]) - 1, ord(cell[0]) - ord("A")
    while len(grid) <= row:
        grid.append([])
    grid[row] += [""] * (column + 1 - len(grid[row]))
    grid[row][column] = value


def save(path, grids):
    with xlsxwriter.Workbook(path) as workbook:
        for name, grid in grids.items():
            sheet = workbook.add_worksheet(name)
            for row, line in enumerate(grid):
                for column, value in enumerate(line):
                    if value != "":
                        sheet.write(row, column, value)


def refused(path):
    with pytest.raises(InputError) as caught:
        read(path)
    return str(caught.value)


def test_a_workbook_reads_back_bit_for_bit(tmp_path):
    write(SET, tmp_path / "a.xlsx")
    assert read(tmp_path / "a.xlsx") == SET
    assert read(tmp_path / "a.xlsx")["MapX"].values.tobytes() == VALUES.tobytes()
    assert describe(tmp_path / "a.xlsx").kind == "Excel"


def test_variants_have_rows_and_sheets_of_their_own(tmp_path):
    other = SET["MapX"].changed(values=VALUES + 1, variant="Engine=2")
    scalar = SET["Kp"].changed(values=np.array(0.5), variant="Engine=2")
    many = ParameterSet(SET.parameters, SET.texts, SET.axes, [other, scalar, Text("Mode", "off", variant="Engine=2")])
    write(many, tmp_path / "a.xlsx")
    assert read(tmp_path / "a.xlsx") == many
    assert read(tmp_path / "a.xlsx").in_variant("Engine=2")["MapX"].values[0, 0] == 2.0


def test_a_changed_value_is_read(book):
    path = book({("MapX", "C9"): 7.5, ("Scalars", "B2"): 3})
    assert read(path)["MapX"].values[1, 0] == 7.5
    assert read(path)["Kp"].value == 3.0


def test_sheets_may_move_and_be_added(book):
    path = book(sheets=lambda sheets: {"My notes": [["speed", 1], ["", 2]], **dict(reversed(sheets.items()))})
    assert list(read(path)) == list(SET)


def test_notes_and_sums_may_stand_apart_from_a_table(book):
    path = book({("MapX", "A12"): "checked", ("MapX", "B12"): 5, ("MapX", "F9"): 12, ("MapX", "E9"): "mean"})
    assert read(path)["MapX"].values.shape == (3, 2)


def test_a_breakpoint_more_is_a_row_more(book):
    path = book({("MapX", "A11"): 75, ("MapX", "B11"): 6, ("MapX", "C11"): 7, ("MapX", "D11"): 8})
    assert read(path)["MapX"].axes[1].breakpoints.tolist() == [0, 50, 75]
    assert read(path)["MapX"].values[:, 2].tolist() == [6, 7, 8]


def test_a_column_more_of_a_group_axis_belongs_on_its_sheet_too(book):
    message = refused(book({("MapX", "E8"): 2000, ("MapX", "E9"): 1, ("MapX", "E10"): 1}))
    assert "Sheet MapX cell B8 starts 4 breakpoints, but the group axis AxisSpeed has 3" in message


def test_a_row_added_to_the_scalars_is_a_parameter(book):
    path = book({("Scalars", "A4"): "Ki", ("Scalars", "B4"): 0.5, ("Scalars", "C4"): "1/s"})
    assert read(path)["Ki"] == Scalar("Ki", 0.5, unit="1/s")


@pytest.mark.parametrize(
    ("cell", "value", "message"),
    [
        (("MapX", "C9"), "1,5", "Sheet MapX cell C9 must be a number, got '1,5'. Write it as a number"),
        (("MapX", "C9"), "", "Sheet MapX cell C9 must be a number, but is empty"),
        (("MapX", "C9"), True, "Sheet MapX cell C9 must be a number, got True"),
        (
            ("MapX", "C8"),
            1200,
            "cell C8 contains 1200 instead of 1000 of the group axis AxisSpeed in Sheet Axes cell E2",
        ),
        (("MapX", "A10"), 0, "Sheet MapX cell A10 contains 0, which does not exceed the previous breakpoint 0"),
        (("MapX", "A10"), "", "Sheet MapX cell A10 is empty; the numbers next to it have no y breakpoint"),
        (("MapX", "D8"), "", "Sheet MapX cell D8 is empty; the numbers below it have no x breakpoint"),
        (("MapX", "A8"), "", "Sheet MapX contains no table. Write 'y down / x right'"),
        (("Axes", "E2"), 700, "Sheet Axes cell E2 contains 700, which does not exceed the previous breakpoint 700"),
        (("Axes", "E2"), "", "Sheet Axes cell E2 is empty; a breakpoint is missing"),
        (("Scalars", "B2"), "", "Sheet Scalars cell B2 must be a number, but is empty"),
        (("Scalars", "A3"), "Kp", "Sheet Scalars cell A3 repeats the name Kp"),
        (
            ("Parameters", "B3"),
            "mop",
            "cell B3 must be a kind of parameter, got 'mop'. Did you mean map?",
        ),
        (("Parameters", "A3"), "Kp", "Sheet Parameters cell A3 repeats the name Kp"),
        (("Parameters", "I4"), "MapX", "refers to the sheet 'MapX', which Sheet Parameters cell A3 already uses"),
        (("Parameters", "I3"), "MapY", "refers to the unknown sheet 'MapY'. Did you mean MapX?"),
        (("Cube", "B15"), 6, "Sheet Cube cell B15 repeats an earlier page"),
        (("Cube", "B16"), 9, "Sheet Cube cell B16 contains 9, but Sheet Cube cell B10 contains 1"),
    ],
)
def test_errors_are_reported_with_their_cell(book, cell, value, message):
    assert message in refused(book({cell: value}))


def test_all_findings_of_a_workbook_are_reported_at_once(book):
    message = refused(book({("MapX", "C9"): "x", ("Scalars", "B2"): "y", ("Cube", "B11"): "z"}))
    assert len(message.splitlines()) == 3


def test_a_measurement_is_not_calibration_data(tmp_path):
    path = tmp_path / "bench.xlsx"
    save(path, {"data": [["time", "n"], [0, 700], [1, 800]]})
    assert "without a sheet Parameters" in refused(path)
    assert not holds_calibration(read_head(path))
    write(SET, tmp_path / "a.xlsx")
    assert holds_calibration(read_head(tmp_path / "a.xlsx"))


def repacked(path, change):
    """The workbook with its parts changed."""
    content = BytesIO()
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as other:
        for part in archive.infolist():
            other.writestr(part.filename, change(part.filename, archive.read(part)))
    path.write_bytes(content.getvalue())
    return path


@pytest.mark.slow
def test_a_sheet_that_unpacks_to_gigabytes_is_refused(book, monkeypatch):
    path = repacked(book(), lambda name, raw: raw + b" " * 30_000_000 if name.endswith("sheet1.xml") else raw)
    assert path.stat().st_size < 200_000
    monkeypatch.setattr("kennfeld.base.archives._PER_BYTE", 20)
    assert "sheet1.xml holds 30 MB or more, packed into 0.0 MB" in refused(path)


def test_an_archive_that_lies_about_its_sizes_is_refused(book):
    path = repacked(book(), lambda name, raw: raw + b" " * 3_000_000 if name.endswith("sheet1.xml") else raw)
    with zipfile.ZipFile(path) as archive:
        size = next(part.file_size for part in archive.infolist() if part.filename.endswith("sheet1.xml"))
    raw = path.read_bytes()
    path.write_bytes(raw.replace(size.to_bytes(4, "little"), (500).to_bytes(4, "little")))
    assert "the workbook cannot be read" in refused(path)


@pytest.mark.parametrize(
    "cell",
    [
        '<c r="XFD1048576"><v>1</v></c>',
        '<c s="1"r="XFD1048576"><v>1</v></c>',
        "<c r = 'xfd1048576'><v>1</v></c>",
        '</row><row r="1048576">' + "<c><v>1</v></c>" * 9000,
        '</row><row r="1048576"><c r="XFD1"/><c><v>1</v></c>',
    ],
)
def test_a_stray_cell_in_the_last_corner_is_refused(book, cell):
    end = f"{cell}</row></sheetData>".encode()
    path = repacked(book(), lambda name, raw: raw.replace(b"</row></sheetData>", end) if "sheet5" in name else raw)
    assert re.search(r"spans up to 10\d{5} rows and \d+ columns\. Delete the stray cells", refused(path))


def test_entities_are_not_expanded(book, tmp_path):
    (tmp_path / "secret.txt").write_text("secret")
    entity = f'<!DOCTYPE x [<!ENTITY e SYSTEM "file://{tmp_path}/secret.txt">]>'.encode()

    def change(name, raw):
        if not name.endswith("sharedStrings.xml"):
            return raw
        return raw.replace(b"<sst", entity + b"<sst", 1).replace(b"torque", b"&e;")

    path = repacked(book(), change)
    shown = ""
    try:
        shown = repr(read(path))
    except InputError as error:
        shown = str(error)
    assert "secret" not in shown


@pytest.mark.parametrize(
    ("item", "message"),
    [
        (Scalar("K", np.nan), "cannot store non-finite values"),
        (Scalar(" K", 1.0), "is not a valid name in Excel"),
        (Scalar("K", 1.0, description="a\0b"), "control characters"),
        (Scalar("K", 1.0, functions=["a,b"]), "commas or surrounding blanks"),
        (Scalar("K", 1.0, description="x" * 40_000), "at most 32767 characters"),
        (Block("K", np.zeros((20_000, 2))), "cannot store its 20000 x 2 values"),
    ],
)
def test_parameters_that_excel_cannot_hold_are_refused(tmp_path, item, message):
    with pytest.raises(InputError, match=message):
        write(ParameterSet([item]), tmp_path / "a.xlsx")


def test_sheets_are_called_as_excel_allows():
    long = "A" * 40
    names = sheet_names(["a:b", "a?b", long, long.lower(), "", "'", "scalars", "history"])
    assert len({name.casefold() for name in names}) == len(names)
    assert all(0 < len(name) <= 31 for name in names)
    assert names[:2] == ["a_b", "a_b (2)"]


def test_tables_with_a_group_axis_follow_its_sheet(tmp_path):
    write(SET, tmp_path / "a.xlsx")
    with zipfile.ZipFile(tmp_path / "a.xlsx") as archive:
        sheet = archive.read("xl/worksheets/sheet5.xml").decode()
    assert "<f>Axes!D2</f><v>700.0</v>" in sheet
    assert "colorScale" in sheet


def test_the_same_set_gives_the_same_bytes(tmp_path, monkeypatch):
    write(SET, tmp_path / "a.xlsx")
    before = (tmp_path / "a.xlsx").read_bytes()
    monkeypatch.setattr("time.time", lambda: 1e9)
    monkeypatch.setattr("time.asctime", lambda *_: "never")
    write(SET, tmp_path / "a.xlsx")
    assert (tmp_path / "a.xlsx").read_bytes() == before


def test_a_panic_of_the_library_is_damage(book, monkeypatch):
    class PanicException(BaseException):
        """As the library names it."""

    class Broken:
        @staticmethod
        def from_filelike(_):
            raise PanicException("index out of bounds")

    path = book()
    monkeypatch.setattr("python_calamine.CalamineWorkbook", Broken)
    assert "the workbook cannot be read (index out of bounds)" in refused(path)
