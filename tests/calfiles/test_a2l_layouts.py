"""Where the numbers of a label lie: every part of a record layout, by bytes laid out by hand."""

import struct

import numpy as np
import pytest

from tests.calfiles.a2l_files import ADDRESS, axis, label, layout, method, module, read, shared_axis

MAP_AXES = axis("STD_AXIS", 3) + axis("STD_AXIS", 2)


def one(*blocks, memory, common=None):
    """The only label of these blocks, which is read without a remark."""
    parameters, remarks = read(module(*blocks) if common is None else module(*blocks, common=common), memory)
    assert remarks == []
    [member] = parameters.parameters
    return member


def aside(*blocks, memory=bytes(64)):
    """Why the only label of these blocks is left aside."""
    parameters, remarks = read(module(*blocks), memory)
    assert "L" not in parameters
    return "\n".join(remarks)


@pytest.mark.parametrize(
    ("kind", "content", "value"),
    [
        ("UBYTE", b"\xfe", 254),
        ("SBYTE", b"\xfe", -2),
        ("UWORD", b"\x34\x12", 0x1234),
        ("SWORD", b"\xfe\xff", -2),
        ("ULONG", b"\x78\x56\x34\x12", 0x12345678),
        ("SLONG", b"\xfe\xff\xff\xff", -2),
        ("A_UINT64", b"\x00\x00\x00\x00\x00\x00\x00\x01", 2**56),
        ("A_INT64", b"\xff" * 8, -1),
        ("FLOAT16_IEEE", b"\x00\x3e", 1.5),
        ("FLOAT32_IEEE", struct.pack("<f", -2.5), -2.5),
        ("FLOAT64_IEEE", struct.pack("<d", 0.1), 0.1),
    ],
)
def test_every_data_type_is_read(kind, content, value):
    member = one(layout(f"FNC_VALUES 1 {kind} ROW_DIR DIRECT"), label("VALUE"), memory=content)
    assert (member.kind, member.value) == ("scalar", value)


@pytest.mark.parametrize(
    ("order", "content"),
    [
        ("MSB_LAST", b"\x04\x03\x02\x01"),
        ("MSB_FIRST", b"\x01\x02\x03\x04"),
        ("MSB_FIRST_MSW_LAST", b"\x03\x04\x01\x02"),
        ("MSB_LAST_MSW_FIRST", b"\x02\x01\x04\x03"),
    ],
)
def test_every_byte_order_is_read(order, content):
    blocks = layout("FNC_VALUES 1 ULONG ROW_DIR DIRECT"), label("VALUE", f"BYTE_ORDER {order}")
    assert one(*blocks, memory=content).value == 0x01020304
    common = f'/begin MOD_COMMON "" BYTE_ORDER {order} /end MOD_COMMON'
    assert one(blocks[0], label("VALUE"), memory=content, common=common).value == 0x01020304


def test_an_order_that_two_versions_name_differently_is_reported():
    common = '/begin MOD_COMMON "" BYTE_ORDER BIG_ENDIAN /end MOD_COMMON'
    blocks = module(layout("FNC_VALUES 1 UWORD ROW_DIR DIRECT"), label("VALUE"), common=common)
    parameters, remarks = read(blocks, b"\x01\x02")
    assert parameters["L"].value == 0x0102
    assert "BYTE_ORDER BIG_ENDIAN is read as MSB_FIRST" in remarks[0]


@pytest.mark.parametrize(
    ("mask", "content", "value"),
    [("0x0FF0", b"\x34\x12", 0x23), ("0x1", b"\xff\xff", 1), ("0x8000", b"\x00\x80", 1), ("0xFFFF", b"\xff\xff", -1)],
)
def test_a_bit_mask_chooses_and_moves_bits(mask, content, value):
    blocks = layout("FNC_VALUES 1 SWORD ROW_DIR DIRECT"), label("VALUE", f"BIT_MASK {mask}")
    assert one(*blocks, memory=content).value == value


