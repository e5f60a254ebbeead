"""Workbooks of the old binary format (.xls), whole and damaged."""

import struct

import pytest

from kennfeld.base.errors import InputError
from kennfeld.base.workbooks.biff import check_records
from kennfeld.measurement import describe, read
from tests.measurement.xls_files import BOF_BOOK, SECTOR, compound, part, records, wide, xls

ROWS = [["time", "Speed", "on"], ["s", "rpm", "-"], *([0.1 * i, 1000.5 + i, i % 2] for i in range(60))]
LARGE = [*ROWS, *([0.1 * i, 1000.5 + i, i % 2] for i in range(60, 9000))]  # more tables than one sector holds


@pytest.fixture
def book(tmp_path):
    """Writes bench.xls."""

    def write(content):
        path = tmp_path / "bench.xls"
        path.write_bytes(content)
        return path

    return write


def replaced(content, at, *numbers):
    """The content with numbers of four bytes from a place on."""
    return content[:at] + struct.pack(f"<{len(numbers)}I", *numbers) + content[at + 4 * len(numbers) :]


def tables_at(content):
    """Where the first table of sectors begins."""
    return (struct.unpack_from("<I", content, 76)[0] + 1) * SECTOR


def directory_at(content):
    return (struct.unpack_from("<I", content, 48)[0] + 1) * SECTOR


@pytest.mark.parametrize("rows", [ROWS[:9], ROWS, LARGE], ids=["short sectors", "one table", "several tables"])
def test_a_workbook_is_read(book, rows):
    path = book(xls({"Data": rows}, short=len(rows) < 10))
    data = read(path)
    assert data["Speed"].unit == "rpm"
    assert data["Speed"].values.tolist() == [row[1] for row in rows[2:]]
    assert data.time.tolist() == pytest.approx([row[0] for row in rows[2:]])
    assert describe(path).kind == "Excel"


def test_every_sheet_is_read(book):
    path = book(xls({"Notes": [["a", "b"]], "Data": ROWS, "More": ROWS}))
    assert [table.name for table in describe(path).tables] == ["Data", "More"]
    assert read(f"{path}#More").samples == 60


def looped_table(content):
    return replaced(content, tables_at(content) + 4, 1)


def looped_directory(content):
    (directory,) = struct.unpack_from("<I", content, 48)
    return replaced(content, tables_at(content) + 4 * directory, directory)


def looped_tables(content):
    return replaced(content[: 2 * SECTOR - 4] + struct.pack("<I", 0) + content[2 * SECTOR :], 68, 0)


def many_tables(content):
    return replaced(content, 44, 0x7FFFFFFF)


def huge_stream(content):
    return replaced(content, directory_at(content) + 128 + 120, 0x7FFFFFFF)


def huge_root(content):
    return replaced(content, directory_at(content) + 120, 0x7FFFFFFF)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (looped_table, "a chain of sectors is circular"),
        (looped_directory, "a chain of sectors is circular"),
        (looped_tables, "a chain of sectors is circular"),
        (many_tables, "it claims 2147483647 sectors of one kind"),
        (huge_stream, "one of its streams claims 2147483647 bytes"),
        (huge_root, "one of its streams claims 2147483647 bytes"),
    ],
)
def test_a_damaged_container_is_refused_before_it_takes_all_memory(book, damage, message):
    with pytest.raises(InputError, match=r"bench\.xls: the workbook cannot be read") as caught:
        read(book(damage(xls({"Data": ROWS}))))
    assert message in str(caught.value)


def test_a_loop_of_short_sectors_is_refused(book):
    content = xls({"Data": ROWS[:9]}, short=True)
    (short_table,) = struct.unpack_from("<I", content, 60)
    with pytest.raises(InputError, match="is circular"):
        read(book(replaced(content, (short_table + 1) * SECTOR + 4, 1)))


@pytest.mark.parametrize(
    ("claims", "message"),
    [
        ({"texts": 1 << 30}, "it claims 1073741824 texts in"),
        ({"dimensions": (0, 0xFFFFFFFF, 0, 3)}, "a sheet claims rows 0 to 4294967295"),
        ({"dimensions": (9, 2, 0, 3)}, "a sheet claims rows 9 to 2"),
    ],
)
def test_claims_beyond_the_content_are_refused(book, claims, message):
    with pytest.raises(InputError, match="the workbook cannot be read") as caught:
        read(book(xls({"Data": ROWS}, **claims)))
    assert message in str(caught.value)


def test_empty_texts_are_the_shortest():
    head, empty = part(0x0809, BOF_BOOK), 100 * wide("")
    check_records(head + part(0x00FC, struct.pack("<ii", 100, 100) + empty) + part(0x000A), 10)
    with pytest.raises(ValueError, match="it claims 105 texts in 312 bytes"):
        check_records(head + part(0x00FC, struct.pack("<ii", 105, 105) + empty) + part(0x000A), 10)


def test_a_cell_far_outside_is_refused(book):
    stream = records({"Data": ROWS}).replace(struct.pack("<HH", 60, 2), struct.pack("<HH", 60, 0xFFFF))
    with pytest.raises(InputError, match="a sheet has a cell in column 65536"):
        read(book(compound(stream)))


def test_a_few_cells_far_apart_are_refused(book):
    stream = records({"Data": ROWS}).replace(struct.pack("<HH", 60, 2), struct.pack("<HH", 65_000, 250))
    with pytest.raises(InputError, match="a sheet has 186 cells, but spans 65001 rows and 251 columns"):
        read(book(compound(stream)))


def test_sheets_within_each_other_are_refused(book):
    stream = records({"Data": ROWS} | {f"Data{k}": [["a"]] for k in range(9)})
    places = [at for at in range(len(stream) - 4) if stream[at : at + 2] == b"\x85\x00"][:10]
    first = stream[places[0] + 4 : places[0] + 8]
    for at in places:
        stream = stream[: at + 4] + first + stream[at + 8 :]
    with pytest.raises(InputError, match="its sheets overlap"):
        read(book(compound(stream)))


def test_a_file_that_is_cut_anywhere_is_refused_or_read(book):
    content = xls({"Data": ROWS})
    for cut in range(8, len(content), 97):
        try:
            read(book(content[:cut]))
        except InputError as error:
            assert str(error.findings[0].location).startswith("bench.xls")  # noqa: PT017
