"""Conversions of A2L: raw numbers to physical ones and back."""

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld.calfiles.a2l.conversion import conversion_of, parse_formula
from kennfeld.calfiles.a2l.syntax import A2lError
from kennfeld.domain.texts import Text
from tests.calfiles.a2l_files import label, layout, method, module, parsed, read, write
from tests.draws import few_or_many

TABLE = '/begin COMPU_TAB T "" TAB_INTP 3 0 10 2 30 4 35 {} /end COMPU_TAB'
WORDS = '/begin COMPU_VTAB W "" TAB_VERB 2 1 "on" 2 "off" {} /end COMPU_VTAB'
RANGES = '/begin COMPU_VTAB_RANGE W "" 2 0 3 "low" 4 7 "high" {} /end COMPU_VTAB_RANGE'
BYTE = layout("FNC_VALUES 1 UBYTE ROW_DIR DIRECT")


def conversion_method(kind, entries, *blocks, limits=(-np.inf, np.inf)):
    a2l, _ = parsed(module(method("CM", kind, entries), *blocks))
    return conversion_of(a2l, "CM", *limits)


@pytest.mark.parametrize(
    ("kind", "entries", "raw", "physical"),
    [
        ("IDENTICAL", "", [0, 7], [0, 7]),
        ("LINEAR", "COEFFS_LINEAR 0.25 -40", [0, 200], [-40, 10]),
        ("RAT_FUNC", "COEFFS 0 81.9175 0 0 0 1", [0, 34], [0, 34 / 81.9175]),
        ("RAT_FUNC", "COEFFS 0 1 50 0 0 1", [52], [2]),
        ("RAT_FUNC", "COEFFS 0 0 1 0 1 0", [1, 4], [1, 0.25]),
        ("RAT_FUNC", "COEFFS 0 2 3 0 4 5", [0.55], [(5 * 0.55 - 3) / (2 - 4 * 0.55)]),
        ("FORM", '/begin FORMULA "X1+4" FORMULA_INV "X1-4" /end FORMULA', [3], [7]),
    ],
)
def test_conversions_work_both_ways(kind, entries, raw, physical):
    conversion = conversion_method(kind, entries)
    assert conversion.physical(np.array(raw, float)) == pytest.approx(physical, rel=1e-15)
    assert conversion.raw(np.array(physical, float)) == pytest.approx(raw, rel=1e-14)


def test_a_quadratic_is_solved_where_the_limits_leave_one_root():
    square = conversion_method("RAT_FUNC", "COEFFS 1 0 0 0 0 1", limits=(0.0, 20.0))
    assert square.physical(np.array([0.0, 4.0, 400.0])).tolist() == [0, 2, 20]
    assert np.isnan(square.physical(np.array([441.0, -1.0]))).all()
    assert np.isnan(conversion_method("RAT_FUNC", "COEFFS 1 0 0 0 0 1").physical(np.array([4.0]))).all()


@few_or_many(
    coeffs=st.tuples(*[st.floats(-10, 10, allow_subnormal=False).map(lambda value: round(value, 3))] * 3),
    physical=st.floats(-100, 100),
    few=20,
    many=100,
)
def test_a_quadratic_is_the_inverse_of_its_formula(coeffs, physical):
    a, b, c = coeffs
    if abs(a) < 0.01 or abs(2 * a * physical + b) < 0.1:
        return
    vertex = -b / (2 * a)
    limits = (vertex, np.inf) if physical > vertex else (-np.inf, vertex)
    conversion = conversion_method("RAT_FUNC", f"COEFFS {a} {b} {c} 0 0 1", limits=limits)
    raw = a * physical**2 + b * physical + c
    assert conversion.physical(np.array([raw])) == pytest.approx([physical], rel=1e-6, abs=1e-6)
    assert conversion.raw(np.array([physical])) == pytest.approx([raw], rel=1e-12, abs=1e-12)


def test_raw_numbers_without_a_physical_value_are_missing_and_reported():
    blocks = BYTE, method("CM", "RAT_FUNC", "COEFFS 0 0 1 0 1 0"), label("VAL_BLK", "NUMBER 3", conversion="CM")
    parameters, remarks = read(module(*blocks), bytes([0, 1, 2]))
    assert np.array_equal(parameters["L"].values, [np.nan, 1, 0.5], equal_nan=True)
    assert "1 of 3 values have no finite physical value under the conversion CM" in remarks[0]


def test_a_table_is_interpolated_within_its_ends():
    conversion = conversion_method("TAB_INTP", "COMPU_TAB_REF T", TABLE.format(""))
    assert conversion.physical(np.array([0.0, 1.0, 3.0, 4.0])).tolist() == [10, 20, 32.5, 35]
    assert np.isnan(conversion.physical(np.array([-1.0, 5.0]))).all()
    assert conversion.raw(np.array([10.0, 32.5])).tolist() == [0, 3]
    assert conversion_method("TAB_INTP", "COMPU_TAB_REF T", TABLE.format("DEFAULT_VALUE_NUMERIC 9")).physical(
        np.array([5.0])
    ) == [9]


def test_a_table_that_falls_is_interpolated_back_and_one_that_turns_is_not():
    falling = '/begin COMPU_TAB T "" TAB_INTP 2 0 10 2 0 /end COMPU_TAB'
    assert conversion_method("TAB_INTP", "COMPU_TAB_REF T", falling).raw(np.array([2.5])) == [1.5]
    turning = '/begin COMPU_TAB T "" TAB_INTP 3 0 10 2 0 4 5 /end COMPU_TAB'
    assert conversion_method("TAB_INTP", "COMPU_TAB_REF T", turning).raw is None