def test_rows_run_along_x_and_columns_along_y():
    content = bytes([3, 2, 10, 20, 30, 1, 2, 11, 12, 13, 14, 15, 16])
    entries = ["NO_AXIS_PTS_X 1 UBYTE", "NO_AXIS_PTS_Y 2 UBYTE", "AXIS_PTS_X 3 UBYTE INDEX_INCR DIRECT"]
    entries += ["AXIS_PTS_Y 4 UBYTE INDEX_INCR DIRECT"]
    rows = one(layout(*entries, "FNC_VALUES 5 UBYTE ROW_DIR DIRECT"), label("MAP", MAP_AXES), memory=content)
    columns = one(layout(*entries, "FNC_VALUES 5 UBYTE COLUMN_DIR DIRECT"), label("MAP", MAP_AXES), memory=content)
    for member in (rows, columns):
        assert [list(one.breakpoints) for one in member.axes] == [[10, 20, 30], [1, 2]]
    assert rows.values.tolist() == [[11, 14], [12, 15], [13, 16]]
    assert columns.values.tolist() == [[11, 12], [13, 14], [15, 16]]


def test_layers_of_a_cube_follow_each_other():
    axes = "".join(axis("FIX_AXIS", n, f"FIX_AXIS_PAR_DIST 0 1 {n}") for n in (2, 3, 2))
    content = bytes(range(12))
    rows = one(layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("CUBOID", axes), memory=content)
    columns = one(layout("FNC_VALUES 1 UBYTE COLUMN_DIR DIRECT"), label("CUBOID", axes), memory=content)
    for x in range(2):
        for y in range(3):
            for z in range(2):
                assert rows.values[x, y, z] == x + 2 * y + 6 * z
                assert columns.values[x, y, z] == y + 3 * x + 6 * z


def test_a_cube_of_four_axes_is_read_and_one_of_five_is_not():
    axes = "".join(axis("FIX_AXIS", 2, "FIX_AXIS_PAR_DIST 0 1 2") for _ in range(4))
    blocks = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("CUBE_4", axes)
    assert one(*blocks, memory=bytes(range(16))).values[1, 0, 1, 1] == 13
    five = label("CUBE_5", axes + axis("FIX_AXIS", 2, "FIX_AXIS_PAR_DIST 0 1 2"))
    assert "has five axes, but a table has at most four; skipped" in aside(blocks[0], five)


def test_a_point_and_its_values_may_alternate():
    entries = ["AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ALTERNATE_WITH_X DIRECT"]
    content = bytes([10, 1, 20, 2, 30, 3])
    curve = one(layout(*entries), label("CURVE", axis("STD_AXIS", 3)), memory=content)
    assert (list(curve.axes[0].breakpoints), list(curve.values)) == ([10, 20, 30], [1, 2, 3])
    static = aside(layout(*entries, "STATIC_RECORD_LAYOUT"), label("CURVE", axis("STD_AXIS", 3)), memory=content)
    assert "with ALTERNATE_WITH_X, which is not supported here; skipped" in static


