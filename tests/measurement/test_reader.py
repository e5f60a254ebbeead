"""The face of the room: kinds found by content, files that are not there, and descriptions."""

import json
import zipfile

import pytest

import kennfeld.measurement
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.measurement import describe, read


def test_the_face_is_pinned():
    names = ["ChannelDescription", "Description", "TableDescription", "TimeDescription", "describe", "read"]
    assert kennfeld.measurement.__all__ == names


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"MDF     4.10    ", "the MDF file is cut off"),
        (b"UnFinMF 4.10    ", "the MDF file is cut off"),
        (b"MLVLG\0\0\1", "the MLG file is damaged or cut off"),
        (b"MATLAB 5.0 MAT-file", "holds no vectors"),
        (b"\x89HDF\r\n\x1a\n", "the HDF5 file is damaged"),
        (b"%PDF-1.7", "a PDF file"),
        (b"<?xml version='1.0'?><a/>", "an XML file"),
        (b"<!DOCTYPE html><html>", "this is a web page"),
        (b"* comment\r\nKONSERVIERUNG_FORMAT 2.0\r\n", "a DCM calibration file"),
        (b'CALIBRATION VALUES V2.1;,;*;"";', "a CVX calibration file"),
        (b"\0\1\2\3", "a binary file"),
    ],
)
def test_another_kind_under_a_familiar_name_is_named(csv, content, kind):
    with pytest.raises(InputError, match=kind):
        read(csv(content))


def test_a_csv_under_the_name_of_a_workbook_is_read(csv):
    assert read(csv("a,b\n1,2\n", "bench.xlsx")).samples == 1


def test_an_archive_of_something_else_is_named(tmp_path):
    for member, kind in (
        ("simulink/blockdiagram.xml", "Simulink model"),
        ("modelDescription.xml", "FMU"),
        ("a", r"bench\.xlsx#a line 1: there are names but no row of numbers"),
    ):
        with zipfile.ZipFile(tmp_path / "bench.xlsx", "w") as archive:
            archive.writestr(member, "x")
        with pytest.raises(InputError, match=kind):
            read(tmp_path / "bench.xlsx")


def test_a_file_that_is_not_there_names_the_nearest(csv, tmp_path):
    csv("a\n1\n", "bench_1.csv")
    with pytest.raises(InputError, match=r"there is no such file. Did you mean bench_1.csv\?"):
        read(tmp_path / "bensh_1.csv")
    with pytest.raises(InputError, match="this is a folder"):
        read(tmp_path)


def test_a_sheet_of_a_text_file_is_a_finding(csv):
    with pytest.raises(InputError, match="a CSV file has no sheets"):
        read(csv("a\n1\n"), sheet="Data")


def test_channels_must_be_a_list(csv):
    with pytest.raises(ArgumentError, match=r"write \['Speed'\]"):
        read(csv("Speed\n1\n"), "Speed")


def test_a_description_lists_the_contents_of_a_file(csv):
    description = describe(csv("time,Speed [rpm],Gap,Note\n0,1000,,x\n0.1,2000,,y\n0.2,,,z\n"))
    assert description.kind == "CSV"
    (table,) = description.tables
    speed, gap = table.channels[1:]
    assert (speed.name, speed.unit, speed.samples, speed.minimum, speed.maximum) == ("Speed", "rpm", 3, 1000, 2000)
    assert speed.nan_share == pytest.approx(1 / 3)
    assert (gap.nan_share, gap.minimum) == (1, None)
    assert table.left_out == ("Note",)
    assert (table.time.begin, table.time.end, table.time.step) == (0, 0.2, 0.1)
    assert table.details["separator"] == "comma"
    assert json.loads(json.dumps(description.as_dict(), allow_nan=False))["kind"] == "CSV"


def test_a_description_lists_every_sheet(xlsx):
    rows = [["a"], [1.0]]
    assert [table.name for table in describe(xlsx(First=rows, Second=rows)).tables] == ["First", "Second"]
