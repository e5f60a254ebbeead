import numpy as np
import pytest

from kennfeld.calfiles.a2l.storage_grids import storage_grids
from tests.calfiles.a2l_files import (
    ADDRESS,
    axis,
    hex_file,
    label,
    layout,
    method,
    module,
    parsed,
    shared_axis,
)

BYTES = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")


def grids_of(*blocks):
    a2l, _ = parsed(module(*blocks))
    return storage_grids(a2l)


def only_reason(*blocks):
    grids = grids_of(*blocks)
    assert grids.labels == {}
    [reason] = grids.unrounded.values()
    return reason


@pytest.mark.parametrize(
    ("kind", "entries", "step", "first"),
    [
        ("IDENTICAL", "", 1.0, 0.0),
        ("LINEAR", "COEFFS_LINEAR 0.1 -40", 0.1, -40.0),
        ("LINEAR", "COEFFS_LINEAR -0.1 10", 0.1, 10.0),
        ("RAT_FUNC", "COEFFS 0 128 64 0 0 1", 1 / 128, -0.5),
        ("RAT_FUNC", "COEFFS 0 10 400 0 0 1", 0.1, -40.0),
    ],
)
def test_values_of_a_grid_are_bit_for_bit_those_that_the_image_reads_back(kind, entries, step, first):
    blocks = (BYTES, method("CM", kind, entries), label("VAL_BLK", "NUMBER 256", conversion="CM", limits="-1e6 1e6"))
    a2l, _ = parsed(module(*blocks))
    grid = storage_grids(a2l).labels["L"]
    assert grid.step == pytest.approx(step, rel=1e-15)
    assert (grid.bits, grid.least, grid.largest) == (8, 0.0, 255.0)
    from kennfeld.calfiles.a2l.reader import read_parameters
    from kennfeld.calfiles.flash.records import read_image
    from kennfeld.calfiles.format import FileFindings

    findings = FileFindings("ecu.hex")
    stored = read_parameters(a2l, read_image(hex_file({ADDRESS: bytes(range(256))}), "ecu.hex", findings), findings)
    values = grid.values(np.arange(256.0))
    assert values[0] == first
    np.testing.assert_array_equal(stored["L"].values, values)
    np.testing.assert_array_equal(np.rint(grid.positions(values)), np.arange(256.0))


def test_limits_bit_masks_and_types_bound_the_stored_number():
    words = layout("FNC_VALUES 1 SWORD ROW_DIR DIRECT")
    linear = method("CM", "LINEAR", "COEFFS_LINEAR 0.5 0")
    limited = grids_of(words, linear, label("VALUE", conversion="CM", limits="-10.2 7.6")).labels["L"]
    assert (limited.least, limited.largest, limited.bits) == (-20.0, 15.0, 16)
    masked = grids_of(BYTES, linear, label("VALUE", "BIT_MASK 0x3C", conversion="CM", limits="0 0")).labels["L"]
    assert (masked.least, masked.largest) == (0.0, 15.0)
    extended = label("VALUE", "EXTENDED_LIMITS -20 20", conversion="CM", limits="-1 1")
    assert grids_of(words, linear, extended).labels["L"].largest == 40.0


@pytest.mark.parametrize(
    ("blocks", "reason"),
    [
        ((layout("FNC_VALUES 1 FLOAT32_IEEE ROW_DIR DIRECT"), label("VALUE")), "is stored as FLOAT32_IEEE"),
        ((BYTES, method("CM", "LINEAR", "COEFFS_LINEAR 0 3"), label("VALUE", conversion="CM")), "whose step is 0"),
        ((BYTES, method("CM", "RAT_FUNC", "COEFFS 0 0 1 0 0 1"), label("VALUE", conversion="CM")), "whose step is 0"),
        (
            (BYTES, method("CM", "RAT_FUNC", "COEFFS 0 1 0 0 1 0"), label("VALUE", conversion="CM")),
            "which is not linear",
        ),
        (
            (
                BYTES,
                '/begin COMPU_VTAB T "" TAB_VERB 1 0 "off" /end COMPU_VTAB',
                method("CM", "TAB_VERB", "COMPU_TAB_REF T"),
                label("VALUE", conversion="CM"),
            ),
            "whose values are words",
        ),
        (
            (BYTES, method("CM", "LINEAR", "COEFFS_LINEAR 5 0"), label("VALUE", conversion="CM", limits="6 8")),
            "has the limits 6 to 8, between which no number is stored at a step of 5",
        ),
        (
            (BYTES, method("CM", "LINEAR", "COEFFS_LINEAR 1e-9 1e9"), label("VALUE", conversion="CM")),
            "too fine for double precision",
        ),
        ((label("VALUE"),), "has the record layout RL, which is not defined"),
    ],
)
def test_a_label_without_a_grid_says_why(blocks, reason):
    assert reason in only_reason(*blocks)


def test_breakpoints_have_the_grids_of_their_own_axes_and_of_group_axes():
    entries = ("FNC_VALUES 2 UBYTE ROW_DIR DIRECT", "AXIS_PTS_X 1 UWORD INDEX_INCR DIRECT")
    table = layout(*entries, name="RT")
    own = axis("STD_AXIS", 4, conversion="CS") + axis("COM_AXIS", 3, "AXIS_PTS_REF A")
    grids = grids_of(
        table,
        layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", name="RA"),
        method("CS", "LINEAR", "COEFFS_LINEAR 0.25 0"),
        method("CL", "LINEAR", "COEFFS_LINEAR 40 0"),
        shared_axis(3, conversion="CL"),
        label("MAP", own, record="RT"),
    )
    # in a project, the table may have the group axis under another name, or one of its own
    known = {str(key): (grid.step, grid.bits) for key, grid in grids.axes.items()}
    assert known == {"A": (40.0, 8), "L.x": (0.25, 16), "L.y": (40.0, 8)}
