"""Workbooks with macros and binary workbooks."""

import contextlib
import random
import struct
import zipfile

import pytest
import xlsxwriter

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies

ROWS = [["time", "Speed", "on"], ["s", "rpm", "-"], [0.0, 1000.5, 1.0], [0.1, 1001.5, 0.0], [0.2, 1002.5, 1.0]]
RELATED = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
PACKAGED = 'xmlns="http://schemas.openxmlformats.org/package/2006/relationships"'


def check(path):
    data = read(path)
    assert {c.name: (c.unit, c.values.tolist()) for c in data.values()} == {
        "Speed": ("rpm", [1000.5, 1001.5, 1002.5]),
        "on": ("-", [1, 0, 1]),
    }
    assert data.time.tolist() == [0, 0.1, 0.2]
    assert describe(path).kind == "Excel"


def written(path, rows=ROWS):
    with xlsxwriter.Workbook(path) as book:
        sheet = book.add_worksheet("Data")
        for k, row in enumerate(rows):
            sheet.write_row(k, 0, row)
    return path


def test_a_workbook_of_another_writer_is_read(tmp_path):
    check(written(tmp_path / "bench.xlsx"))


def test_a_workbook_with_macros_is_read(tmp_path):
    plain, path = written(tmp_path / "bench.xlsx"), tmp_path / "bench.xlsm"
    with zipfile.ZipFile(plain) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for member in old.namelist():
            content = old.read(member)
            if member == "[Content_Types].xml":
                plain_type = b"application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"
                assert plain_type in content
                content = content.replace(plain_type, b"application/vnd.ms-excel.sheet.macroEnabled.main+xml")
            new.writestr(member, content)
        new.writestr("xl/vbaProject.bin", b"\xd0\xcf\x11\xe0" + b"\0" * 100)
    check(path)


def part(kind, content=b""):
    """A record of a binary workbook."""
    head = bytes([kind]) if kind < 128 else bytes([kind & 0x7F | 0x80, kind >> 7])
    size, tail = len(content), b""
    while size > 127:
        tail += bytes([size & 0x7F | 0x80])
        size >>= 7
    return head + tail + bytes([size]) + content


def wide(text):
    return struct.pack("<I", len(text)) + text.encode("utf-16-le")


def cell(column, value):
    where = struct.pack("<II", column, 0)
    return part(6, where + wide(value)) if isinstance(value, str) else part(5, where + struct.pack("<d", value))


def binary_workbook(path, rows):
    """A workbook of one sheet from rows by their number."""
    book = (
        part(131)
        + part(143)
        + part(156, struct.pack("<II", 0, 1) + wide("rId1") + wide("Data"))
        + part(144)
        + part(132)
    )
    height, width = max(rows) + 1, max(len(row) for row in rows.values())
    sheet = part(129) + part(148, struct.pack("<4I", 0, height - 1, 0, width - 1)) + part(145)
    for number, row in rows.items():
        sheet += part(0, struct.pack("<I", number) + b"\0" * 13)
        sheet += b"".join(cell(k, value) for k, value in (row.items() if isinstance(row, dict) else enumerate(row)))
    sheet += part(146) + part(130)
    link = f'<Relationship Id="rId1" Type="{RELATED}/worksheet" Target="worksheets/sheet1.bin"/>'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("xl/workbook.bin", book)
        archive.writestr("xl/_rels/workbook.bin.rels", f"<Relationships {PACKAGED}>{link}</Relationships>")
        archive.writestr("xl/worksheets/sheet1.bin", sheet)
    return path


def test_a_binary_workbook_is_read(tmp_path):
    check(binary_workbook(tmp_path / "bench.xlsb", dict(enumerate(ROWS))))


def with_members(path, members):
    """The archive with further members."""
    with zipfile.ZipFile(path, "a") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path


def test_the_index_that_excel_stores_beside_each_binary_sheet_is_skipped(tmp_path):
    index = part(42, bytes(24)) + part(277)
    path = binary_workbook(tmp_path / "bench.xlsb", dict(enumerate(ROWS)))
    check(with_members(path, {"xl/worksheets/binaryIndex1.bin": index}))


def test_a_chart_beside_the_table_is_not_a_second_table(tmp_path):
    path = tmp_path / "bench.xlsx"
    with xlsxwriter.Workbook(path) as book:
        sheet = book.add_worksheet("Data")
        for k, row in enumerate(ROWS):
            sheet.write_row(k, 0, row)
        chart = book.add_chart({"type": "line"})
        chart.add_series({"values": "=Data!$B$3:$B$5"})
        book.add_chartsheet("Chart").set_chart(chart)
    check(path)


def test_folders_of_an_archive_may_be_separated_by_backslashes(tmp_path):
    plain, path = written(tmp_path / "plain.xlsx"), tmp_path / "bench.xlsx"
    with zipfile.ZipFile(plain) as old, zipfile.ZipFile(path, "w") as new:
        for member in old.namelist():
            information = zipfile.ZipInfo("x")
            information.filename = member.replace("/", "\\")
            new.writestr(information, old.read(member))
    check(path)


def test_a_protected_workbook_is_refused_as_such(tmp_path):
    binary = tmp_path / "bench.xlsx"
    binary.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(504) + "EncryptedPackage\0".encode("utf-16-le"))
    content = {"mimetype": "application/vnd.oasis.opendocument.spreadsheet", "content.xml": "?"}
    manifest = {"META-INF/manifest.xml": "<manifest:encryption-data/>"}
    for path in (binary, with_members(tmp_path / "bench.ods", content | manifest)):
        with pytest.raises(InputError, match="protected by a password"):
            read(path)


def test_a_stray_cell_far_away_in_a_binary_workbook_is_refused(tmp_path):
    rows = dict(enumerate(ROWS))
    with pytest.raises(InputError, match=r"xl/worksheets/sheet1.bin spans up to 1048576 rows and 16384 columns"):
        read(binary_workbook(tmp_path / "bench.xlsb", rows | {1_048_575: {16_383: 1.0}}))
    with pytest.raises(InputError, match=r"a sheet has a cell in row 2147483649 and column 3"):
        read(binary_workbook(tmp_path / "bench.xlsb", rows | {2**31: {0: 1.0}}))


@few_or_many_copies
def test_mutated_binary_workbooks_give_data_or_findings(tmp_path, capfd, count):
    chance = random.Random(25)
    whole = binary_workbook(tmp_path / "whole.xlsb", dict(enumerate(ROWS)))
    with zipfile.ZipFile(whole) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    path = tmp_path / "bench.xlsb"
    capfd.readouterr()
    for _ in range(count):
        name = chance.choice(["xl/workbook.bin", "xl/worksheets/sheet1.bin"])
        changed = bytearray(members[name])
        for _ in range(chance.randint(1, 3)):
            changed[chance.randrange(len(changed))] = chance.randrange(256)
        if chance.random() < 0.2:
            del changed[chance.randrange(len(changed)) :]
        with zipfile.ZipFile(path, "w") as archive:
            for member, content in (members | {name: bytes(changed)}).items():
                archive.writestr(member, content)
        with contextlib.suppress(InputError):
            assert read(path).samples
    assert capfd.readouterr().err == ""
