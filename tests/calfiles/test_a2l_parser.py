"""A2L files: blocks, words and texts, and the objects that they describe."""

from pathlib import Path

import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles.a2l.objects import summarise_labels
from tests.calfiles.a2l_files import COMMON, label, layout, method, module, parsed, shared_axis

SCALAR = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")


def errors(raw, include=None):
    with pytest.raises(InputError) as caught:
        parsed(raw, include)
    return [str(one) for one in caught.value.findings]


def only(*blocks):
    a2l, remarks = parsed(module(*blocks))
    assert remarks == []
    [characteristic] = a2l.characteristics.values()
    return characteristic


def test_a_characteristic_has_the_entries_of_its_block():
    characteristic = only(
        label(
            "VALUE",
            'EXTENDED_LIMITS -1 1e3 BIT_MASK 0x0FF0 FORMAT "%4.1" PHYS_UNIT "rpm" READ_ONLY '
            "DISPLAY_IDENTIFIER short.name BYTE_ORDER MSB_FIRST",
            limits="0.5 100",
            conversion="CM",
        )
    )
    assert (characteristic.name, characteristic.description, characteristic.type, characteristic.address) == (
        "L",
        "words",
        "VALUE",
        0x1000,
    )
    assert (characteristic.lower, characteristic.upper, characteristic.extended_limits) == (0.5, 100.0, (-1.0, 1000.0))
    assert (characteristic.bit_mask, characteristic.phys_unit, characteristic.read_only) == (0xFF0, "rpm", True)
    assert (characteristic.display_identifier, characteristic.byte_order, characteristic.conversion) == (
        "short.name",
        "MSB_FIRST",
        "CM",
    )


@pytest.mark.parametrize(
    ("written", "text"),
    [
        ('"plain"', "plain"),
        ('"5"" tyre"', '5" tyre'),
        (r'"5\" tyre"', '5" tyre'),
        (r'"back\\slash"', "back\\slash"),
        (r'"C:\dir"', r"C:\dir"),
        ('"/* no comment */ // nor this"', "/* no comment */ // nor this"),
        ('"two\nlines"', "two lines"),
        ('"°C"', "°C"),
    ],
)
def test_texts_may_hold_quotes_and_marks_of_comments(written, text):
    assert only(label("VALUE").replace('"words"', written)).description == text


def test_comments_may_stand_anywhere():
    text = (
        "/* one */ /begin /* two */ CHARACTERISTIC /* three */ L // four\n" + '"words"/*five*/VALUE 0x1000 RL 0 CM 0 1'
    )
    assert only(text + "\n/end /* six */ CHARACTERISTIC").address == 0x1000


def test_the_encoding_is_detected():
    for raw in (module(label("VALUE").replace("words", "Öl °C")),):
        assert parsed(raw.decode().encode("cp1252"))[0].characteristics["L"].description == "Öl °C"
        assert parsed(b"\xef\xbb\xbf" + raw)[0].characteristics["L"].description == "Öl °C"


def test_entries_for_tools_are_skipped():
    tools = (
        '/begin A2ML block "IF_DATA" struct { char[10]; } /* " */ "/begin" /end A2ML',
        '/begin IF_DATA XCP /begin SEGMENT 1 "/end IF_DATA" /end SEGMENT VALUE 3 /end IF_DATA',
    )
    characteristic = only(*tools, label("VALUE", tools[1]))
    assert characteristic.name == "L"


def test_names_are_lines_of_the_file():
    a2l, _ = parsed(module("", "", label("VALUE"), label("VALUE", name="Second")))
    assert [one.line for one in a2l.characteristics.values()] == [7, 10]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('/begin PROJECT P "" /begin MODULE M ""', "line 1: MODULE is not closed. The file is truncated."),
        ('/begin PROJECT P "" /begin MODULE M "" "open', "a quote or a comment is not closed"),
        ("/begin PROJECT P /* open", "a quote or a comment is not closed"),
        ('/begin PROJECT P "" /begin MODULE M "" /begin A2ML', "A2ML is not closed"),
        ('/begin PROJECT P "" /begin MODULE M "" /end PROJECT', "/end PROJECT comes before the MODULE of line 1 is"),
        ("/begin MODULE M /end MODULE /end MODULE", "/end MODULE without a matching /begin"),
        ("/begin MODULE M /end", "ends after /end"),
        ("/begin X " * 70, "blocks are nested more than 64 levels deep"),
        ("ASAP2_VERSION 1 61", "has no MODULE"),
        ('/begin MODULE M "" /include "more.a2l" /end MODULE', "/include 'more.a2l': cannot be read"),
    ],
)
def test_a_broken_structure_is_an_error(text, message):
    assert message in errors(text.encode())[0]


