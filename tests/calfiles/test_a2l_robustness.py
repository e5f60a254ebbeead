"""Damaged A2L files and images end in values or findings, and take no more memory than they have."""

import random
import re
import tracemalloc
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles.a2l.objects import summarise_labels
from kennfeld.calfiles.a2l.parser import parse_a2l
from kennfeld.calfiles.a2l.reader import read_parameters
from kennfeld.calfiles.a2l.writer import write_values
from kennfeld.calfiles.flash.records import read_image
from kennfeld.calfiles.format import FileFindings
from tests.calfiles.a2l_files import ADDRESS, axis, hex_file, label, layout, method, module, s_file, shared_axis
from tests.draws import mostly_slow

TABLE = ["NO_AXIS_PTS_X 1 UBYTE", "NO_AXIS_PTS_Y 2 UBYTE", "AXIS_PTS_X 3 UWORD INDEX_INCR DIRECT"]
TABLE += ["AXIS_PTS_Y 4 UWORD INDEX_DECR DIRECT", "FNC_VALUES 5 SWORD COLUMN_DIR DIRECT", "ALIGNMENT_WORD 2"]
A2L = module(
    layout(*TABLE),
    layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT", name="RV"),
    layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ALTERNATE_WITH_X DIRECT", name="RX"),
    layout("NO_AXIS_PTS_X 1 UBYTE", "AXIS_PTS_X 2 UBYTE INDEX_INCR DIRECT", "STATIC_RECORD_LAYOUT", name="RA"),
    layout("NO_RESCALE_X 1 UBYTE", "AXIS_RESCALE_X 2 UBYTE 3 INDEX_INCR DIRECT", name="RR"),
    method("CM", "RAT_FUNC", "COEFFS 0 2 0 0 0 1", "rpm"),
    method("CQ", "RAT_FUNC", "COEFFS 1 0 0 0 0 1"),
    method("CF", "FORM", '/begin FORMULA "2*(X1+4)" FORMULA_INV "X1/2-4" /end FORMULA'),
    method("CT", "TAB_INTP", "COMPU_TAB_REF T"),
    method("CW", "TAB_VERB", "COMPU_TAB_REF W"),
    '/begin COMPU_TAB T "" TAB_INTP 3 0 1 2 5 255 9 DEFAULT_VALUE_NUMERIC 3 /end COMPU_TAB',
    '/begin COMPU_VTAB W "" TAB_VERB 2 0 "a ""b""" 3 "c" DEFAULT_VALUE "none" /end COMPU_VTAB',
    label("MAP", axis("STD_AXIS", 3, conversion="CM") + axis("STD_AXIS", 3), conversion="CM"),
    label("VALUE", "BIT_MASK 0x3C", name="V", record="RV", conversion="CF"),
    label("VALUE", name="W", record="RV", conversion="CW", address=ADDRESS + 3),
    label("VAL_BLK", "MATRIX_DIM 2 3 1", name="B", record="RV", conversion="CT"),
    label("VAL_BLK", "NUMBER 4", name="Q", record="RV", conversion="CQ", limits="0 20"),
    label("ASCII", "NUMBER 5", name="S", record="RV"),
    label("CURVE", axis("STD_AXIS", 2), name="X", record="RX", address=ADDRESS + 28),
    label("CURVE", axis("COM_AXIS", 3, "AXIS_PTS_REF A"), name="C", record="RV"),
    label("CURVE", axis("FIX_AXIS", 3, "FIX_AXIS_PAR 0 2 3"), name="F", record="RV"),
    label("CURVE", axis("RES_AXIS", 3, "AXIS_PTS_REF R"), name="E", record="RV"),
    label("CURVE", axis("CURVE_AXIS", 3, "CURVE_AXIS_REF F"), name="G", record="RV"),
    shared_axis(4, address=ADDRESS + 18),
    shared_axis(3, name="R", record="RR", address=ADDRESS + 23),
    '/begin TYPEDEF_STRUCTURE TS "" 4 /begin STRUCTURE_COMPONENT a TV 0 MATRIX_DIM 2 /end STRUCTURE_COMPONENT',
    "/end TYPEDEF_STRUCTURE",
    '/begin TYPEDEF_CHARACTERISTIC TV "" VALUE RV 0 CM 0 9 /end TYPEDEF_CHARACTERISTIC',
    f'/begin INSTANCE I "" TS {ADDRESS} MATRIX_DIM 2 /end INSTANCE',
)
MEMORY = {ADDRESS: bytes([2, 2, 1, 0, 9, 0, 7, 0, 3, 0, *range(8), 3, 5, 7, 9, 0, 3, 5, 0, 6, 1, 7, 2, 9, 1, 8, 2])}
ABSURD = [b"-1", b"65535", b"4294967295", b"99999999999999999999", b"1e308", b"nan", b"0x", b"", b"255", b"0"]


