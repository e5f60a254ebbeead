"""Generated code that reads a tape of linearised steps, and sums over its doubles.

Doubles that are structurally zero are not read: they are the text `ZERO`, and products with them are left out.
"""

from collections.abc import Collection, Sequence
from contextlib import AbstractContextManager

from kennfeld.base.machine_code.ir import ZERO, FunctionWriter

VECTOR = 8  # rows of S are padded to a multiple of this; what goes over the end of a matrix row adds zeros
ENTRIES = (("ptr", "index"), ("ptr", "slope"), ("ptr", "count"), ("i64", "room"))
SUMS = (("ptr", "matrix"), ("i64", "columns"), ("ptr", "gradient"))  # columns from one row of the matrix to the next

Rows = list[str]


def load_row(f: FunctionWriter, array: str, k: str, size: int, present: Collection[int] | None = None) -> Rows:
    """Return the `size` doubles of sample k, with zero for those not `present`."""
    base = f.mul(k, size)
    return [f.load(array, f.add(base, i)) if present is None or i in present else ZERO for i in range(size)]


def dot(f: FunctionWriter, a: Sequence[str], b: Sequence[str]) -> str:
    """Return the sum of products of doubles of which some are structurally zero."""
    return f.dot([(x, y) for x, y in zip(a, b, strict=True) if ZERO not in (x, y)])


def times(f: FunctionWriter, a: str, b: str) -> str:
    """Return the product of two doubles of which one may be structurally zero."""
    return ZERO if ZERO in (a, b) else f.fmul(a, b)


def whole_width(f: FunctionWriter) -> str:
    """Return the width of S as a multiple of whole vectors, so that LLVM adds no remainder loop."""
    return f.new(f"and i64 %width, -{VECTOR}")


def reaching(f: FunctionWriter, column: str) -> AbstractContextManager[None]:
    """Run the body if a column can reach a state; S has no other columns."""
    return f.when(f.new(f"icmp slt i64 {column}, %width"))


class TapeEntries:
    """The entries of sample k, each with `width` slopes: a column of D [outputs], then of B [states]."""

    def __init__(self, f: FunctionWriter, k: str, width: int) -> None:
        self._f, self._width = f, width
        self.count = f.load_index("%count", k)
        self._start = f.mul(k, "%room")

    def column(self, e: str) -> str:
        """Return the column of entry e in the matrices over free values."""
        return self._f.load_index("%index", self._f.add(self._start, e))

    def slopes(self, e: str) -> str:
        """Return the address of the slopes of entry e."""
        return self._f.at("%slope", self._f.mul(self._f.add(self._start, e), self._width))

    def read(self, e: str) -> tuple[str, Rows]:
        """Return the column and all slopes of entry e."""
        slopes = self.slopes(e)
        return self.column(e), [self._f.load(slopes, i) for i in range(self._width)]
