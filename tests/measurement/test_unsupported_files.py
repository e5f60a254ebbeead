"""Files that are given as measurements and are none: the message says what they are."""

import gzip

import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read

DBC = """VERSION ""

NS_ :
	NS_DESC_

BU_: ECU1 ECU2

BO_ 500 EngineData: 8 ECU1
 SG_ Speed : 0|16@1+ (0.25,0) [0|8000] "rpm" ECU2
"""


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (DBC, "a CAN database (DBC), a database of bus messages: it describes signals and holds no samples of them."),
        ("\ufeff" + DBC, "a CAN database (DBC)"),
        ("/* x */\nLIN_description_file;\n", "a LIN database (LDF)"),
        ('<?xml version="1.0"?>\n<AUTOSAR xmlns="x"></AUTOSAR>', "an AUTOSAR description (ARXML)"),
        ("// made by hand\n" + DBC, "a CAN database (DBC)"),
        (
            '/* x */ /begin CHARACTERISTIC K "" VALUE 0x1 RL 0 CM 0 1\n/end CHARACTERISTIC\n',
            "a fragment of an A2L description, which",
        ),
        ("CANape PAR V3.2: engine.a2l 1 0 ECU\n;Parameter file\nK 1 2 3\n", "a parameter file of CANape"),
        (gzip.compress(DBC.encode(), mtime=0), "a CAN database (DBC)"),
    ],
)
def test_a_file_of_another_kind_is_named(csv, content, message):
    for work in (read, describe):
        with pytest.raises(InputError) as caught:
            work(csv(content, "run.x"))
        assert str(caught.value).startswith(f"run.x: this is {message}")


def test_a_database_of_a_bus_is_to_be_named_with_a_log(csv):
    with pytest.raises(InputError, match=r"Name a bus log .*: `kennfeld info drive\.mf4 --dbc engine\.dbc`\."):
        read(csv(DBC, "engine.dbc"))


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (b"TDSh\x0e\0\0\0", "an index of a TDMS file, which holds no samples. Name the .tdms file beside it."),
        (b"<hCNF\0\x10\0\0\0\x01>", "a log of AiM (.xrk). Export it as CSV from RaceStudio"),
        (b"CDF\x05", "a netCDF file of 64-bit data (CDF-5). Convert it: nccopy"),
        (b"\x0e\x03\x13\x01", "an HDF4 file. Convert it to HDF5"),
        (b"FEA1\0\0\0\0", "a Feather file of version 1. Write it again"),
        (b"Rar!\x1a\x07", "a compressed file or archive. Unpack it first"),
        (b"\x04\x22\x4d\x18", "a compressed file or archive. Unpack it first"),
        (b"drive.mf4".ljust(257, b"\0") + b"ustar", "a compressed file or archive. Unpack it first"),
        (b"\x01\0\x02", "a binary file, which cannot be read as a measurement. Export it as MDF (.mf4) or CSV;"),
    ],
)
def test_a_binary_file_of_another_kind_is_named_with_the_way_out(tmp_path, start, message):
    (tmp_path / "run.x").write_bytes(start + bytes(600))
    with pytest.raises(InputError) as caught:
        read(tmp_path / "run.x")
    assert str(caught.value).startswith(f"run.x: this is {message}")


@pytest.mark.parametrize("name", ["fea1", "FEA1", "TDSh", "Rar!"])
def test_tables_whose_first_name_is_a_signature_are_read(csv, name):
    assert read(csv(f"{name},a\n1,2\n2,3\n")).samples == 2


@pytest.mark.parametrize(
    "text",
    ["version,a\n1,2\n2,3\n", "base,hex\n1,2\n2,3\n", "VERSION;BO_\n1;2\n2;3\n", "BU_,NS_\n1,2\n2,3\n"],
)
def test_tables_with_such_words_are_read(csv, text):
    assert read(csv(text)).samples == 2


@pytest.mark.parametrize("start", ["/**/" * 16_000, "/*" * 30_000, "/* */\n" * 10_000, "\n" * 65_536])
def test_many_comments_or_blank_lines_are_looked_through_once(csv, start):
    with pytest.raises(InputError, match=r"^run\.x"):
        read(csv(start, "run.x"))
