"""Writer of LLVM IR text: functions, loops, branches, and arithmetic on vectors of eight doubles.

The emitters read like the code they emit.
"""

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce

DOUBLE = "double"
LANES = 8
EIGHT = f"<{LANES} x double>"

_ALIGN = {"ptr": 8, "double": 8, EIGHT: 8, "i64": 8, "i32": 4}

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


class FunctionWriter:
    """Text of one function under construction.

    `internal` is empty for a function that is called from outside, else an attribute for LLVM: `noinline`, ... Loop
    counters and other variables live in stack slots of the entry block; LLVM turns them into registers. Registers are
    numbered in the order of the text, not named, because LLVM parses them a third faster.
    """

    def __init__(self, name: str, parameters: Sequence[tuple[str, str]], internal: str = "") -> None:
        self.name = name
        self.parameters = tuple(parameters)
        self.internal = internal
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

    def at(self, pointer: str, index: str | int, kind: str = DOUBLE) -> str:
        """Return the address of element `index`."""
        return pointer if index in (0, "0") else self.new(f"getelementptr inbounds {kind}, ptr {pointer}, i64 {index}")

    def load(self, pointer: str, index: str | int = 0, kind: str = DOUBLE) -> str:
        """Return element `index` of an array."""
        return self.new(f"load {kind}, ptr {self.at(pointer, index, kind)}, align {_ALIGN[kind]}")

    def store(self, value: str, pointer: str, index: str | int = 0, kind: str = DOUBLE) -> None:
        """Write element `index` of an array."""
        self.do(f"store {kind} {value}, ptr {self.at(pointer, index, kind)}, align {_ALIGN[kind]}")

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

    def splat(self, value: str) -> str:
        """Return a vector with the same double in all eight lanes."""
        single = self.new(f"insertelement {EIGHT} poison, double {value}, i64 0")
        return self.new(f"shufflevector {EIGHT} {single}, {EIGHT} poison, <8 x i32> zeroinitializer")

    def sum(self, terms: Sequence[str]) -> str:
        """Return the sum of doubles; 0 if there are none."""
        return reduce(self.fadd, terms) if terms else literal(0.0)

    def dot(self, pairs: Sequence[tuple[str, str]]) -> str:
        """Return the sum of products; 0 if there are none."""
        return self.sum([self.fmul(a, b) for a, b in pairs])

    def increase(self, by: str, pointer: str, index: str | int = 0) -> None:
        """Add a double to element `index` of an array."""
        place = self.at(pointer, index)
        self.store(self.fadd(self.load(place), by), place)

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
        counter = self.slot("i64")
        head, body, done = self.label("head"), self.label("body"), self.label("done")
        self.store(str(start), counter, kind="i64")
        self.do(f"br label %{head}")
        self.begin(head)
        index = self.load(counter, kind="i64")
        self.do(f"br i1 {self.new(f'icmp slt i64 {index}, {end}')}, label %{body}, label %{done}")
        self.begin(body)
        yield index
        self.store(self.add(index, 1), counter, kind="i64")
        self.do(f"br label %{head}")
        self.begin(done)

    @contextmanager
    def walk(self, end: str | int) -> Iterator[tuple[str, str]]:
        """Run the body for indices from 0 to before `end`; the body advances by storing to the second value."""
        counter = self.slot("i64")
        head, body, done = self.label("head"), self.label("body"), self.label("done")
        self.store("0", counter, kind="i64")
        self.do(f"br label %{head}")
        self.begin(head)
        index = self.load(counter, kind="i64")
        self.do(f"br i1 {self.new(f'icmp slt i64 {index}, {end}')}, label %{body}, label %{done}")
        self.begin(body)
        yield index, counter
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
        """Return the finished function."""
        head = ", ".join(f"{kind} %{name}" for kind, name in self.parameters)
        linkage = "internal " if self.internal else ""
        body = "\n".join(["stack:", *self.slots, "  br label %entry", "entry:", *self.lines])
        return f"define {linkage}void @{self.name}({head}) {self.internal} {{\n{body}\n  ret void\n}}\n"


@dataclass(frozen=True)
class Vector:
    """Arithmetic on vectors of eight doubles."""

    f: FunctionWriter

    def __call__(self, instruction: str, a: str, b: str) -> str:
        return self.f.new(f"{instruction} contract {EIGHT} {a}, {b}")

    def all(self, value: float) -> str:
        """Return a vector with a constant in all lanes."""
        return f"<{', '.join([f'double {literal(value)}'] * LANES)}>"

    def where(self, condition: str, a: str, b: str) -> str:
        """Select one of two values in each lane."""
        return self.f.new(f"select <{LANES} x i1> {condition}, {EIGHT} {a}, {EIGHT} {b}")

    def compare(self, how: str, a: str, b: float) -> str:
        """Return a condition for each lane."""
        return self.f.new(f"fcmp {how} {EIGHT} {a}, {self.all(b)}")

    def polynomial(self, x: str, coefficients: Sequence[float]) -> str:
        """Evaluate a polynomial by Horner's rule; the constant coefficient comes first."""
        total = self.all(coefficients[-1])
        for coefficient in reversed(coefficients[:-1]):
            total = self("fadd", self("fmul", total, x), self.all(coefficient))
        return total

    def exp(self, x: str) -> str:
        """Compute e^x for -700 < x <= 0 within 2 ulp: 2^n e^r with integer n and |r| <= ln(2) / 2."""
        f, whole = self.f, f"<{LANES} x i64>"
        scaled = self("fmul", x, self.all(1 / math.log(2)))
        shifted = f.new(f"fadd {EIGHT} {scaled}, {self.all(ROUNDER)}")
        number = f.new(f"fsub {EIGHT} {shifted}, {self.all(ROUNDER)}")
        rest = self("fsub", x, self("fmul", number, self.all(LN2_HIGH)))
        rest = self("fsub", rest, self("fmul", number, self.all(LN2_LOW)))
        bits = f.new(f"bitcast {EIGHT} {shifted} to {whole}")
        high = f.new(f"shl {whole} {bits}, <{', '.join(['i64 52'] * LANES)}>")
        power = f.new(f"add {whole} {high}, <{', '.join([f'i64 {ONES}'] * LANES)}>")
        return self("fmul", self.polynomial(rest, EXPONENTIAL), f.new(f"bitcast {whole} {power} to {EIGHT}"))
