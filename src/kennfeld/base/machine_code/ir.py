"""Writer of LLVM IR text: functions, loops, branches, and arithmetic on vectors of doubles.

The emitters read like the code they emit.
"""

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import reduce

DOUBLE = "double"
LANES = 8
EIGHT = f"<{LANES} x double>"

EXPONENTIAL = tuple(1 / math.factorial(i) for i in range(13))  # to 2e-16 for |r| <= ln(2) / 2
LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")  # the leading bits of ln(2), so that whole multiples are exact
LN2_LOW = 1.9082149292705877e-10  # the rest
ROUNDER = 1.5 * 2.0**52  # adding it rounds to an integer, held in the last bits
ONES = 1023 << 52  # the bits of 1.0


def literal(value: float) -> str:
    """Return a double as LLVM writes it, bit for bit.

    >>> literal(1.0)
    '0x3FF0000000000000'
    """
    return f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"


ZERO, HALF, ONE = literal(0.0), literal(0.5), literal(1.0)


def integer_table(name: str, numbers: Sequence[int]) -> str:
    """Return an i32 array as a constant of a module."""
    entries = ", ".join(f"i32 {number}" for number in numbers)
    return f"@{name} = internal constant [{len(numbers)} x i32] [{entries}]\n"


class FunctionWriter:
    """Text of one function under construction.

    `internal` is empty for a function that is called from outside, else an attribute for LLVM: `noinline`, ... Loop
    counters and other variables live in stack slots of the entry block; LLVM turns them into registers. Registers are
    numbered in the order of the text, not named, because LLVM parses them a third faster. `before` is text that
    precedes the function: its tables and helpers.
    """

    def __init__(self, name: str, parameters: Sequence[tuple[str, str]], internal: str = "", before: str = "") -> None:
        self.name = name
        self.parameters = tuple(parameters)
        self.internal, self.before = internal, before
        self.slots: list[str] = []
        self.lines: list[str] = []
        self.registers = 0
        self.labels = 0

    def new(self, expression: str) -> str:
        """Return a register that holds `expression`."""
        register = f"%{self.registers}"
        self.registers += 1
        self.lines.append(f"  {register} = {expression}")
        return register

    def do(self, statement: str) -> None:
        """Add a statement without a result."""
        self.lines.append("  " + statement)

    def slot(self, kind: str, count: int = 1) -> str:
        """Allocate `count` values of a type on the stack."""
        name = f"%slot{len(self.slots)}"
        self.slots.append(f"  {name} = alloca [{count} x {kind}], align 32")
        return name

    def variable(self, kind: str, value: str) -> "StackVariable":
        """Allocate a variable on the stack, and set it."""
        result = StackVariable(self, kind, self.slot(kind))
        result.set(value)
        return result

    def at(self, pointer: str, index: str | int, kind: str = DOUBLE) -> str:
        """Return the address of element `index`."""
        return pointer if index in (0, "0") else self.new(f"getelementptr inbounds {kind}, ptr {pointer}, i64 {index}")

    def load(self, pointer: str, index: str | int = 0, kind: str = DOUBLE) -> str:
        """Return element `index` of an array."""
        return self.new(f"load {kind}, ptr {self.at(pointer, index, kind)}, align {_alignment(kind)}")

    def load_index(self, pointer: str, index: str | int = 0) -> str:
        """Return element `index` of an i32 array as an i64."""
        return self.new(f"sext i32 {self.load(pointer, index, 'i32')} to i64")

    def store(self, value: str, pointer: str, index: str | int = 0, kind: str = DOUBLE) -> None:
        """Write element `index` of an array."""
        self.do(f"store {kind} {value}, ptr {self.at(pointer, index, kind)}, align {_alignment(kind)}")

    def add(self, a: str, b: str | int) -> str:
        """Return the sum of two integers."""
        return a if b in (0, "0") else self.new(f"add i64 {a}, {b}")

    def mul(self, a: str, b: str | int) -> str:
        """Return the product of two integers."""
        return a if b in (1, "1") else self.new(f"mul i64 {a}, {b}")

    def fadd(self, a: str, b: str) -> str:
        """Return the sum of two doubles; may be contracted and reordered, for reductions."""
        return self.new(f"fadd contract reassoc nsz double {a}, {b}")

    def fmul(self, a: str, b: str) -> str:
        """Return the product of two doubles."""
        return self.new(f"fmul contract double {a}, {b}")

    def sum(self, terms: Sequence[str]) -> str:
        """Return the sum of doubles; 0 if there are none."""
        return reduce(self.fadd, terms) if terms else ZERO

    def dot(self, pairs: Sequence[tuple[str, str]]) -> str:
        """Return the sum of products; 0 if there are none."""
        return self.sum([self.fmul(a, b) for a, b in pairs])

    def extreme(self, which: str, a: str, b: str | int) -> str:
        """Return the `smin` or `smax` of two integers."""
        return self.new(f"call i64 @llvm.{which}.i64(i64 {a}, i64 {b})")

    def increase(self, by: str, pointer: str, index: str | int = 0) -> None:
        """Add a double to element `index` of an array."""
        place = self.at(pointer, index)
        self.store(self.fadd(self.load(place), by), place)

    def advance(self, rings: str, number: str | int, latency: str | int) -> None:
        """Advance the position of a ring buffer, or start again at 0."""
        following = self.add(self.load(rings, number, "i64"), 1)
        wrapped = self.new(f"icmp eq i64 {following}, {latency}")
        self.store(self.new(f"select i1 {wrapped}, i64 0, i64 {following}"), rings, number, "i64")

    def select(self, condition: str, a: str, b: str) -> str:
        """Return one of two doubles."""
        return self.new(f"select i1 {condition}, double {a}, double {b}")

    def label(self, name: str) -> str:
        """Return a new label."""
        self.labels += 1
        return f"{name}{self.labels}"

    def begin(self, label: str) -> None:
        """Start the block `label`."""
        self.lines.append(f"{label}:")

    @contextmanager
    def loop(self, start: str | int, end: str | int) -> Iterator[str]:
        """Run the body for each index from `start` to before `end`."""
        with self.walk(end, start) as (index, position):
            yield index
            position.set(self.add(index, 1))

    @contextmanager
    def walk(self, end: str | int, start: str | int = 0) -> Iterator[tuple[str, "StackVariable"]]:
        """Run the body for indices from `start` to before `end`; the body advances by setting the second value."""
        head, body, done = self.label("head"), self.label("body"), self.label("done")
        position = self.variable("i64", str(start))
        self.do(f"br label %{head}")
        self.begin(head)
        index = position.get()
        self.do(f"br i1 {self.new(f'icmp slt i64 {index}, {end}')}, label %{body}, label %{done}")
        self.begin(body)
        yield index, position
        self.do(f"br label %{head}")
        self.begin(done)

    @contextmanager
    def when(self, condition: str) -> Iterator[None]:
        """Run the body if an i1 is true."""
        body, done = self.label("then"), self.label("end")
        self.do(f"br i1 {condition}, label %{body}, label %{done}")
        self.begin(body)
        yield
        self.do(f"br label %{done}")
        self.begin(done)

    @contextmanager
    def unless(self, *conditions: str) -> Iterator[None]:
        """Run the body if one of these i1 is false."""
        body, done = self.label("else"), self.label("end")
        for condition in conditions[:-1]:
            following = self.label("and")
            self.do(f"br i1 {condition}, label %{following}, label %{body}")
            self.begin(following)
        self.do(f"br i1 {conditions[-1]}, label %{done}, label %{body}")
        self.begin(body)
        yield
        self.do(f"br label %{done}")
        self.begin(done)

    def call(self, name: str, arguments: Sequence[tuple[str, str]]) -> None:
        """Call a function of this module with (type, value) arguments."""
        self.do(f"call void @{name}({', '.join(f'{kind} {value}' for kind, value in arguments)})")

    def text(self) -> str:
        """Return the finished function, after the text before it."""
        head = ", ".join(f"{kind} %{name}" for kind, name in self.parameters)
        linkage = "internal " if self.internal else ""
        # slots in the first block are allocated once, even those of a loop
        body = "\n".join(["stack:", *self.slots, "  br label %entry", "entry:", *self.lines])
        return f"{self.before}define {linkage}void @{self.name}({head}) {self.internal} {{\n{body}\n  ret void\n}}\n"


