"""LLVM IR of a parser of delimited decimal numbers; each result is the nearest double.

Digits are read eight at a time, as in simdjson, which requires a little-endian processor. Up to 15 digits with a power
of ten up to 22 take one exact operation (Clinger, How to Read Floating Point Numbers Accurately, 1990). Other numbers
are multiplied by 128 bits of the power (Eisel and Lemire; Lemire, Number Parsing at a Gigabyte per Second, 2021).
"""

from functools import cache

import numpy as np

from kennfeld.base.arrays import Int
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import ZERO, FunctionWriter, StackVariable, literal

PADDING = 64  # bytes behind the text that the parser may load
ODD_FIELDS = 4  # row, column, begin, end

_MAX_DIGITS = 19  # of an integer of 64 bits
_EXACT_TENS = 22  # powers of ten that are doubles
_LEAST, _MOST = -342, 308  # powers of ten of normal doubles with 19 digits
_EVERY = 0x0101010101010101
_NAN = int.from_bytes(b"nan", "little")
_NOWHERE = 1 << 62  # behind every text

_TABLES = f"""
declare i64 @llvm.cttz.i64(i64, i1)
declare i64 @llvm.ctlz.i64(i64, i1)
@shifts = internal constant [9 x i64] [{", ".join(f"i64 {10**k}" for k in range(9))}]
@tens = internal constant [{_EXACT_TENS + 1} x double] [{
    ", ".join(f"double {literal(10.0**k)}" for k in range(_EXACT_TENS + 1))
}]
"""


@cache
def compile_parser() -> NativeFunction:
    """Return the compiled parser of rows.

    Its arguments: the text, which ends with a line feed and is followed by `PADDING` bytes; its length; for each column
    the address of its values (0: skip the column); the number of columns; separator and decimal mark; a table of
    `ODD_FIELDS` integers for each cell that is not a plain number; its capacity; the powers of ten; the state, which
    receives the number of odd cells, or -1 if the text is not a table of so many columns or there are more odd cells.
    """
    return compile_functions(_write_rows(), loops=True)["parse_rows"]


@cache
def powers_of_ten() -> Int:
    """Compute the leading 128 bits of 10^-342 ... 10^308, rounded down: Int[651 * 2], 64 low and 64 high bits each."""
    halves = []
    for exponent in range(_LEAST, _MOST + 1):
        power = 10 ** abs(exponent)
        length = power.bit_length()
        if exponent < 0:
            # 128 bits, as 2^(length - 1) < 10^k < 2^length
            bits = (1 << (length + 127)) // power
            bits >>= bits.bit_length() - 128
        else:
            bits = power << 128 >> length
        halves += [bits & (2**64 - 1), bits >> 64]
    return np.array(halves, dtype=np.uint64).view(np.int64)


def _write_rows() -> FunctionWriter:
    parameters = [
        *(("ptr", "text"), ("i64", "length"), ("ptr", "columns"), ("i64", "width"), ("i64", "separator")),
        *(("i64", "decimal"), ("ptr", "odd"), ("i64", "capacity"), ("ptr", "powers"), ("ptr", "state")),
    ]
    f = FunctionWriter("parse_rows", parameters, before=_TABLES + _write_rounding().text())
    last = f.add("%width", -1)
    row, odd = f.variable("i64", "0"), f.variable("i64", "0")
    with f.walk("%length") as (_, position):
        with f.walk("%width") as (column, following):
            following.set(f.add(column, 1))
            is_last = f.new(f"icmp eq i64 {column}, {last}")
            terminator = f.new(f"select i1 {is_last}, i64 10, i64 %separator")
            cell = _Cell(f, position, terminator, is_last)
            values = f.load("%columns", column, "ptr")
            wanted = f.new(f"icmp ne ptr {values}, null")
            with f.when(wanted):
                cell.parse()
                f.store(cell.value.get(), values, row.get())
            # cells of columns that are not wanted are skipped, too; of others, the caller gets the place
            with f.unless(cell.complete.get()):
                cell.skip()
                with f.when(wanted):
                    cell.note(odd, row.get(), column)
            # a cell that is still incomplete ends both loops
            with f.unless(cell.complete.get()):
                odd.set("-1")
                following.set("%width")
                position.set(str(_NOWHERE))
        row.set(f.add(row.get(), 1))
    f.store(odd.get(), "%state", kind="i64")
    return f