def test_another_file_may_be_included():
    files = {"labels.a2l": label("VALUE").encode(), "all.a2l": b'/include "labels.a2l"'}
    a2l, _ = parsed(module('/include "all.a2l"'), lambda name, _: (Path(name), files[name]))
    assert list(a2l.characteristics) == ["L"]


def test_a_missing_file_about_interfaces_does_not_matter():
    a2l, remarks = parsed(module('/include "XCP_104.aml"', label("VALUE")))
    assert list(a2l.characteristics) == ["L"]
    assert "line 5: /include 'XCP_104.aml': file not found; skipped" in remarks[0]


def test_files_that_include_each_other_are_an_error():
    assert (
        "too many files include each other"
        in errors(module("/include a"), lambda *_: (Path("a"), b"/include a /include a"))[0]
    )


@pytest.mark.parametrize(
    ("block", "message"),
    [
        (label("VALUE").replace("0x1000", "here"), "(L): CHARACTERISTIC has 'here' where its address should be"),
        (label("VALU"), "(L): CHARACTERISTIC has the unknown type 'VALU'; skipped"),
        ("/begin CHARACTERISTIC L /end CHARACTERISTIC", "(L): CHARACTERISTIC has no description in quotes"),
        (label("VAL_BLK", "MATRIX_DIM -1 3"), "has an invalid MATRIX_DIM: -1 3"),
        (label("VALUE", "BIT_MASK none"), "has 'none' after BIT_MASK"),
        (method("C", "RAT_FUNC", "COEFFS 0 1 0 0 0"), "has too few words after COEFFS"),
        (method("C", "LINEAR", ""), "(C): COMPU_METHOD is LINEAR without 2 finite coefficients"),
        ('/begin COMPU_TAB T "" TAB_INTP 1000000000 1 2 /end COMPU_TAB', "states 1000000000 rows, but has fewer"),
    ],
)
def test_a_wrong_object_is_reported_and_skipped(block, message):
    a2l, remarks = parsed(module(block, SCALAR))
    assert message in remarks[0]
    assert not a2l.characteristics
    assert list(a2l.record_layouts) == ["RL"]


def test_of_two_objects_with_one_name_the_first_counts():
    a2l, remarks = parsed(module(label("VALUE"), label("VALUE", address=5)))
    assert a2l.characteristics["L"].address == 0x1000
    assert "(L): duplicate CHARACTERISTIC; the first one is used" in remarks[0]


def test_functions_come_from_both_sides():
    function = '/begin FUNCTION F "" /begin DEF_CHARACTERISTIC L /end DEF_CHARACTERISTIC /end FUNCTION'
    characteristic = only(label("VALUE", "/begin FUNCTION_LIST G /end FUNCTION_LIST"), function)
    assert characteristic.functions == ("F", "G")


INSTANCES = """
/begin TYPEDEF_CHARACTERISTIC T "" VALUE RL 0 NO_COMPU_METHOD 0 10 /end TYPEDEF_CHARACTERISTIC
/begin TYPEDEF_CHARACTERISTIC C "" CURVE RL 0 NO_COMPU_METHOD 0 10
  /begin AXIS_DESCR COM_AXIS NO_INPUT_QUANTITY NO_COMPU_METHOD 3 0 1 AXIS_PTS_REF THIS.ax /end AXIS_DESCR
/end TYPEDEF_CHARACTERISTIC
/begin TYPEDEF_AXIS A "" NO_INPUT_QUANTITY RA 0 NO_COMPU_METHOD 3 0 1 /end TYPEDEF_AXIS
/begin TYPEDEF_STRUCTURE S "" 16
  /begin STRUCTURE_COMPONENT a T 0 /end STRUCTURE_COMPONENT
  /begin STRUCTURE_COMPONENT b T 4 MATRIX_DIM 3 /end STRUCTURE_COMPONENT
  /begin STRUCTURE_COMPONENT ax A 8 /end STRUCTURE_COMPONENT
  /begin STRUCTURE_COMPONENT c C 12 /end STRUCTURE_COMPONENT
/end TYPEDEF_STRUCTURE
/begin INSTANCE one "a scalar" T 0x10 /end INSTANCE
/begin TYPEDEF_MEASUREMENT Measured "" UBYTE NO_COMPU_METHOD 0 0 0 255 /end TYPEDEF_MEASUREMENT
/begin INSTANCE seen "not calibrated" Measured 0x20 MATRIX_DIM 4 /end INSTANCE
/begin INSTANCE all "" S 0x100 MATRIX_DIM 2 /end INSTANCE
"""


