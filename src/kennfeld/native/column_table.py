"""Tables of column addresses, through which compiled code reads samples without copying them.

`table[row][block]` is the address of the samples of a block. The table of the inputs has one more row at its head,
whose first entry is the order in which the samples are visited, uint32[samples], or null for the stored order.
"""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import ArgumentError
from kennfeld.base.machine_code.ir import FunctionWriter
from kennfeld.native.addresses import UINT32, address, readable

SHIFT = 12
BLOCK = 1 << SHIFT  # samples
HEAD = 1  # rows of the inputs' table before the first input
AHEAD = 16  # visits, some hundred nanoseconds: as long as memory takes to answer

Addresses = NDArray[np.uintp]
Order = NDArray[np.uint32]
Row = Float | Sequence[Float]  # one array, or several that follow each other


class ColumnTable:
    """Rows of `count` samples each; only blocks in which two arrays of a row meet are copied.

    By default, `count` is that of the first row.

    Raises:
        ArgumentError: a row has more or fewer samples.

    >>> ColumnTable([[np.zeros(5), np.ones(3)]]).take(np.array([4, 5, 7]))
    array([[0., 1., 1.]])
    """

    def __init__(self, rows: Iterable[Row], count: int | None = None) -> None:
        arrays = ([row] if isinstance(row, np.ndarray) else row for row in rows)
        self.parts = [[readable(part) for part in row] for row in arrays]
        self.count = sum(part.size for part in (self.parts or [[]])[0]) if count is None else count
        self._seams: list[tuple[Float, Sequence[Float], Int]] = []
        self.version = 0  # counts `reread`
        blocks = max(-(-self.count // BLOCK), 1)
        self.addresses: Addresses = np.zeros((len(self.parts), blocks), dtype=np.uintp)
        for result, parts in zip(self.addresses, self.parts, strict=True):
            size = sum(part.size for part in parts)
            if size != self.count:
                raise ArgumentError(f"rows differ in length: {self.count} and {size} samples")
            self._locate(result, parts)
        self.reread()

    def _locate(self, addresses: Addresses, parts: Sequence[Float]) -> None:
        """Fill in the addresses of a row; copy the blocks in which two of its parts meet."""
        end, seams = 0, set()
        for part in parts:
            first, end = end, end + part.size
            # blocks that begin and end in this part; the last block of a row may be short
            whole = np.arange(-(-first // BLOCK), addresses.size if end == self.count else end // BLOCK)
            # address of the first sample of a block, counted from the start of the part
            addresses[whole] = address(part) + part.itemsize * (whole * BLOCK - first)
            # a set, as several short parts may meet in one block
            if end % BLOCK and end < self.count:
                seams.add(end // BLOCK)
        for block in seams:
            samples = np.arange(block * BLOCK, min((block + 1) * BLOCK, self.count))
            copied = np.empty(samples.size)
            addresses[block] = address(copied)
            self._seams.append((copied, parts, samples))

    def reread(self) -> None:
        """Update the copied blocks after the arrays were changed in place."""
        self.version += 1
        for copied, parts, samples in self._seams:
            copied[:] = _take(parts, samples)

    def take(self, samples: Int | Order) -> Float:
        """Gather the values at some samples, shape (rows, samples)."""
        return np.array([_take(parts, samples) for parts in self.parts]).reshape(len(self.parts), samples.size)

    def row(self, number: int, samples: Int | Order) -> Float:
        """Gather the values of one row at some samples, shape (samples,)."""
        return _take(self.parts[number], samples)

    def headed(self, order: Order | None) -> Addresses:
        """Add the row of the visiting order, uint32[visits], at the head, as compiled code expects the inputs."""
        head = np.zeros((HEAD, self.addresses.shape[1]), dtype=np.uintp)
        head[0, 0] = 0 if order is None else address(order, kind=UINT32)
        return np.concatenate([head, self.addresses])


def _take(parts: Sequence[Float], samples: Int | Order) -> Float:
    if len(parts) == 1:
        return parts[0][samples]
    ends = np.cumsum([part.size for part in parts])
    owners = np.searchsorted(ends, samples, side="right")
    values = np.empty(samples.size)
    for number in np.unique(owners):
        mine = owners == number
        values[mine] = parts[number][samples[mine] - (ends[number] - parts[number].size)]
    return values


def find(f: FunctionWriter, sample: str) -> tuple[str, str]:
    """Return the block that holds a sample, and its index in the block."""
    return f.new(f"lshr i64 {sample}, {SHIFT}"), f.new(f"and i64 {sample}, {BLOCK - 1}")


def visit(f: FunctionWriter, order: str, k: str, rows: Sequence[tuple[str, int]]) -> tuple[str, str]:
    """Return block and index of the sample that is visited as number `k`, before `%last`; `order` is a pointer.

    A visiting order jumps about in the measurement, which hardware prefetching does not follow. `rows`, (table, row)
    pairs, are therefore prefetched some visits ahead, which makes it as fast as the stored order.
    """
    sample = f.variable("i64", k)
    with f.when(f.new(f"icmp ne ptr {order}, null")):
        sample.set(_ordered(f, order, k))
        # not beyond the range: the order may end there
        later = f.extreme("smin", f.add(k, AHEAD), f.add("%last", -1))
        block, place = find(f, _ordered(f, order, later))
        for table, row in rows:
            address = f.at(_start(f, f.at(table, block, "ptr"), row), place)
            f.do(f"call void @llvm.prefetch.p0(ptr {address}, i32 0, i32 3, i32 1)")
    return find(f, sample.get())


def _ordered(f: FunctionWriter, order: str, k: str) -> str:
    return f.new(f"zext i32 {f.load(order, k, 'i32')} to i64")


def _start(f: FunctionWriter, table: str, row: int) -> str:
    return f.load(table, f.mul("%stride", row), "ptr")


def load_sample(f: FunctionWriter, table: str, row: int, place: str) -> str:
    """Return the value of a row at an index of the block to which `table` points."""
    return f.load(_start(f, table, row), place)