def _write_rounding() -> FunctionWriter:
    """Write the function that rounds number * 10^scale, or leaves NaN if 128 bits of the power do not decide."""
    parameters = [("i64", "number"), ("i64", "scale"), ("ptr", "powers"), ("ptr", "value")]
    f = FunctionWriter("round_decimal", parameters, "noinline")
    f.store(literal(float("nan")), "%value")
    entry = f.add("%scale", -_LEAST)
    has_power = f.new(f"icmp ult i64 {entry}, {_MOST - _LEAST + 1}")
    with f.when(_and(f, has_power, f.new("icmp ne i64 %number, 0"))):
        # w = number << zeros; high, low = w * the upper half of the power, which is less than w too small
        zeros = f.new("call i64 @llvm.ctlz.i64(i64 %number, i1 false)")
        number = f.new(f"shl i64 %number, {zeros}")
        low, high = _multiply(f, number, f.load("%powers", f.add(f.mul(entry, 2), 1), "i64"))
        low_product, high_product = f.variable("i64", low), f.variable("i64", high)
        decided = f.variable("i1", "true")
        # the missing part matters only if low + w may carry into ones that lead up to the mantissa
        with f.when(_and(f, _ends_in_ones(f, high), f.new(f"icmp ult i64 {f.add(low, number)}, {number}"))):
            rest, more = _multiply(f, number, f.load("%powers", f.mul(entry, 2), "i64"))
            low = f.add(low, more)
            carry = f.new(f"zext i1 {f.new(f'icmp ult i64 {low}, {more}')} to i64")
            high = f.add(high, carry)
            low_product.set(low)
            high_product.set(high)
            # the power is rounded down, too: if its rest may carry through all bits, nothing is decided
            unknown = _and(f, _ends_in_ones(f, high), f.new(f"icmp eq i64 {low}, -1"))
            unknown = _and(f, unknown, f.new(f"icmp ult i64 {f.add(rest, number)}, {number}"))
            decided.set(f.new(f"xor i1 {unknown}, true"))
        low, high = low_product.get(), high_product.get()
        # the product has 128 or 127 bits, of which the first 54 are the mantissa and a bit to round
        top = f.new(f"lshr i64 {high}, 63")
        mantissa = f.new(f"lshr i64 {high}, {f.add(top, 9)}")  # 54 bits
        # a tie, or what looks like one as the product is truncated, is left to the caller
        half = _and(f, f.new(f"icmp eq i64 {low}, 0"), f.new(f"icmp eq i64 {f.new(f'and i64 {high}, 511')}, 0"))
        half = _and(f, half, f.new(f"icmp eq i64 {f.new(f'and i64 {mantissa}, 3')}, 1"))
        # half up, as ties are excluded
        mantissa = f.add(mantissa, f.new(f"and i64 {mantissa}, 1"))
        # the exponent of the leading bit, plus the bias; an overflow of the mantissa adds to it
        # 217706 / 2^16 is so close to log2(10) that the floor is exact from 10^-342 to 10^308
        power = f.new(f"ashr i64 {f.mul('%scale', 217706)}, 16")
        exponent = f.new(f"sub i64 {f.add(f.add(power, 64 + 1023 - 1), top)}, {zeros}")
        bits = f.add(f.new(f"lshr i64 {mantissa}, 1"), f.new(f"shl i64 {f.add(exponent, -1)}, 52"))
        exponent = f.new(f"ashr i64 {bits}, 52")
        # subnormal and infinite results are left to the caller
        normal = f.new(f"icmp ult i64 {f.add(exponent, -1)}, {0x7FF - 1}")
        valid = _and(f, _and(f, decided.get(), normal), f.new(f"xor i1 {half}, true"))
        with f.when(valid):
            f.store(f.new(f"bitcast i64 {bits} to double"), "%value")
    return f


def _multiply(f: FunctionWriter, a: str, b: str) -> tuple[str, str]:
    """Return the low and the high 64 bits of a product."""
    factors = [f.new(f"zext i64 {number} to i128") for number in (a, b)]
    product = f.new(f"mul i128 {', '.join(factors)}")
    high = f.new(f"lshr i128 {product}, 64")
    return f.new(f"trunc i128 {product} to i64"), f.new(f"trunc i128 {high} to i64")


def _ends_in_ones(f: FunctionWriter, high: str) -> str:
    """Return whether the bits beyond the mantissa are ones, so that a carry changes it."""
    return f.new(f"icmp eq i64 {f.new(f'and i64 {high}, 511')}, 511")


def _and(f: FunctionWriter, a: str, b: str) -> str:
    return f.new(f"and i1 {a}, {b}")