def test_a_table_without_interpolation_knows_its_own_numbers_alone():
    conversion = conversion_method("TAB_NOINTP", "COMPU_TAB_REF T", TABLE.format(""))
    assert conversion.physical(np.array([0.0, 2.0, 4.0])).tolist() == [10, 30, 35]
    assert np.isnan(conversion.physical(np.array([1.0])))
    assert conversion.raw(np.array([11.0, 31.0, 99.0])).tolist() == [0, 2, 4]


@pytest.mark.parametrize(
    ("table", "raw", "word"), [(WORDS, 2, "off"), (RANGES, 3, "low"), (RANGES, 4, "high"), (WORDS, 9, "neither")]
)
def test_a_scalar_with_words_is_a_text(table, raw, word):
    blocks = BYTE, method("CM", "TAB_VERB", "COMPU_TAB_REF W"), table.format('DEFAULT_VALUE "neither"')
    parameters, remarks = read(module(*blocks, label("VALUE", conversion="CM")), bytes([raw]))
    assert (parameters.texts[0].name, parameters.texts[0].text, remarks) == ("L", word, [])
    assert parameters.texts[0].kind == "enumeration"


def test_the_words_true_and_false_are_a_boolean():
    words = '/begin COMPU_VTAB W "" TAB_VERB 2 0 "false" 1 "true" /end COMPU_VTAB'
    blocks = BYTE, method("CM", "TAB_VERB", "COMPU_TAB_REF W"), words
    parameters, _ = read(module(*blocks, label("VALUE", conversion="CM")), b"\x01")
    assert parameters.texts == (Text("L", "true", parameters.texts[0].description, unit="-", kind="boolean"),)


def test_words_without_a_place_are_reported():
    blocks = BYTE, method("CM", "TAB_VERB", "COMPU_TAB_REF W"), WORDS.format("")
    assert (
        "has the raw value 9, for which W defines no text; skipped"
        in read(module(*blocks, label("VALUE", conversion="CM")), b"\x09")[1][0]
    )
    assert (
        "is a VAL_BLK of verbal values, which cannot be calibrated; skipped"
        in read(module(*blocks, label("VAL_BLK", "NUMBER 2", conversion="CM")), b"\x01\x02")[1][0]
    )


@pytest.mark.parametrize(
    ("kind", "entries", "message"),
    [
        ("TAB_INTP", "COMPU_TAB_REF X", "whose table 'X' is not defined"),
        ("FORM", '/begin FORMULA "sysc(X1)" /end FORMULA', "whose formula 'sysc(X1)' is not supported"),
        ("FORM", "", "which has no FORMULA"),
        ("CURIOUS", "", "of the unknown kind 'CURIOUS'"),
        ("RAT_FUNC", "COEFFS 0 0 5 0 0 1", "which has no physical value"),
        ("RAT_FUNC", "COEFFS 0 2 4 0 1 2", "maps every value to the same raw value"),
    ],
)
def test_an_unsupported_conversion_is_reported(kind, entries, message):
    with pytest.raises(A2lError, match="has the conversion CM") as caught:
        conversion_method(kind, entries)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("X1", 3.0),
        ("2*X1+4", 10.0),
        ("2*(X1+4)", 14.0),
        ("-X1/-2", 1.5),
        ("8-2-1", 5.0),
        ("16/4/2", 2.0),
        ("1.5e1 + .5", 15.5),
        ("sqrt(X1*3)", 3.0),
        ("POW(X1, 2) - abs(-1)", 8.0),
        ("sin(0) + cos(0) + tan(0) + exp(0)", 2.0),
    ],
)
def test_a_formula_is_followed(text, value):
    assert parse_formula(text)(np.array([3.0])) == pytest.approx([value])


@pytest.mark.parametrize(
    "text",
    [
        "",
        "X1 X1",
        "X2",
        "X1^2",
        "log(X1)",
        "(X1",
        "X1)",
        "pow(X1)",
        "__import__('os')",
        "1+" * 400 + "1",
        "(" * 99,
        "sqrt",
    ],
)
def test_a_formula_with_something_else_in_it_is_not(text):
    assert parse_formula(text) is None


def test_a_formula_without_a_finite_value_gives_none():
    assert np.isnan(parse_formula("1/X1")(np.array([0.0])))


@pytest.mark.parametrize("number", ["9" * 400, "9" * 400 + ".0", "1e400"])
def test_a_number_beyond_those_of_a_computer_is_infinite(number):
    assert np.isnan(parse_formula(f"X1 - {number}")(np.array([1.0])))
    assert parse_formula(f"X1 / {number}")(np.array([1.0])) == [0.0]


@few_or_many(
    raw=st.lists(st.integers(0, 255), min_size=1, max_size=8),
    slope=st.floats(1e-3, 1e3) | st.floats(-1e3, -1e-3),
    offset=st.floats(-1e3, 1e3),
    shift=st.floats(-0.49, 0.49),
    few=20,
    many=100,
)
def test_the_nearest_raw_number_is_stored(raw, slope, offset, shift):
    blocks = BYTE, method("CM", "LINEAR", f"COEFFS_LINEAR {slope!r} {offset!r}")
    text = module(*blocks, label("VAL_BLK", f"NUMBER {len(raw)}", conversion="CM"))
    wanted = slope * (np.clip(np.array(raw) + shift, 0, 255)) + offset

    def change(original):
        return original.with_parameters(original["L"].with_values(wanted))

    image, _ = write(text, bytes(len(raw)), change)
    assert list(image.read(0x1000, len(raw))) == raw
