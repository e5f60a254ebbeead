"""Values written back into an image: rounded as the control unit stores them, and nothing else touched."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.calfiles.a2l.reader import read_parameters
from kennfeld.calfiles.a2l.writer import write_values
from kennfeld.calfiles.format import FileFindings
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Map, Scalar
from kennfeld.domain.texts import Text
from tests.calfiles.a2l_files import (
    ADDRESS,
    axis,
    hex_file,
    image_of,
    label,
    layout,
    method,
    module,
    parsed,
    read,
    shared_axis,
    write,
)
from tests.draws import few_or_many

BYTE = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")
TENTH = method("CM", "LINEAR", "COEFFS_LINEAR 0.1 0", "bar")
CHECKSUMS = "new.hex: checksums of the control unit are not updated; the flash tool must do it"


def values(*numbers, name="L"):
    """A change of the values of one label."""
    return lambda original: original.with_parameters(original[name].with_values(np.array(numbers)))


def errors(raw, memory, change):
    with pytest.raises(InputError) as caught:
        write(raw, memory, change)
    return [str(one) for one in caught.value.findings]


def test_unchanged_labels_keep_every_byte():
    text = module(BYTE, TENTH, label("VAL_BLK", "NUMBER 3", conversion="CM"))
    image, remarks = write(text, bytes([1, 2, 3]), lambda original: original)
    assert image.raw == hex_file({ADDRESS: bytes([1, 2, 3])})
    assert remarks == []


def test_a_changed_value_changes_its_bytes_alone():
    text = module(BYTE, TENTH, label("VAL_BLK", "NUMBER 3", conversion="CM"))
    image, remarks = write(text, bytes([1, 2, 3, 99]), values(0.1, 1.0, 0.3))
    assert image.raw == hex_file({ADDRESS: bytes([1, 10, 3, 99])})
    assert remarks == [CHECKSUMS]


def test_rounding_losses_are_reported():
    text = module(BYTE, TENTH, label("VAL_BLK", "NUMBER 2", conversion="CM"))
    image, remarks = write(text, bytes(2), values(0.24, 1.0))
    assert image.read(ADDRESS, 2) == bytes([2, 10])
    assert "1 number of 1 label rounded to storable values, by at most 0.04 bar (L, 0.04" in remarks[0]


@pytest.mark.parametrize("given", [(0.04, 0.0), (0.0, 0.04), (0.04, 0.02)])
def test_rounding_that_keeps_the_old_number_is_reported(given):
    text = module(BYTE, TENTH, label("VAL_BLK", "NUMBER 2", conversion="CM"))
    image, remarks = write(text, bytes(2), values(*given))
    assert image.raw == hex_file({ADDRESS: bytes(2)})
    count = "1 number" if 0.0 in given else "2 numbers"
    assert remarks == [
        f"new.hex: {count} of 1 label rounded to storable values, by at most 0.04 bar (L, 1 of its largest value)"
    ]


def test_of_two_numbers_as_near_the_even_one_is_stored():
    text = module(BYTE, method("CM", "LINEAR", "COEFFS_LINEAR 2 0"), label("VAL_BLK", "NUMBER 2", conversion="CM"))
    assert write(text, bytes(2), values(1.0, 3.0))[0].read(ADDRESS, 2) == bytes([0, 2])


@pytest.mark.parametrize(
    ("limits", "entries", "number", "span"),
    [("0 0", "", 25.6, "0 to 25.5"), ("0 5", "", 5.1, "0 to 5"), ("0 5", "EXTENDED_LIMITS 0 8", 8.1, "0 to 8")],
)
def test_a_value_beyond_what_is_allowed_is_an_error(limits, entries, number, span):
    text = module(BYTE, TENTH, label("VAL_BLK", f"NUMBER 2 {entries}", conversion="CM", limits=limits))
    [message] = errors(text, bytes(2), values(0.0, number))
    assert message == f"new.hex L: the value [2] is {number:g} bar, outside the storable and allowed range {span}"


def test_limits_printed_with_few_digits_do_not_forbid_what_can_be_stored():
    text = module(
        BYTE, method("CM", "LINEAR", "COEFFS_LINEAR 0.00390625 0"), label("VALUE", conversion="CM", limits="0 0.996")
    )
    assert write(text, bytes(1), values(255 / 256))[0].read(ADDRESS, 1) == b"\xff"


def test_a_value_that_is_missing_cannot_be_stored():
    assert "the value is nan" in errors(module(BYTE, label("VALUE")), b"\x01", values(np.nan))[0]


def test_a_value_beyond_its_limits_from_the_beginning_may_stay():
    text = module(BYTE, label("VAL_BLK", "NUMBER 2", limits="0 5"))
    assert write(text, bytes([200, 0]), values(200, 3))[0].read(ADDRESS, 2) == bytes([200, 3])


def test_bits_beside_a_mask_stay():
    text = module(layout("FNC_VALUES 1 UWORD ROW_DIR DIRECT"), label("VALUE", "BIT_MASK 0x0FF0"))
    assert write(text, b"\x3a\xb2", values(0x51))[0].read(ADDRESS, 2) == b"\x1a\xb5"
    assert "0 to 255" in errors(text, b"\x3a\xb2", values(256))[0]


def test_two_labels_may_share_a_byte_but_no_bit():
    low, high = label("VALUE", "BIT_MASK 0x0F", name="Low"), label("VALUE", "BIT_MASK 0xF0", name="High")
    whole = label("VALUE", name="Whole")

    def both(original):
        return original.with_parameters(original["Low"].with_values(3), original["High"].with_values(4))

    assert write(module(BYTE, low, high), b"\x00", both)[0].read(ADDRESS, 1) == b"\x43"

    def clash(original):
        return original.with_parameters(original["Low"].with_values(3), original["Whole"].with_values(4))

    messages = errors(module(BYTE, low, whole), b"\x00", clash)
    assert "new.hex Whole: shares memory with Low at 0x1000, which is set to another value" in messages[0]


def test_an_unintended_change_of_a_label_in_the_set_is_an_error():
    text = module(BYTE, label("VALUE", name="One"), label("VALUE", name="Other"))
    messages = errors(text, b"\x01", values(5, name="One"))
    assert "new.hex Other: changes unintentionally" in messages[0]

    def alone(original):
        return ParameterSet([original["One"].with_values(5)])

    image, remarks = write(text, b"\x01", alone)
    assert image.read(ADDRESS, 1) == b"\x05"
    assert any("new.hex Other: changes unintentionally" in one for one in remarks)


MAP = layout(
    "NO_AXIS_PTS_X 1 UBYTE",
    "NO_AXIS_PTS_Y 2 UBYTE",
    "AXIS_PTS_X 3 UBYTE INDEX_INCR DIRECT",
    "AXIS_PTS_Y 4 UBYTE INDEX_INCR DIRECT",
    "FNC_VALUES 5 UBYTE COLUMN_DIR DIRECT",
)


def test_breakpoints_are_written_with_the_values():
    text = module(MAP, label("MAP", axis("STD_AXIS", 3) + axis("STD_AXIS", 2)))
    before = bytes([2, 2, 10, 20, 1, 2, 1, 2, 3, 4])
    table = Map("L", [10, 25], [1, 3], [[1, 2], [3, 9]])
    image, _ = write(text, before, lambda original: original.with_parameters(table))
    assert image.read(ADDRESS, 10) == bytes([2, 2, 10, 25, 1, 3, 1, 2, 3, 9])


def test_a_table_may_get_as_many_breakpoints_as_there_is_room_for():
    text = module(MAP, label("MAP", axis("STD_AXIS", 3) + axis("STD_AXIS", 2)))
    before = bytes([2, 2, 10, 20, 1, 2, 1, 2, 3, 4, 255, 255, 255])
    table = Map("L", [10, 20, 30], [1, 2], [[1, 2], [3, 4], [5, 6]])
    image, _ = write(text, before, lambda original: original.with_parameters(table))
    assert image.read(ADDRESS, 13) == bytes([3, 2, 10, 20, 30, 1, 2, 1, 2, 3, 4, 5, 6])
    again, _ = read(text, image.read(ADDRESS, 13))
    assert again["L"].values.tolist() == table.values.tolist()
    table = Map("L", [10, 20, 30, 40], [1, 2], np.ones((4, 2)))
    assert (
        "states 4 axis points in direction X, but at most 3 are allowed"
        in errors(text, before, lambda original: original.with_parameters(table))[0]
    )


def test_a_table_without_a_number_of_points_keeps_it():
    text = module(
        layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT"),
        label("CURVE", axis("STD_AXIS", 2)),
    )
    table = Curve("L", [1, 2, 3], [4, 5, 6])
    messages = errors(text, bytes([1, 2, 3, 4]), lambda original: original.with_parameters(table))
    assert "new.hex L: has 3 points, but 2 in the image, which stores no point count" in messages[0]


COMMON = (
    layout("NO_AXIS_PTS_X 1 UBYTE", "AXIS_PTS_X 2 UBYTE INDEX_INCR DIRECT", name="RA"),
    shared_axis(4),
    BYTE,
    label("CURVE", axis("COM_AXIS", 4, "AXIS_PTS_REF A")),
    label("CURVE", axis("COM_AXIS", 4, "AXIS_PTS_REF A"), name="M", address=0x3000),
)
MEMORY = {ADDRESS: bytes([1, 2, 3, 0]), 0x2000: bytes([3, 10, 20, 30, 0]), 0x3000: bytes([7, 8, 9, 0])}


def moved(original, points, names=("L", "M"), extra=()):
    moved_tables = [
        Curve(name, original[name].axes[0].changed(breakpoints=points), [*original[name].values, *extra])
        for name in names
    ]
    return original.with_parameters(*moved_tables) if len(names) == 2 else ParameterSet(moved_tables)


def test_common_breakpoints_are_written_once():
    image, remarks = write(module(*COMMON), MEMORY, lambda original: moved(original, [10, 22, 30]))
    assert image.read(0x2000, 5) == bytes([3, 10, 22, 30, 0])
    assert image.read(ADDRESS, 4) == MEMORY[ADDRESS]
    assert remarks == [CHECKSUMS]


def test_common_breakpoints_may_become_more_with_all_their_tables():
    image, _ = write(module(*COMMON), MEMORY, lambda original: moved(original, [10, 20, 30, 40], extra=(5,)))
    assert image.read(0x2000, 5) == bytes([4, 10, 20, 30, 40])
    assert image.read(ADDRESS, 4) == bytes([1, 2, 3, 5])
    messages = errors(module(*COMMON), MEMORY, lambda original: moved(original, [10, 20, 30, 40], ("L",), (5,)))
    assert "1 label (M) sharing them are not given" in messages[0]


def test_a_table_with_other_breakpoints_than_its_common_axis_is_an_error():
    def change(original):
        return ParameterSet([Curve("L", [10, 25, 30], [1, 2, 3])])

    messages = errors(module(*COMMON), MEMORY, change)
    assert "new.hex L: has the X breakpoint 25, where the common axis A has 20" in messages[0]


def test_fixed_breakpoints_cannot_change():
    text = module(BYTE, label("CURVE", axis("FIX_AXIS", 3, "FIX_AXIS_PAR_DIST 0 10 3")))
    messages = errors(text, bytes(3), lambda original: original.with_parameters(Curve("L", [0, 11, 20], [1, 2, 3])))
    assert "has the X breakpoint 11, which the control unit fixes to 10" in messages[0]


def test_a_falling_axis_stays_falling():
    text = module(
        layout("AXIS_PTS_X 1 UBYTE INDEX_DECR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT"),
        label("CURVE", axis("STD_AXIS", 3)),
    )
    curve = Curve("L", [10, 20, 31], [1, 2, 9])
    image, _ = write(text, bytes([30, 20, 10, 3, 2, 1]), lambda original: original.with_parameters(curve))
    assert image.read(ADDRESS, 6) == bytes([31, 20, 10, 9, 2, 1])


def test_breakpoints_kept_as_distances_are_written_as_such():
    text = module(
        layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT"),
        label("CURVE", axis("STD_AXIS", 3, "DEPOSIT DIFFERENCE")),
    )
    curve = Curve("L", [10, 20, 35], [1, 2, 3])
    image, _ = write(text, bytes([10, 5, 20, 1, 2, 3]), lambda original: original.with_parameters(curve))
    assert image.read(ADDRESS, 6) == bytes([10, 10, 15, 1, 2, 3])
    far = Curve("L", [10, 20, 300], [1, 2, 3])
    assert (
        "the X breakpoint [3] is 300"
        in errors(text, bytes([10, 5, 20, 1, 2, 3]), lambda original: original.with_parameters(far))[0]
    )


def test_read_only_labels_stay_and_are_reported():
    text = module(BYTE, label("VALUE", "READ_ONLY"))
    image, remarks = write(text, b"\x01", values(2))
    assert image.read(ADDRESS, 1) == b"\x01"
    assert remarks == ["new.hex L: is READ_ONLY: 1 changed value not written"]


def test_a_conversion_without_an_inverse_cannot_be_changed():
    text = module(BYTE, method("CM", "FORM", '/begin FORMULA "X1*2" /end FORMULA'), label("VALUE", conversion="CM"))
    assert write(text, b"\x03", lambda original: original)[0].read(ADDRESS, 1) == b"\x03"
    assert "cannot be changed: the conversion CM has no inverse" in errors(text, b"\x03", values(8))[0]


def test_a_distant_closest_number_of_a_table_is_reported():
    table = '/begin COMPU_TAB T "" TAB_NOINTP 2 0 10 1 30 /end COMPU_TAB'
    text = module(BYTE, method("CM", "TAB_NOINTP", "COMPU_TAB_REF T"), table, label("VALUE", conversion="CM"))
    image, remarks = write(text, b"\x00", values(24))
    assert image.read(ADDRESS, 1) == b"\x01"
    assert "6" in remarks[0]


def texts(text):
    return lambda original: ParameterSet(original.parameters, [replace(original.texts[0], text=text)])


def test_texts_are_written_and_filled_up():
    text = module(BYTE, label("ASCII", "NUMBER 5"))
    assert write(text, b"abc\0x", texts("ab"))[0].read(ADDRESS, 5) == b"ab\0\0\0"
    assert write(text, b"abc\0x", texts("abc"))[0].read(ADDRESS, 5) == b"abc\0x"
    assert "has 6 characters, but there is room for 5" in errors(text, b"abc\0x", texts("abcdef"))[0]


def test_words_are_written_as_their_numbers():
    words = '/begin COMPU_VTAB W "" TAB_VERB 2 1 "on" 2 "off" /end COMPU_VTAB'
    text = module(
        BYTE, words, method("CM", "TAB_VERB", "COMPU_TAB_REF W"), label("VALUE", "BIT_MASK 0x0C", conversion="CM")
    )
    assert write(text, b"\xf7", texts("off"))[0].read(ADDRESS, 1) == b"\xfb"
    assert "must be one of its texts, got 'of'. Choose from on, off" in errors(text, b"\xf7", texts("of"))[0]


def test_a_word_of_another_kind_is_written_with_a_remark():
    words = '/begin COMPU_VTAB W "" TAB_VERB 2 1 "on" 2 "off" /end COMPU_VTAB'
    text = module(BYTE, words, method("CM", "TAB_VERB", "COMPU_TAB_REF W"), label("VALUE", conversion="CM"))
    image, remarks = write(text, b"\x01", lambda original: ParameterSet([], [Text("L", "off")]))
    assert image.read(ADDRESS, 1) == b"\x02"
    assert remarks == ["new.hex L: is of kind text, but enumeration in the control unit", CHECKSUMS]


def test_labels_missing_in_the_description_are_reported():
    def change(original):
        return original.merged(ParameterSet([Scalar("New", 1.0)], [Text("Words", "a")]))

    image, remarks = write(module(BYTE, label("VALUE")), b"\x01", change)
    assert image.read(ADDRESS, 1) == b"\x01"
    assert remarks == ["new.hex: 2 labels (New, Words) left out: not in ecu.a2l"]


def test_further_variants_are_skipped_with_a_remark():
    def change(original):
        member = original["L"].changed(variant="Car=A")
        return ParameterSet([member], others=[member.changed(variant="Car=B")])

    _, remarks = write(module(BYTE, label("VALUE")), b"\x01", change)
    assert remarks == [
        "new.hex: further variants of 1 label (L) left out: the control unit has one place for each",
    ]


def test_labels_that_follow_from_changed_ones_are_reported():
    dependent = '/begin DEPENDENT_CHARACTERISTIC "X1*5" L /end DEPENDENT_CHARACTERISTIC'
    text = module(BYTE, label("VALUE"), label("VALUE", dependent, name="Five", address=ADDRESS + 1))
    _, remarks = write(text, b"\x01\x05", values(2))
    assert "not recomputed although labels in their formulas changed: 1 label (Five)" in "\n".join(remarks)


def test_another_unit_is_reported():
    text = module(BYTE, TENTH, label("VALUE", conversion="CM"))
    _, remarks = write(text, b"\x01", lambda original: ParameterSet([Scalar("L", 0.1, unit="kPa")]))
    assert "written without conversion, since ecu.a2l states another unit: L in kPa, not bar" in remarks[0]


def test_another_kind_is_an_error():
    messages = errors(
        module(BYTE, label("VALUE")), b"\x01", lambda original: ParameterSet([Curve("L", [1, 2], [1, 2])])
    )
    assert "new.hex L: is a curve, but a scalar in the control unit" in messages[0]


def test_a_label_outside_the_image_is_reported():
    text = module(BYTE, label("VALUE"), label("VALUE", name="Far", address=0x9000))
    _, remarks = write(text, b"\x01", lambda original: ParameterSet([Scalar("Far", 3.0)]))
    assert remarks == ["new.hex Far: cannot be written: 0x9000 is not in ecu.hex"]


KINDS = {
    "UBYTE": (0, 2**8 - 1),
    "SBYTE": (-(2**7), 2**7 - 1),
    "UWORD": (0, 2**16 - 1),
    "SWORD": (-(2**15), 2**15 - 1),
    "ULONG": (0, 2**32 - 1),
    "SLONG": (-(2**31), 2**31 - 1),
    "A_INT64": (-(2**53), 2**53),
}
ORDERS = ("MSB_LAST", "MSB_FIRST", "MSB_FIRST_MSW_LAST", "MSB_LAST_MSW_FIRST")


@st.composite
def tables(draw):
    """The text of a map of any layout, a memory for it, and raw numbers to be written."""
    kinds = {key: draw(st.sampled_from(sorted(KINDS))) for key in ("x", "y", "z")}
    sizes = draw(st.tuples(st.integers(1, 4), st.integers(1, 4)))
    mode = draw(st.sampled_from(["ROW_DIR", "COLUMN_DIR", "ALTERNATE_WITH_X", "ALTERNATE_WITH_Y"]))
    parts = ["NO_AXIS_PTS_X {} UBYTE", "NO_AXIS_PTS_Y {} UBYTE", "RESERVED {} LONG"]
    rest = [f"AXIS_PTS_X {{}} {kinds['x']} INDEX_INCR DIRECT", f"AXIS_PTS_Y {{}} {kinds['y']} INDEX_INCR DIRECT"]
    rest = draw(st.permutations([*rest, f"FNC_VALUES {{}} {kinds['z']} {mode} DIRECT"]))
    entries = [entry.format(i) for i, entry in enumerate([*parts, *rest], 1)]
    if mode in ("ROW_DIR", "COLUMN_DIR") and draw(st.booleans()):
        entries.append(draw(st.sampled_from(["STATIC_RECORD_LAYOUT", "STATIC_ADDRESS_OFFSETS"])))
    entries += [f"ALIGNMENT_{kind} {draw(st.sampled_from([1, 2, 4, 8]))}" for kind in ("WORD", "LONG", "INT64")]
    order = draw(st.sampled_from(ORDERS))
    head = f'/begin MOD_COMMON "" BYTE_ORDER {order} /end MOD_COMMON'
    axes = axis("STD_AXIS", 4) + axis("STD_AXIS", 4)
    points = [
        sorted(draw(st.sets(st.integers(*KINDS[kinds[key]]), min_size=size, max_size=size)))
        for key, size in zip("xy", sizes, strict=True)
    ]
    count = sizes[0] * sizes[1]
    raw = draw(st.lists(st.integers(*KINDS[kinds["z"]]), min_size=count, max_size=count))
    return module(layout(*entries), label("MAP", axes), common=head), points, np.reshape(raw, sizes)


@pytest.mark.slow
@few_or_many(tables(), few=12, many=150)
def test_written_tables_are_read_again_in_every_layout(table):
    text, points, raw = table
    start = b"\x01" * 800
    expected = Map("L", *[np.array(axis_points, float) for axis_points in points], raw.astype(float))
    image, _ = write(text, start, lambda _: ParameterSet([expected]))
    parameters, _ = read(text, image.read(ADDRESS, len(start)))
    assert parameters["L"].values.tolist() == expected.values.tolist()
    for again, axis_before in zip(parameters["L"].axes, expected.axes, strict=True):
        assert again.breakpoints.tolist() == axis_before.breakpoints.tolist()
    a2l, _ = parsed(text)
    memory = image_of(image.read(ADDRESS, len(start)))
    assert write_values(a2l, memory, read_parameters(a2l, memory, FileFindings("")), FileFindings("")) == memory.raw


@few_or_many(
    st.sampled_from(ORDERS), st.floats(width=32, allow_nan=False, allow_infinity=False), st.booleans(), few=20, many=100
)
def test_floating_point_numbers_are_written_exactly(order, number, double):
    kind = "FLOAT64_IEEE" if double else "FLOAT32_IEEE"
    text = module(layout(f"FNC_VALUES 1 {kind} ROW_DIR DIRECT"), label("VALUE", f"BYTE_ORDER {order}"))
    image, remarks = write(text, b"\x00" * 8, values(number))
    assert read(text, image.read(ADDRESS, 8))[0]["L"].value == number
    assert remarks in ([], [CHECKSUMS])