def test_rows_and_columns_may_alternate_with_the_points_of_one_axis():
    entries = ["AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "AXIS_PTS_Y 2 UBYTE INDEX_INCR DIRECT"]
    by_x = layout(
        "AXIS_PTS_Y 1 UBYTE INDEX_INCR DIRECT",
        "AXIS_PTS_X 2 UBYTE INDEX_INCR DIRECT",
        "FNC_VALUES 3 UBYTE ALTERNATE_WITH_X DIRECT",
    )
    content = bytes([1, 2, 10, 11, 12, 20, 13, 14, 30, 15, 16])
    member = one(by_x, label("MAP", MAP_AXES), memory=content)
    assert [list(one.breakpoints) for one in member.axes] == [[10, 20, 30], [1, 2]]
    assert member.values.tolist() == [[11, 12], [13, 14], [15, 16]]
    by_y = layout(*entries, "FNC_VALUES 3 UWORD ALTERNATE_WITH_Y DIRECT")
    content = bytes([10, 20, 30, 1, 11, 0, 12, 0, 13, 0, 2, 0, 14, 0, 15, 0, 16, 0])
    member = one(by_y, label("MAP", MAP_AXES), memory=content)
    assert member.values.tolist() == [[11, 14], [12, 15], [13, 16]]


def test_curves_that_share_memory_are_skipped():
    blocks = layout("FNC_VALUES 1 UBYTE ALTERNATE_CURVES DIRECT"), label("CURVE", axis("FIX_AXIS", 2))
    assert "ALTERNATE_CURVES does not state how many curves share the memory; skipped" in aside(*blocks)


def test_parts_without_calibration_data_take_their_room():
    entries = [
        "IDENTIFICATION 1 UWORD",
        "SRC_ADDR_X 2 ULONG",
        "NO_AXIS_PTS_X 3 UBYTE",
        "RESERVED 4 BYTE",
        "RIP_ADDR_W 5 UWORD",
        "AXIS_PTS_X 6 UBYTE INDEX_INCR DIRECT",
        "RESERVED 7 BYTE",
        "FNC_VALUES 8 SWORD COLUMN_DIR DIRECT",
        "RIP_ADDR_X 9 UWORD",
    ]
    # identification at 0, address aligned to 4, count at 8, reserved at 9, address at 10, points at 12, values at 16
    content = bytes(8) + b"\x02\x99\xaa\xaa" + b"\x05\x06\x99" + b"\x00" + struct.pack("<2h", -7, 8) + bytes(2)
    member = one(layout(*entries), label("CURVE", axis("STD_AXIS", 4)), memory=content)
    assert (list(member.axes[0].breakpoints), list(member.values)) == ([5, 6], [-7, 8])


def test_positions_count_and_not_the_order_of_the_lines():
    entries = "FNC_VALUES 2 UBYTE ROW_DIR DIRECT", "AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT"
    assert list(one(layout(*entries), label("CURVE", axis("STD_AXIS", 2)), memory=bytes([1, 2, 3, 4])).values) == [3, 4]


@pytest.mark.parametrize(
    ("border", "common", "values"),
    [
        ("", "", 4),
        ("ALIGNMENT_LONG 2", "", 2),
        ("ALIGNMENT_LONG 1", "ALIGNMENT_LONG 4", 1),
        ("", "ALIGNMENT_LONG 8", 8),
    ],
)
def test_the_layout_comes_before_the_module_in_alignment(border, common, values):
    head = f'/begin MOD_COMMON "" BYTE_ORDER MSB_LAST {common} /end MOD_COMMON'
    blocks = layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 ULONG ROW_DIR DIRECT", border)
    content = bytearray(32)
    content[0] = 5
    content[values] = 77
    member = one(blocks, label("CURVE", axis("STD_AXIS", 1)), memory=bytes(content), common=head)
    assert list(member.values) == [77]


def test_a_table_closes_up_behind_its_points_unless_the_layout_is_static():
    entries = ["NO_AXIS_PTS_X 1 UBYTE", "AXIS_PTS_X 2 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 3 UBYTE ROW_DIR DIRECT"]
    curve = label("CURVE", axis("STD_AXIS", 4))
    assert list(one(layout(*entries), curve, memory=bytes([2, 1, 2, 7, 8])).values) == [7, 8]
    for static in ("STATIC_RECORD_LAYOUT", "STATIC_ADDRESS_OFFSETS"):
        member = one(layout(*entries, static), curve, memory=bytes([2, 1, 2, 0, 0, 7, 8, 0, 0]))
        assert list(member.values) == [7, 8]


def test_rows_of_a_static_map_keep_their_distance():
    counts = ["NO_AXIS_PTS_X 1 UBYTE", "NO_AXIS_PTS_Y 2 UBYTE"]
    points = ["AXIS_PTS_X 3 UBYTE INDEX_INCR DIRECT", "AXIS_PTS_Y 4 UBYTE INDEX_INCR DIRECT"]
    values = "FNC_VALUES 5 UBYTE ROW_DIR DIRECT"
    content = bytes([2, 2, 1, 2, 0, 1, 2, 11, 12, 0, 13, 14, 0])
    member = one(layout(*counts, *points, values, "STATIC_RECORD_LAYOUT"), label("MAP", MAP_AXES), memory=content)
    assert member.values.tolist() == [[11, 13], [12, 14]]
    content = bytes([2, 2, 1, 2, 0, 1, 2, 11, 12, 13, 14, 0, 0])
    member = one(layout(*counts, *points, values, "STATIC_ADDRESS_OFFSETS"), label("MAP", MAP_AXES), memory=content)
    assert member.values.tolist() == [[11, 13], [12, 14]]


def test_numbers_of_points_may_stand_behind_them_in_a_static_layout():
    entries = ["AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT", "NO_AXIS_PTS_X 3 UBYTE"]
    curve = label("CURVE", axis("STD_AXIS", 3))
    content = bytes([1, 2, 0, 7, 8, 0, 2])
    assert list(one(layout(*entries, "STATIC_RECORD_LAYOUT"), curve, memory=content).values) == [7, 8]
    assert "stores the number of points after the points; skipped" in aside(layout(*entries), curve, memory=content)


def test_a_number_of_points_may_be_fixed_by_the_layout():
    entries = ["FIX_NO_AXIS_PTS_X 2", "AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT"]
    member = one(layout(*entries), label("CURVE", axis("STD_AXIS", 9)), memory=bytes([1, 2, 7, 8]))
    assert list(member.values) == [7, 8]


@pytest.mark.parametrize("count", [0, 5, 255])
def test_an_impossible_number_of_points_is_reported(count):
    entries = ["NO_AXIS_PTS_X 1 UBYTE", "AXIS_PTS_X 2 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 3 UBYTE ROW_DIR DIRECT"]
    message = aside(layout(*entries), label("CURVE", axis("STD_AXIS", 4)), memory=bytes([count, *range(40)]))
    assert f"states {count} axis points in direction X, but at most 4 are allowed; skipped" in message


@pytest.mark.parametrize(
    ("entry", "points"),
    [
        ("FIX_AXIS_PAR 10 3 4", [10, 18, 26, 34]),
        ("FIX_AXIS_PAR_DIST 10 3 4", [10, 13, 16, 19]),
        ("/begin FIX_AXIS_PAR_LIST 1 4 5 9 /end FIX_AXIS_PAR_LIST", [1, 4, 5, 9]),
    ],
)
def test_a_fixed_axis_is_counted_in_raw_numbers(entry, points):
    curve = label("CURVE", axis("FIX_AXIS", 4, entry, conversion="CM", quantity="Speed"))
    blocks = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), method("CM", "LINEAR", "COEFFS_LINEAR 0.5 1", "rpm")
    member = one(*blocks, curve, memory=bytes([1, 2, 3, 4]))
    assert list(member.axes[0].breakpoints) == [0.5 * point + 1 for point in points]
    assert (member.axes[0].unit, member.axes[0].input) == ("rpm", "Speed")


