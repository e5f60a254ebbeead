"""Files that are given as measurements and are none: the message says what they are."""

import gzip

import pytest

from kennfeld.errors import InputError
from kennfeld.measurement import describe, read

ASC = """date Wed Sep 3 10:00:00 am 2014
base hex  timestamps absolute
internal events logged
Begin Triggerblock Wed Sep 3 10:00:00 am 2014
   0.015991 1  2ff             Rx   d 8 01 02 03 04 05 06 07 08
   0.025991 1  2ff             Rx   d 8 01 02 03 04 05 06 07 08
"""
DBC = """VERSION ""

NS_ :
	NS_DESC_

BU_: ECU1 ECU2

BO_ 500 EngineData: 8 ECU1
 SG_ Speed : 0|16@1+ (0.25,0) [0|8000] "rpm" ECU2
"""


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (ASC, "a Vector ASC file, a log of bus messages: it holds their bytes, not the values of signals. Decode it"),
        (ASC.replace("date Wed", "// made by hand\ndate Wed"), "a Vector ASC file"),
        (b"LOGG" + bytes(140), "a Vector BLF file"),
        (";$FILEVERSION=2.1\n;$STARTTIME=43\n 1  3.3 DT 0300 Rx 7 00 00\n", "a PEAK TRC file"),
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
        (gzip.compress(ASC.encode()), "a Vector ASC file"),
    ],
)
def test_a_file_of_another_kind_is_named(csv, content, said):
    for work in (read, describe):
        with pytest.raises(InputError) as caught:
            work(csv(content, "run.x"))
        assert str(caught.value).startswith(f"run.x: this is {said}")


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
