"""Files that are none of ours are refused by name, whatever they are called and whoever opens them."""

import struct
import zipfile

import pytest

from kennfeld import read, read_parameters
from kennfeld.base.errors import InputError
from kennfeld.files.foreign import identify_foreign, identify_package
from kennfeld.terminal.file_info import describe_file

POINTER = (
    b"version https://git-lfs.github.com/spec/v1\n"
    b"oid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32b1258daaa5e2ca24d17e2393\nsize 12345\n"
)
OLE = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(504)
HEADS = {
    "a Git LFS pointer (12345 bytes were not fetched)": [
        POINTER,
        POINTER.replace(b"\n", b"\r\n"),
        b"\xef\xbb\xbf" + POINTER,
        POINTER.replace(b"oid", b"ext-0-foo sha256:00\noid"),
    ],
    "a git-annex pointer (77 bytes were not fetched)": [b"/annex/objects/SHA256E-s77--00ff.mf4\n"],
    "a web page (HTML)": [
        b"<!DOCTYPE html>\n<html>",
        b"\n\n<HTML lang='de'>",
        b"<!-- saved --><head>",
        b"<table><tr><td>1</td></tr></table>",
        "<html><body>1,2".encode("utf-16"),
    ],
    "a picture (PNG)": [b"\x89PNG\r\n\x1a\n\0\0\0"],
    "a picture (JPEG)": [b"\xff\xd8\xff\xe1\0\0Exif"],
    "a picture (bitmap)": [b"BM" + struct.pack("<IIII", 1000, 0, 54, 40)],
    "a picture (SVG)": [b"<?xml version='1.0'?>\n<!-- c -->\n<svg width='1'>", b"<svg>"],
    "a program or library (Windows)": [b"MZ\x90\0\3"],
    "an encrypted archive": [b"PK\3\4\x14\0\1\0"],
    "text in UTF-16 without a byte order mark, or in UTF-32": [
        "time;Öl;n\ns;°C;rpm\n".encode(encoding) for encoding in ("utf-16-le", "utf-16-be", "utf-32", "utf-32-be")
    ],
    "a file of zero bytes, such as a copy leaves that was not finished": [bytes(4096)],
}


@pytest.mark.parametrize(("description", "head"), [(text, head) for text, heads in HEADS.items() for head in heads])
def test_heads_of_foreign_files(description, head):
    assert identify_foreign(head).description == description


@pytest.mark.parametrize(
    "head",
    [b"", b"time,a\n0,1\n", b"MZ,a\n0,1\n", b"BM,a\n0,1\n", b"version,size\n1,2\n", b"<?xml?><MSRSW>", b"MDF     4.10",
     "time;Öl;n\ns;°C;rpm\n".encode("utf-16"), bytes(range(1, 9)) * 4, struct.pack("<16H", *range(16))],
)  # fmt: skip
def test_other_heads_are_not_foreign(head):
    assert identify_foreign(head) is None


@pytest.mark.parametrize(
    "ending", ["mf4", "csv", "dcm", "hex", "slx", "xlsx", "json", "mat", "kf", "fmu", "a2l", "toml"]
)
def test_a_pointer_is_refused_by_each_door(tmp_path, ending):
    path = tmp_path / f"drive.{ending}"
    path.write_bytes(POINTER)
    for door in (read, read_parameters, describe_file):
        with pytest.raises(
            InputError, match=r"this is a Git LFS pointer \(12345 bytes were not fetched\)\. Run git lfs"
        ):
            door(path)


def test_a_picture_called_dcm_is_refused(tmp_path):
    path = tmp_path / "start.dcm"
    path.write_bytes(b"GIF89a" + bytes(20))
    for door in (read, read_parameters, describe_file):
        with pytest.raises(InputError, match=r"this is a picture \(GIF\)"):
            door(path)


def test_packages_without_a_workbook_are_refused(tmp_path):
    path = tmp_path / "report.xls"
    path.write_bytes(OLE + "WordDocument".encode("utf-16-le") + bytes(512))
    with pytest.raises(InputError, match="this is a Word document"):
        read(path)
    assert identify_package(OLE).description == "an OLE package without a workbook"
    assert identify_package(OLE + "Workbook\0".encode("utf-16-le")) is None
    assert identify_package(b"time,a\n") is None


def test_an_encrypted_archive_is_refused(tmp_path):
    path = tmp_path / "drive.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("drive.csv", "time,a\n0,1\n")
    content = bytearray(path.read_bytes())
    content[6] |= 1
    content[content.index(b"PK\1\2") + 8] |= 1
    path.write_bytes(content)
    for door in (read, read_parameters, describe_file):
        with pytest.raises(InputError, match="this is an encrypted archive"):
            door(path)
