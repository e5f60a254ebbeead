"""The compiled parser of numbers, against Python's `float`."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kennfeld.measurement.number_code import ODD_FIELDS, PADDING, compile_parser, powers_of_ten
from tests.draws import few_or_many

EXACT_TIES = ["9007199254740993", "9007199254740992.5", "1.5e-5", "4503599627370497.5", "18014398509481986"]


def parse(cells, decimal=".", capacity=None):
    """Return the numbers of a column and the rows of unusual cells; None if the rows have another form."""
    text = "".join(f"{cell}\n" for cell in cells).encode()
    data = np.frombuffer(text + bytes(PADDING), np.uint8)
    values = np.empty(len(cells))
    addresses = np.array([values.ctypes.data])
    capacity = len(cells) if capacity is None else capacity
    odd, state = np.empty((len(cells) + 1, ODD_FIELDS), dtype=np.int64), np.empty(1, dtype=np.int64)
    powers = powers_of_ten()
    compile_parser()(
        *(data.ctypes.data, len(text), addresses.ctypes.data, 1, ord(";"), ord(decimal)),
        *(odd.ctypes.data, capacity, powers.ctypes.data, state.ctypes.data),
    )
    return None if state[0] < 0 else (values, odd[: state[0], 0].tolist())


def assert_as_python(cells):
    values, odd = parse(cells)
    for row, cell in enumerate(cells):
        assert row in odd or values[row].hex() == float(cell).hex(), cell
    return odd


DIGITS = st.text("0123456789", min_size=1, max_size=25)
NUMBERS = st.builds(
    lambda sign, whole, part, exponent: f"{sign}{whole}{part}{exponent}",
    st.sampled_from(["", "-", "+"]),
    DIGITS,
    st.one_of(st.just(""), DIGITS.map(lambda digits: f".{digits}")),
    st.one_of(st.just(""), st.integers(-400, 400).map(lambda power: f"e{power}")),
)


@few_or_many(st.lists(NUMBERS, min_size=1, max_size=50), few=20, many=300)
def test_numbers_are_as_python_reads_them(cells):
    assert_as_python(cells)


@few_or_many(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=50), few=20, many=100)
def test_doubles_that_python_writes_are_read(numbers):
    odd = assert_as_python([repr(number) for number in numbers])
    fractions = [row for row, number in enumerate(numbers) if 1e-300 < abs(number) < 1e15 and number % 1]
    assert not set(fractions) & set(odd)


@given(st.integers(2**52, 2**53 - 1), st.integers(-300, 250), st.integers(-1, 1))
def test_numbers_near_the_middle_of_two_doubles_are_rounded_to_the_nearest(mantissa, power, distance):
    number = (2 * mantissa + 1) * 10**20 + distance  # its leading 19 digits are those of a tie, or nearly
    assert_as_python([f"{str(number)[:19]}e{power}", str(2 * mantissa + 1), f"{mantissa}.5"])


@pytest.mark.parametrize("cell", EXACT_TIES)
def test_ties_are_rounded_to_even(cell):
    assert_as_python([cell])


def test_powers_of_ten_are_rounded_down():
    halves = powers_of_ten().view(np.uint64).tolist()
    for exponent, low, high in zip(range(-342, 309), halves[::2], halves[1::2], strict=True):
        bits = high << 64 | low
        assert bits >> 127 == 1
        numerator, denominator = 10 ** max(exponent, 0), 10 ** max(-exponent, 0)
        shift = numerator.bit_length() - denominator.bit_length() - 128
        numerator, denominator = numerator << max(-shift, 0), denominator << max(shift, 0)
        quotient = numerator // denominator  # 128 or 129 bits
        assert bits == quotient >> (quotient.bit_length() - 128)


@pytest.mark.parametrize(
    "cell", ["-", ".", "+", "1e", "1e+", "e5", "--1", "1_0", "0x10", "1 ", " 1", "inf", "na", "1.2.3"]
)
def test_other_cells_are_odd(cell):
    assert parse(["1", cell, "2"])[1] == [1]


@pytest.mark.parametrize("cell", ["", "nan", "NaN", "NAN"])
def test_gaps_are_not_a_number(cell):
    values, odd = parse(["1", cell, "2"])
    assert np.isnan(values).tolist() == [False, True, False]
    assert not odd


@pytest.mark.parametrize("sign", ["", "-", "+"])
def test_leading_zeros_do_not_count_as_digits(sign):
    cells = [f"{sign}0.00011003800164834364", f"{sign}000000000000000000000012345.678", f"{sign}.{'0' * 40}1234567e10"]
    assert not assert_as_python(cells)
    assert parse([cell.replace(".", ",") for cell in cells], ",")[0].tolist() == [float(cell) for cell in cells]


def test_a_decimal_comma_is_read():
    assert parse(["1,5", "-,25", "2,", "3,5e2"], ",")[0].tolist() == [1.5, -0.25, 2.0, 350.0]
    assert parse(["1.5"], ",")[1] == [0]


@pytest.mark.parametrize("cell", ["1;2", '"1"', "1\r2"])
def test_a_row_of_another_form_is_not_parsed(cell):
    assert parse(["1", cell, "2"]) is None


def test_more_odd_cells_than_there_is_room_for_are_not_parsed():
    assert parse(["-", "1", "-"], capacity=2)[1] == [0, 2]
    assert parse(["-", "1", "-"], capacity=1) is None