def damaged(raw, draw):
    """A copy with some bytes, numbers or lines changed."""
    for _ in range(draw.choice((1, 1, 2, 4))):
        kind, at = draw.randrange(6), draw.randrange(len(raw) or 1)
        if kind == 0:
            raw = raw[:at]
        elif kind == 1:
            raw = raw[:at] + bytes([draw.randrange(256)]) + raw[at + 1 :]
        elif kind == 2:
            numbers = list(re.finditer(rb"\d+", raw))
            if numbers:
                number = draw.choice(numbers)
                raw = raw[: number.start()] + draw.choice(ABSURD) + raw[number.end() :]
        elif kind == 3:
            words = raw.split(b" ")
            i, j = draw.randrange(len(words)), draw.randrange(len(words))
            words[i], words[j] = words[j], words[i]
            raw = b" ".join(words)
        elif kind == 4:
            lines = raw.splitlines(keepends=True)
            del lines[draw.randrange(len(lines) or 1) : draw.randrange(len(lines) or 1) + 1]
            raw = b"".join(lines)
        else:
            raw = raw[:at] + raw[at // 2 :]
    return raw


def used(a2l_raw, image_raw):
    """Read and write everything there is; gives how many labels were read."""
    findings = FileFindings("ecu.a2l")
    a2l = parse_a2l(a2l_raw, "ecu.a2l", findings, lambda _: None)
    image = read_image(image_raw, "ecu.hex", findings)
    findings.finish()
    summarise_labels(a2l)
    parameters = read_parameters(a2l, image, findings)
    findings.finish()
    assert write_values(a2l, image, parameters, FileFindings("")) == image.raw
    changed = parameters.with_parameters(*(one.with_values(one.values * 1.1 + 1) for one in parameters.parameters))
    write_values(a2l, image, changed, FileFindings(""))
    return len(parameters)


def test_the_whole_file_is_read():
    assert used(A2L, hex_file(MEMORY)) == 10


@pytest.mark.parametrize("part", mostly_slow(range(20), 1))
@pytest.mark.parametrize("which", ["a2l", "hex", "s19"])
def test_damage_ends_in_values_or_findings(which, part):
    for number in range(15 * part, 15 * part + 15):
        draw = random.Random(f"{which} {number}")
        image = s_file(MEMORY) if which == "s19" else hex_file(MEMORY)
        a2l, image = (damaged(A2L, draw), image) if which == "a2l" else (A2L, damaged(image, draw))
        with suppress(InputError):
            used(a2l, image)


def test_absurd_sizes_take_no_memory():
    sizes = ("MATRIX_DIM 65535 65535", "NUMBER 4294967295", "MATRIX_DIM 65535 65535 65535")
    fixed = axis("FIX_AXIS", 65535, "FIX_AXIS_PAR_DIST 0 1 4294967295")
    blocks = [label("VAL_BLK", size, name=f"B{i}", record="RV") for i, size in enumerate(sizes)]
    blocks += [label("MAP", fixed + fixed, name="F", record="RV"), label("MAP", axis("STD_AXIS", 2**32) * 2)]
    text = module(layout(*TABLE), layout("FNC_VALUES 1 FLOAT64_IEEE ROW_DIR DIRECT", name="RV"), *blocks)
    tracemalloc.start()
    try:
        used(text, hex_file(MEMORY | {0xFFFFFF00: bytes(16)}))
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "text",
    [
        b'"' * 200_001,
        b'"\\' + b'\\"' * 200_000,
        b"/begin A2ML " * 100_000,
        b"/* " * 200_000,
        b"/begin X " * 100_000,
        b"/end X " * 100_000,
        b"/include a " * 100_000,
        b"/" * 400_000,
        b"\xff\xfe" + b"\x00" * 100_001,
        bytes(100_000),
    ],
)
def test_hostile_texts_end_at_once(text):
    findings = FileFindings("ecu.a2l")
    parse_a2l(text, "ecu.a2l", findings, lambda *_: (Path("a"), text))
    with pytest.raises(InputError):
        findings.finish()


def test_numbers_that_no_float_holds_stay_apart():
    text = module(layout("FNC_VALUES 1 A_UINT64 ROW_DIR DIRECT"), label("VAL_BLK", "NUMBER 2"))
    raw = hex_file({ADDRESS: b"\xff" * 16})
    findings = FileFindings("")
    a2l, image = parse_a2l(text, "", findings), read_image(raw, "", findings)
    parameters = read_parameters(a2l, image, findings)
    changed = parameters["L"].with_values(np.array([parameters["L"].values[0], 5.0]))
    again = read_image(write_values(a2l, image, parameters.with_parameters(changed), FileFindings("")), "", findings)
    assert again.read(ADDRESS, 16) == b"\xff" * 8 + (5).to_bytes(8, "little")