def test_instances_become_the_labels_that_their_types_describe():
    a2l, remarks = parsed(module(INSTANCES))
    assert remarks == []
    assert {name: one.address for name, one in a2l.characteristics.items()} == {
        "one": 0x10,
        "all[0].a": 0x100,
        "all[0].b": 0x104,
        "all[0].c": 0x10C,
        "all[1].a": 0x110,
        "all[1].b": 0x114,
        "all[1].c": 0x11C,
    }
    assert {name: one.address for name, one in a2l.axis_pts.items()} == {"all[0].ax": 0x108, "all[1].ax": 0x118}
    assert a2l.characteristics["all[1].c"].axes[0].axis_pts_ref == "all[1].ax"
    assert (a2l.characteristics["all[0].b"].type, a2l.characteristics["all[0].b"].shape) == ("VAL_BLK", (3,))


@pytest.mark.parametrize("read_only", ["", "type", "instance"])
def test_an_instance_is_read_only_if_it_or_its_type_is(read_only):
    options = {name: "READ_ONLY" if name == read_only else "" for name in ("type", "instance")}
    a2l, _ = parsed(
        module(
            f'/begin TYPEDEF_CHARACTERISTIC T "" VALUE RL 0 C 0 10 {options["type"]} /end TYPEDEF_CHARACTERISTIC',
            f'/begin INSTANCE K "" T 0x10 {options["instance"]} /end INSTANCE',
        )
    )
    assert a2l.characteristics["K"].read_only == bool(read_only)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('/begin INSTANCE i "" Missing 0 /end INSTANCE', "is of the type Missing, which is not defined"),
        ('/begin INSTANCE i "" S 0 MATRIX_DIM 65535 65535 /end INSTANCE', "elements, more than 100000"),
        ('/begin INSTANCE i "" R 0 /end INSTANCE', "structures nested more than 16 levels deep"),
        ('/begin INSTANCE i "" T 0 /begin OVERWRITE a 0 /end OVERWRITE /end INSTANCE', "overwrites parts of its type"),
    ],
)
def test_an_instance_that_cannot_be_expanded_is_reported(text, message):
    inner = "/begin STRUCTURE_COMPONENT r R 0 /end STRUCTURE_COMPONENT"
    circle = f'/begin TYPEDEF_STRUCTURE R "" 4 {inner} /end TYPEDEF_STRUCTURE'
    assert message in parsed(module(INSTANCES, circle, text))[1][0]


def test_a_description_lists_every_label():
    blocks = (label("VAL_BLK", "MATRIX_DIM 3 4 1", limits="0 5", conversion="CM"), method("CM", "IDENTICAL", "", "bar"))
    labels = summarise_labels(parsed(module(*blocks, shared_axis(7), SCALAR))[0])
    assert [(one.name, one.kind, one.shape, one.unit) for one in labels] == [
        ("L", "block", (3, 4), "bar"),
        ("A", "group axis", (7,), ""),
    ]
    assert (labels[0].lower, labels[0].upper, labels[0].address) == (0, 5, 0x1000)


def test_the_program_that_a_file_describes_is_known():
    a2l, _ = parsed(module('/begin MOD_PAR "" EPK "V1.2" ADDR_EPK 0x10 /end MOD_PAR', common=COMMON))
    assert (a2l.epk, a2l.epk_addresses) == ("V1.2", (0x10,))