def _alignment(kind: str) -> int:
    return {"i8": 1, "i16": 2, "i32": 4, "float": 4}.get(kind, 8)


class StackVariable:
    """A variable of a function in its stack frame."""

    def __init__(self, f: FunctionWriter, kind: str, pointer: str) -> None:
        self.f, self.kind, self.pointer = f, kind, pointer

    def get(self) -> str:
        return self.f.load(self.pointer, kind=self.kind)

    def set(self, value: str) -> None:
        self.f.store(value, self.pointer, kind=self.kind)


class Vector:
    """Arithmetic on vectors of doubles, by default of eight."""

    def __init__(self, f: FunctionWriter, lanes: int = LANES) -> None:
        self.f, self.lanes, self.kind = f, lanes, f"<{lanes} x double>"

    def __call__(self, instruction: str, a: str, b: str) -> str:
        return self.f.new(f"{instruction} contract {self.kind} {a}, {b}")

    def load(self, pointer: str, index: str | int = 0) -> str:
        """Return the vector that begins at element `index` of an array of doubles."""
        return self.f.load(self.f.at(pointer, index), kind=self.kind)

    def store(self, value: str, pointer: str, index: str | int = 0) -> None:
        """Write the vector that begins at element `index` of an array of doubles."""
        self.f.store(value, self.f.at(pointer, index), kind=self.kind)

    def splat(self, value: str) -> str:
        """Return a vector with the same double in all lanes."""
        single = self.f.new(f"insertelement {self.kind} poison, double {value}, i64 0")
        zeros = f"<{self.lanes} x i32> zeroinitializer"
        return self.f.new(f"shufflevector {self.kind} {single}, {self.kind} poison, {zeros}")

    def lane(self, vector: str, number: int) -> str:
        """Return the double in one lane."""
        return self.f.new(f"extractelement {self.kind} {vector}, i64 {number}")

    def multiply(self, vector: str, number: str) -> str:
        """Return the product of a vector with a double."""
        return self("fmul", vector, self.splat(number))

    def reduce(self, start: str, vector: str) -> str:
        """Return a double plus the sum of all lanes."""
        # `reassoc`: the lanes may be added pairwise instead of one after the other
        return self.f.new(f"call reassoc double @llvm.vector.reduce.fadd.v8f64(double {start}, {self.kind} {vector})")

    def all(self, value: float) -> str:
        """Return a vector with a constant in all lanes."""
        return f"<{', '.join([f'double {literal(value)}'] * self.lanes)}>"

    def where(self, condition: str, a: str, b: str) -> str:
        """Select one of two values in each lane."""
        return self.f.new(f"select <{self.lanes} x i1> {condition}, {self.kind} {a}, {self.kind} {b}")

    def compare(self, how: str, a: str, b: float) -> str:
        """Return a condition for each lane."""
        return self.f.new(f"fcmp {how} {self.kind} {a}, {self.all(b)}")

    def polynomial(self, x: str, coefficients: Sequence[float]) -> str:
        """Evaluate a polynomial by Horner's rule; the constant coefficient comes first."""
        total = self.all(coefficients[-1])
        for coefficient in reversed(coefficients[:-1]):
            total = self("fadd", self("fmul", total, x), self.all(coefficient))
        return total

    def exp(self, x: str) -> str:
        """Compute e^x for -700 < x <= 0 within 2 ulp: 2^n e^r with integer n and |r| <= ln(2) / 2."""
        rest, power = self._powers(x)
        return self("fmul", self.polynomial(rest, EXPONENTIAL), power)

    def expm1(self, x: str) -> str:
        """Compute e^x - 1 for -700 < x <= 0, accurate near 0 as well: 2^n (e^r - 1) + 2^n - 1."""
        rest, power = self._powers(x)
        grown = self("fmul", rest, self.polynomial(rest, EXPONENTIAL[1:]))
        return self("fadd", self("fmul", power, grown), self("fsub", power, self.all(1.0)))

    def _powers(self, x: str) -> tuple[str, str]:
        """Return r and 2^n for x = n ln(2) + r with integer n and |r| <= ln(2) / 2."""
        f, whole = self.f, f"<{self.lanes} x i64>"
        scaled = self("fmul", x, self.all(1 / math.log(2)))
        shifted = f.new(f"fadd {self.kind} {scaled}, {self.all(ROUNDER)}")
        number = f.new(f"fsub {self.kind} {shifted}, {self.all(ROUNDER)}")
        # Cody and Waite: n * the high part of ln(2) is exact, so that the rest keeps its digits
        rest = self("fsub", x, self("fmul", number, self.all(LN2_HIGH)))
        rest = self("fsub", rest, self("fmul", number, self.all(LN2_LOW)))
        # the last bits of the shifted number are the integer, which is added to the exponent of 1.0
        bits = f.new(f"bitcast {self.kind} {shifted} to {whole}")
        high = f.new(f"shl {whole} {bits}, <{', '.join(['i64 52'] * self.lanes)}>")
        power = f.new(f"add {whole} {high}, <{', '.join([f'i64 {ONES}'] * self.lanes)}>")
        return rest, f.new(f"bitcast {whole} {power} to {self.kind}")