@pytest.mark.parametrize(("distance", "points"), [("DIST_OP_X", [5, 8, 11]), ("SHIFT_OP_X", [5, 13, 21])])
def test_a_fixed_axis_may_be_stated_in_the_memory(distance, points):
    entries = "OFFSET_X 1 UBYTE", f"{distance} 2 UBYTE", "FNC_VALUES 3 UBYTE ROW_DIR DIRECT"
    member = one(layout(*entries), label("CURVE", axis("FIX_AXIS", 3)), memory=bytes([5, 3, 7, 8, 9]))
    assert list(member.axes[0].breakpoints) == points


COMMON_AXIS = layout("NO_AXIS_PTS_X 1 UBYTE", "AXIS_PTS_X 2 UBYTE INDEX_INCR DIRECT", name="RA")


def test_tables_take_common_breakpoints_and_their_number():
    blocks = COMMON_AXIS, shared_axis(9, conversion="CM"), method("CM", "LINEAR", "COEFFS_LINEAR 10 0", "rpm")
    curve = label("CURVE", axis("COM_AXIS", 9, "AXIS_PTS_REF A"))
    memory = {ADDRESS: bytes([7, 8, 9]), 0x2000: bytes([3, 1, 2, 4])}
    parameters, remarks = read(module(*blocks, curve, layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")), memory)
    assert remarks == []
    [group] = parameters.axes
    assert (group.name, group.unit, list(group.breakpoints)) == ("A", "rpm", [10, 20, 40])
    assert parameters["L"].axes[0] == group
    assert list(parameters["L"].values) == [7, 8, 9]


def test_breakpoints_may_be_kept_as_distances():
    blocks = layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT")
    curve = label("CURVE", axis("STD_AXIS", 3, "DEPOSIT DIFFERENCE"))
    member = one(blocks, curve, memory=bytes([10, 5, 20, 1, 2, 3]))
    assert list(member.axes[0].breakpoints) == [10, 15, 35]


@pytest.mark.parametrize("order", ["INDEX_INCR", "INDEX_DECR"])
def test_a_falling_axis_is_turned_with_its_values(order):
    entries = f"AXIS_PTS_X 1 UBYTE {order} DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT"
    member = one(layout(*entries), label("CURVE", axis("STD_AXIS", 3)), memory=bytes([30, 20, 10, 3, 2, 1]))
    assert (list(member.axes[0].breakpoints), list(member.values)) == ([10, 20, 30], [1, 2, 3])


def test_a_falling_common_axis_turns_the_tables_that_use_it():
    axes = axis("COM_AXIS", 3, "AXIS_PTS_REF A") + axis("FIX_AXIS", 2, "FIX_AXIS_PAR_DIST 0 1 2")
    blocks = COMMON_AXIS, shared_axis(3), label("MAP", axes), layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")
    parameters, _ = read(module(*blocks), {ADDRESS: bytes([1, 2, 3, 4, 5, 6]), 0x2000: bytes([3, 9, 8, 7])})
    assert list(parameters.axes[0].breakpoints) == [7, 8, 9]
    assert parameters["L"].values.tolist() == [[3, 6], [2, 5], [1, 4]]


RESCALE = layout("NO_RESCALE_X 1 UBYTE", "RESERVED 2 BYTE", "AXIS_RESCALE_X 3 UBYTE 5 INDEX_INCR DIRECT", name="RA")


@pytest.mark.parametrize(("positions", "read_in"), [((0, 1, 2), True), ((0, 2, 4), False)])
def test_a_rescale_axis_gives_breakpoints_where_every_pair_is_a_column(positions, read_in):
    pairs = bytes([3, 0, 10, positions[0], 20, positions[1], 30, positions[2]])
    curve = label("CURVE", axis("RES_AXIS", 3, "AXIS_PTS_REF A"))
    blocks = RESCALE, shared_axis(5), curve, layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")
    parameters, remarks = read(module(*blocks), {ADDRESS: bytes([1, 2, 3, 4, 5]), 0x2000: pairs})
    if read_in:
        assert list(parameters["L"].axes[0].breakpoints) == [10, 20, 30]
    else:
        assert "L" not in parameters
        assert "has breakpoints that cannot be derived from the positions of A; skipped" in remarks[1]


@pytest.mark.parametrize(("positions", "read_in"), [((0, 1, 2), True), ((0, 0, 2), False)])
def test_a_curve_gives_breakpoints_where_every_point_is_a_column(positions, read_in):
    curve = label("CURVE", axis("FIX_AXIS", 3, "FIX_AXIS_PAR_DIST 10 10 3"), name="C", address=0x2000)
    table = label("CURVE", axis("CURVE_AXIS", 3, "CURVE_AXIS_REF C"))
    blocks = curve, table, layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")
    parameters, _ = read(module(*blocks), {ADDRESS: bytes([1, 2, 3]), 0x2000: bytes(positions)})
    assert ("L" in parameters) == read_in
    assert not read_in or list(parameters["L"].axes[0].breakpoints) == [10, 20, 30]


def test_curves_that_give_each_other_their_axes_end():
    curves = [
        label("CURVE", axis("CURVE_AXIS", 2, f"CURVE_AXIS_REF C{(i + 1) % 300}"), name=f"C{i}") for i in range(300)
    ]
    good = label("CURVE", axis("CURVE_AXIS", 2, "CURVE_AXIS_REF F"), name="Good")
    fixed = label("CURVE", axis("FIX_AXIS", 2, "FIX_AXIS_PAR_DIST 5 5 2"), name="F")
    blocks = *curves, good, fixed, layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")
    parameters, remarks = read(module(*blocks), bytes([0, 1]))
    assert list(parameters) == ["Good", "F"]
    assert "300 labels" in remarks[0]


def test_blocks_and_texts_are_read():
    blocks = layout("FNC_VALUES 1 UBYTE COLUMN_DIR DIRECT"), label("VAL_BLK", "MATRIX_DIM 2 3 1")
    assert one(*blocks, memory=bytes(range(6))).values.tolist() == [[0, 1, 2], [3, 4, 5]]
    rows = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("VAL_BLK", "MATRIX_DIM 2 3 1")
    assert one(*rows, memory=bytes(range(6))).values.tolist() == [[0, 2, 4], [1, 3, 5]]
    assert list(one(rows[0], label("VAL_BLK", "NUMBER 4"), memory=bytes(range(4))).values) == [0, 1, 2, 3]
    parameters, _ = read(module(rows[0], label("ASCII", "NUMBER 6")), b"Gr\xfc\xdfe\0")
    assert parameters.texts[0].text == "Grüße"
    parameters, _ = read(module(rows[0], label("ASCII", "MATRIX_DIM 6 ENCODING UTF8")), "Süß".encode() + b"\0")
    assert parameters.texts[0].text == "Süß"
    assert "contains bytes that are not text" in aside(rows[0], label("ASCII", "NUMBER 3"), memory=b"a\x07b")


@pytest.mark.parametrize(
    ("blocks", "message"),
    [
        ([label("VALUE")], "has the record layout RL, which is not defined"),
        ([layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT"), label("VALUE")], "which has no FNC_VALUES"),
        ([layout("FNC_VALUES 1 UBYT ROW_DIR DIRECT"), label("VALUE")], "with the data type 'UBYT'"),
        ([layout("FNC_VALUES 1 UBYTE ROW_DIR PLONG"), label("VALUE")], "whose FNC_VALUES is a pointer"),
        ([layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT", "NEW_PART 2"), label("VALUE")], "the unknown keyword 'NEW_PART'"),
        (
            [layout("FNC_VALUES 1 UBYTE UPWARDS DIRECT"), label("VAL_BLK", "MATRIX_DIM 2 2")],
            "the unknown index mode 'UPWARDS'",
        ),
        ([layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("VAL_BLK")], "is a VAL_BLK that states no size"),
        ([layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("MAP", axis("FIX_AXIS", 2))], "is a MAP with 1 axes"),
        (
            [layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("CURVE", axis("COM_AXIS", 2, "AXIS_PTS_REF B"))],
            "refers to the axis B, which is not defined",
        ),
        (
            [layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("VALUE", conversion="C")],
            "the conversion C, which is not",
        ),
        (
            [
                layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"),
                label("VALUE", '/begin VIRTUAL_CHARACTERISTIC "1" /end VIRTUAL_CHARACTERISTIC'),
            ],
            "is virtual",
        ),
        (
            [layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT"), label("VALUE")],
            "with two FNC_VALUES",
        ),
    ],
)
def test_unreadable_labels_are_skipped_with_the_reason(blocks, message):
    messages = aside(*blocks)
    assert message in messages
    assert messages.endswith("; skipped")


def test_labels_with_variants_in_the_memory_are_skipped():
    variants = "/begin VARIANT_CODING /begin VAR_CHARACTERISTIC L Engine /end VAR_CHARACTERISTIC /end VARIANT_CODING"
    message = aside(layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), variants, label("VALUE"))
    assert "(L): is variant-coded: it is stored once per variant; skipped" in message


def test_repeated_breakpoints_are_reported():
    entries = "AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT"
    message = aside(layout(*entries), label("CURVE", axis("STD_AXIS", 3)), memory=bytes([1, 5, 5, 1, 2, 3]))
    assert "has breakpoints that are not monotonic: number 2 is 5, number 3 is 5; skipped" in message


def test_many_labels_with_one_reason_share_one_remark():
    labels = [label("VALUE", name=f"L{i}", conversion="C") for i in range(25)]
    parameters, remarks = read(module(layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), *labels), bytes(4))
    assert not parameters
    [warning] = remarks
    assert "skipped 25 labels (L0, L1, L2, L3, L4 and 20 more): each has the conversion C, which is" in warning


def test_labels_outside_the_image_are_reported_once():
    labels = [label("VALUE", name=f"L{i}", address=0x9000 + i) for i in range(8)]
    parameters, remarks = read(module(layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), *labels, label("VALUE")), bytes(4))
    assert list(parameters) == ["L"]
    [warning] = remarks
    assert "skipped 8 labels (L0, L1, L2, L3, L4 and 3 more): address not in ecu.hex" in warning


@pytest.mark.parametrize("size", ["MATRIX_DIM 65535 65535", "NUMBER 4000000000", "MATRIX_DIM 65535 65535 65535 65535"])
def test_a_size_beyond_all_memory_takes_no_memory(size):
    messages = aside(layout("FNC_VALUES 1 FLOAT64_IEEE ROW_DIR DIRECT"), label("VAL_BLK", size))
    assert "address not in ecu.hex" in messages


def test_an_axis_beyond_all_memory_takes_no_memory():
    fixed = axis("FIX_AXIS", 2, "FIX_AXIS_PAR_DIST 0 1 4000000000")
    assert "address not in ecu.hex" in aside(layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("CURVE", fixed))
    entries = "AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ALTERNATE_WITH_X DIRECT"
    assert "address not in ecu.hex" in aside(layout(*entries), label("CURVE", axis("STD_AXIS", 4000000000)))


def test_limits_become_bounds_unless_they_are_those_of_the_data_type():
    blocks = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), method("CM", "LINEAR", "COEFFS_LINEAR 0.5 0")
    for limits, bounds in [("0 50", (0, 50)), ("0 127.5", (-np.inf, np.inf)), ("0 0", (-np.inf, np.inf))]:
        member = one(*blocks, label("VALUE", conversion="CM", limits=limits), memory=b"\x01")
        assert (float(member.lower), float(member.upper)) == bounds


def test_a_label_brings_its_function_short_name_unit_and_lock():
    function = '/begin FUNCTION F "" /begin DEF_CHARACTERISTIC L /end DEF_CHARACTERISTIC /end FUNCTION'
    entries = 'DISPLAY_IDENTIFIER short READ_ONLY PHYS_UNIT "1/min"'
    member = one(layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), function, label("VALUE", entries), memory=b"\x01")
    assert (member.functions, member.display_name, member.unit) == (("F",), "short", "1/min")
    assert member.locked.all()
    assert member.description == "words"


def test_an_image_of_another_program_is_reported():
    identity = '/begin MOD_PAR "" EPK "PROG2" ADDR_EPK 0x1010 /end MOD_PAR'
    blocks = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT"), label("VALUE")
    content = bytes(16) + b"PROG1"
    _, remarks = read(module(identity, *blocks), content)
    assert "contains the program identifier 'PROG1' at 0x1010, but ecu.a2l is for 'PROG2'" in remarks[0]
    assert read(module(identity, *blocks), content.replace(b"1", b"2"))[1] == []