class _Cell:
    """Code that reads one cell; `position` is then behind its terminator, or anywhere if it is not `complete`."""

    def __init__(self, f: FunctionWriter, position: StackVariable, terminator: str, is_last: str) -> None:
        self.f, self.position, self.terminator, self.is_last = f, position, terminator, is_last
        self.begin = position.get()
        self.complete = f.variable("i1", "false")
        self.value = f.variable("double", literal(float("nan")))
        self.number, self.count, self.scale = (f.variable("i64", "0") for _ in range(3))

    def parse(self) -> None:
        """Read the cell as a number or a gap."""
        f, first = self.f, self._byte()
        minus, plus = self._is(first, "-"), self._is(first, "+")
        self._advance_if(f.new(f"or i1 {minus}, {plus}"))
        self._digits()
        with f.when(f.new(f"icmp eq i64 {self._byte()}, %decimal")):
            self._advance(1)
            before = self.count.get()
            self._digits()
            self.scale.set(f.new(f"sub i64 {before}, {self.count.get()}"))
        with f.when(self._is(f.new(f"or i64 {self._byte()}, 32"), "e")):
            self._exponent()
        with f.when(f.new(f"icmp ugt i64 {self.count.get()}, {_MAX_DIGITS}")):
            self._discount_zeros()
        count = self.count.get()
        with f.when(f.new(f"icmp eq i64 {count}, 0")):
            self._gap()
        with f.when(f.new(f"icmp ult i64 {f.add(count, -1)}, {_MAX_DIGITS}")):
            self._round(minus)
            self._finish()
            rounded = f.new(f"fcmp ord double {self.value.get()}, {ZERO}")
            self.complete.set(f.new(f"and i1 {self.complete.get()}, {rounded}"))

    def skip(self) -> None:
        """Go on to the end of the cell; quotes and line ends within a row leave it incomplete."""
        f, position = self.f, self.position
        position.set(self.begin)
        head, body, done = f.label("skip"), f.label("next"), f.label("stop")
        f.do(f"br label %{head}")
        f.begin(head)
        byte = self._byte()
        stops = [self._is(byte, stop) for stop in '\n\r"']
        stop = f.new(f"icmp eq i64 {byte}, %separator")
        for other in stops:
            stop = f.new(f"or i1 {stop}, {other}")
        f.do(f"br i1 {stop}, label %{done}, label %{body}")
        f.begin(body)
        self._advance(1)
        f.do(f"br label %{head}")
        f.begin(done)
        self.end = position.get()
        self._finish()

    def note(self, odd: StackVariable, row: str, column: str) -> None:
        """Store where the cell is; without room it is incomplete."""
        f, number = self.f, odd.get()
        room = f.new(f"icmp slt i64 {number}, %capacity")
        self.complete.set(f.new(f"and i1 {self.complete.get()}, {room}"))
        with f.when(room):
            place = f.at("%odd", f.mul(number, ODD_FIELDS), "i64")
            for field, value in enumerate((row, column, self.begin, self.end)):
                f.store(value, place, field, "i64")
            odd.set(f.add(number, 1))

    def _digits(self) -> None:
        """Append a run of digits to the number."""
        f = self.f
        head, done = f.label("digits"), f.label("end")
        f.do(f"br label %{head}")
        f.begin(head)
        # digits become 0 to 9; 0x76 lifts all other bytes to 128 or more, and a carry reaches only bytes behind the
        # first of them, which the count of trailing zeros finds
        word = f.new(f"xor i64 {self._load('i64')}, {0x30 * _EVERY}")
        flags = f.new(f"or i64 {f.add(word, 0x76 * _EVERY)}, {word}")  # the high bit of all that are not digits
        flags = f.new(f"and i64 {flags}, {_signed(0x80 * _EVERY)}")
        count = f.new(f"lshr i64 {f.new(f'call i64 @llvm.cttz.i64(i64 {flags}, i1 false)')}, 3")
        half = f.new(f"sub i64 32, {f.mul(count, 4)}")  # a shift by 64 bits is undefined
        word = f.new(f"shl i64 {f.new(f'shl i64 {word}, {half}')}, {half}")  # zeros before the digits
        # each step joins neighbours: earlier * 10 + later, then times 100, then times 10000 (simdjson)
        for mask, factor, bits in (
            (0x0F0F0F0F0F0F0F0F, 10 * 2**8 + 1, 8),
            (0x00FF00FF00FF00FF, 100 * 2**16 + 1, 16),
            (0x0000FFFF0000FFFF, 10000 * 2**32 + 1, 32),
        ):
            word = f.new(f"lshr i64 {f.mul(f.new(f'and i64 {word}, {mask}'), factor)}, {bits}")
        shifted = f.mul(self.number.get(), f.load("@shifts", count, "i64"))
        self.number.set(f.add(shifted, word))
        self.count.set(f.add(self.count.get(), count))
        self._advance(count)
        f.do(f"br i1 {f.new(f'icmp eq i64 {count}, 8')}, label %{head}, label %{done}")
        f.begin(done)

    def _discount_zeros(self) -> None:
        """Leave leading zeros out of the number of digits."""
        f = self.f
        first = self._load("i8", self.begin)
        signed = f.new(f"icmp ult i8 {first}, {ord('.')}")  # + or -, or a decimal comma
        place = f.variable("i64", f.add(self.begin, f.new(f"zext i1 {signed} to i64")))
        head, body, done = f.label("zeros"), f.label("zero"), f.label("digit")
        f.do(f"br label %{head}")
        f.begin(head)
        byte = f.new(f"zext i8 {self._load('i8', place.get())} to i64")
        zero, mark = self._is(byte, "0"), f.new(f"icmp eq i64 {byte}, %decimal")
        f.do(f"br i1 {f.new(f'or i1 {zero}, {mark}')}, label %{body}, label %{done}")
        f.begin(body)
        self.count.set(f.new(f"sub i64 {self.count.get()}, {f.new(f'zext i1 {zero} to i64')}"))
        place.set(f.add(place.get(), 1))
        f.do(f"br label %{head}")
        f.begin(done)

    def _exponent(self) -> None:
        """Read the exponent; one without digits, or of more than four, is left to the caller as an odd cell."""
        f = self.f
        number, count = self.number.get(), self.count.get()
        self._advance(1)
        sign = self._byte()
        minus, plus = self._is(sign, "-"), self._is(sign, "+")
        self._advance_if(f.new(f"or i1 {minus}, {plus}"))
        self.number.set("0")
        self.count.set("0")
        self._digits()
        size, digits = self.number.get(), self.count.get()
        exponent = f.new(f"select i1 {minus}, i64 {f.new(f'sub i64 0, {size}')}, i64 {size}")
        self.scale.set(f.add(self.scale.get(), exponent))
        self.number.set(number)
        # a number of digits beyond all limits makes the cell an odd one
        valid = f.new(f"icmp ult i64 {f.add(digits, -1)}, 4")
        self.count.set(f.new(f"select i1 {valid}, i64 {count}, i64 {_NOWHERE}"))

    def _gap(self) -> None:
        """Accept an empty cell and NaN."""
        f = self.f
        word = f.new(f"or i64 {self._load('i64', self.begin)}, {0x202020}")  # lower case
        word = f.new(f"and i64 {word}, {0xFFFFFF}")
        spelt = f.new(f"icmp eq i64 {word}, {_NAN}")
        empty = f.new(f"icmp eq i64 {self.position.get()}, {self.begin}")
        with f.when(f.new(f"or i1 {spelt}, {empty}")):
            self.position.set(f.new(f"select i1 {spelt}, i64 {f.add(self.begin, 3)}, i64 {self.begin}"))
            self._finish()

    def _round(self, minus: str) -> None:
        f, number, scale = self.f, self.number.get(), self.scale.get()
        size = f.extreme("smax", scale, f.new(f"sub i64 0, {scale}"))
        ten = f.load("@tens", f.extreme("smin", size, _EXACT_TENS))
        whole = f.new(f"uitofp i64 {number} to double")
        divided, multiplied = f.new(f"fdiv double {whole}, {ten}"), f.new(f"fmul double {whole}, {ten}")
        self.value.set(f.select(f.new(f"icmp slt i64 {scale}, 0"), divided, multiplied))
        # otherwise the number or the power is not exact, so that the single operation would round twice
        few_digits, small_power = f.new(f"icmp ule i64 {number}, {2**53}"), f.new(f"icmp ule i64 {size}, {_EXACT_TENS}")
        with f.unless(few_digits, small_power):
            f.call("round_decimal", [("i64", number), ("i64", scale), ("ptr", "%powers"), ("ptr", self.value.pointer)])
        value = self.value.get()
        self.value.set(f.select(minus, f.new(f"fneg double {value}"), value))

    def _finish(self) -> None:
        """Step over the terminator, if it follows and there is a value; else the cell is incomplete."""
        f = self.f
        carriage_return = self._is(self._byte(), "\r")
        self._advance_if(f.new(f"and i1 {carriage_return}, {self.is_last}"))
        self.complete.set(f.new(f"icmp eq i64 {self._byte()}, {self.terminator}"))
        self._advance(1)

    def _advance(self, count: str | int) -> None:
        self.position.set(self.f.add(self.position.get(), count))

    def _advance_if(self, condition: str) -> None:
        self._advance(self.f.new(f"zext i1 {condition} to i64"))

    def _byte(self) -> str:
        return self.f.new(f"zext i8 {self._load('i8')} to i64")

    def _is(self, byte: str, character: str) -> str:
        return self.f.new(f"icmp eq i64 {byte}, {ord(character)}")

    def _load(self, kind: str, position: str = "") -> str:
        place = self.f.at("%text", position or self.position.get(), "i8")
        return self.f.new(f"load {kind}, ptr {place}, align 1")


def _signed(bits: int) -> int:
    return bits - 2**64 if bits >> 63 else bits
