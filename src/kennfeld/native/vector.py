"""Arithmetic on eight doubles at once, in LLVM IR."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from kennfeld.native.ir import EIGHT, LANES, Function, literal

__all__ = ["Vector"]

EXPONENTIAL = tuple(1 / math.factorial(i) for i in range(13))  # to 2e-16 for |r| <= ln(2) / 2
LN2_HIGH = float.fromhex("0x1.62e42fee00000p-1")  # the leading bits of ln(2), so that whole multiples are exact
LN2_LOW = 1.9082149292705877e-10  # the rest
ROUNDER = 1.5 * 2.0**52  # adding it rounds to a whole number, which then stands in the last bits
ONES = 1023 << 52  # the bits of 1.0


@dataclass(frozen=True)
class Vector:
    """Arithmetic on eight doubles at once."""

    f: Function

    def __call__(self, instruction: str, a: str, b: str) -> str:
        return self.f.new(f"{instruction} contract {EIGHT} {a}, {b}")

    def all(self, value: float) -> str:
        """Eight times a constant."""
        return f"<{', '.join([f'double {literal(value)}'] * LANES)}>"

    def where(self, condition: str, a: str, b: str) -> str:
        """One of two in each lane."""
        return self.f.new(f"select <{LANES} x i1> {condition}, {EIGHT} {a}, {EIGHT} {b}")

    def compare(self, how: str, a: str, b: float) -> str:
        """A condition a lane."""
        return self.f.new(f"fcmp {how} {EIGHT} {a}, {self.all(b)}")

    def polynomial(self, x: str, coefficients: Sequence[float]) -> str:
        """By Horner's rule; the constant term comes first."""
        total = self.all(coefficients[-1])
        for coefficient in reversed(coefficients[:-1]):
            total = self("fadd", self("fmul", total, x), self.all(coefficient))
        return total

    def exp(self, x: str) -> str:
        """e^x for -700 < x <= 0, within 2 ulp: 2^n e^r with n whole and |r| <= ln(2) / 2."""
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
