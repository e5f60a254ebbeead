"""Symmetric matrices of many values that are mostly zero, in blocks that exist where something was added.

The lower triangle consists of blocks of eight by eight. A table holds for each pair of block row and block column the
number of its block, or -1. What adds to the matrix needs no list of its non-zeros, and its size is that of the blocks.
If most blocks exist, all of them are stored in order, and their numbers are computed.
"""

from functools import cache

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import LANES, ZERO, FunctionWriter, Vector
from kennfeld.native.addresses import INT32, INT64, address

BLOCK = 8
ENTRIES = BLOCK * BLOCK  # of a block
MOST = 0.5  # share of the blocks from which all are stored
BLOCKS = (("ptr", "entries"), ("ptr", "places"), ("ptr", "table"), ("i64", "across"), ("ptr", "used"))


class BlockStorage:
    """The blocks of a matrix, of which `used` are in use.

    `blocks[k]` is stored row by row and belongs to block row `places[k] // across` and block column `places[k] %
    across`. Diagonal blocks hold the lower triangle only.
    """

    def __init__(self, size: int) -> None:
        self.size, self.across = size, -(-size // BLOCK)
        self.table = np.full(self.across**2, -1, dtype=np.int32)
        self.places = np.zeros(0, dtype=np.int64)
        self.blocks = np.zeros((0, ENTRIES))
        self.used = np.zeros(1, dtype=np.int64)
        self.full = False  # if all blocks exist, in order

    @property
    def pointers(self) -> tuple[int, ...]:
        """The arguments `BLOCKS` of generated code."""
        places, table = address(self.places, kind=INT64), address(self.table, kind=INT32)
        return address(self.blocks), places, table, self.across, address(self.used, kind=INT64)

    @property
    def count(self) -> int:
        """Number of blocks in use."""
        return int(self.used[0])

    @property
    def mostly_used(self) -> bool:
        """True if most blocks exist."""
        return self.count > MOST * self._most

    def fill(self) -> None:
        """Store all blocks, row by row."""
        if self.full:
            return
        rows, columns = np.tril_indices(self.across)
        places = rows * self.across + columns
        # before the table is renumbered: block (i, j) becomes number i (i + 1) / 2 + j, which code can compute
        numbers, there = self.table[places], self.table[places] >= 0
        blocks = np.zeros((places.size, ENTRIES))
        blocks[there] = self.blocks[numbers[there]]
        self.table[places] = np.arange(places.size)
        self.blocks, self.places, self.full = blocks, places, True
        self.used[0] = places.size

    def clear(self) -> None:
        """Set all entries to zero; the blocks stay."""
        self.blocks[: self.count] = 0.0

    @property
    def capacity(self) -> int:
        """Number of blocks for which there is room; unlimited if there is room for all."""
        return len(self.blocks) if len(self.blocks) < self._most else 2**62

    @property
    def _most(self) -> int:
        return self.across * (self.across + 1) // 2

    def reserve(self, blocks: int) -> None:
        """Make room for this many further blocks, as far as there are any."""
        needed = min(self.count + blocks, self._most)
        if needed > len(self.blocks):
            # doubled, so that blocks are copied rarely
            room = min(max(needed, 2 * len(self.blocks)), self._most)
            grown, places = np.zeros((room, ENTRIES)), np.zeros(room, dtype=np.int64)
            grown[: self.count], places[: self.count] = self.blocks[: self.count], self.places[: self.count]
            self.blocks, self.places = grown, places

    def locate(self, places: Int) -> Int:
        """Look up the numbers of blocks, Int[places], which are added if they do not exist."""
        missing = np.unique(places[self.table[places] < 0])
        self.reserve(missing.size)
        numbers = np.arange(self.count, self.count + missing.size)
        self.table[missing], self.places[numbers] = numbers, missing
        self.used[0] += missing.size
        return self.table[places].astype(np.int64)

    def add(self, other: "BlockStorage") -> None:
        """Add another matrix of the same size."""
        if self.full and other.full:
            self.blocks += other.blocks
            return
        self.add_blocks(other.places[: other.count], other.blocks[: other.count])

    def add_blocks(self, places: Int, blocks: Float) -> None:
        """Add blocks, Float[blocks, entries], at their places, Int[blocks], each named once."""
        at = self.locate(places)  # may replace `blocks`
        self.blocks[at] += blocks

    def add_entries(self, rows: Int, columns: Int, entries: Float) -> None:
        """Add entries of a symmetric matrix, each Float[entries] or Int[entries].

        Those above the diagonal are ignored; any may be repeated.
        """
        lower = rows >= columns
        rows, columns = rows[lower], columns[lower]
        at = self.locate(rows // BLOCK * self.across + columns // BLOCK)
        # unlike +=, adds each of several entries at one place
        np.add.at(self.blocks, (at, rows % BLOCK * BLOCK + columns % BLOCK), entries[lower])

    def diagonal(self) -> Float:
        """Return the diagonal, shape (size,)."""
        diagonal = np.zeros(self.across * BLOCK)
        numbers = self.table[:: self.across + 1]
        there = numbers >= 0
        diagonal.reshape(-1, BLOCK)[there] = self.blocks[numbers[there], :: BLOCK + 1]
        return diagonal[: self.size]

    def times(self, vector: Float) -> Float:
        """Multiply with a vector, shape (size,)."""
        # whole blocks are read and written, beyond the last row as well
        padded, product = np.zeros((2, self.across * BLOCK))
        padded[: self.size] = vector
        _functions()["multiply"](*self.pointers, address(padded), address(product))
        # the stored triangle and its transpose both have the diagonal
        return product[: self.size] - self.diagonal() * vector

    def zero(self, which: Bool) -> None:
        """Set rows and columns, Bool[size], to zero."""
        marked = np.zeros((self.across, BLOCK), dtype=bool)
        marked.ravel()[: self.size] = which
        some = np.logical_or.reduce(marked, axis=1)
        rows, columns = np.divmod(self.places[: self.count], self.across)
        touched = np.flatnonzero(some[rows] | some[columns])
        inside = marked[rows[touched], :, None] | marked[columns[touched], None, :]
        self.blocks[touched] = np.where(inside.reshape(-1, ENTRIES), 0.0, self.blocks[touched])

    def nonzeros(self) -> tuple[Int, Int, Float]:
        """List rows, columns and values of the non-zeros in the lower triangle, shape (non-zeros,) each."""
        numbers, inside = np.nonzero(self.blocks[: self.count])
        rows, columns = np.divmod(self.places[numbers], self.across)
        return rows * BLOCK + inside // BLOCK, columns * BLOCK + inside % BLOCK, self.blocks[numbers, inside]


class BlockMatrix:
    """Some rows and the same columns of a stored matrix.

    >>> storage = BlockStorage(20)
    >>> storage.add_entries(np.array([12, 12]), np.array([12, 3]), np.array([2.0, 1.0]))
    >>> matrix = BlockMatrix(storage, np.array([3, 12]))
    >>> matrix @ np.array([1.0, 10.0])
    array([10., 21.])
    """

    def __init__(self, storage: BlockStorage, rows: Int) -> None:
        self.storage, self.rows = storage, rows

    def __len__(self) -> int:
        return self.rows.size

    def diagonal(self) -> Float:
        """Return the diagonal, shape (rows,)."""
        return self.storage.diagonal()[self.rows]

    def __matmul__(self, vector: Float) -> Float:
        whole = np.zeros(self.storage.size)
        whole[self.rows] = vector
        return self.storage.times(whole)[self.rows]

    def part(self, which: Int) -> "BlockMatrix":
        """Select some rows and the same columns, Int[selected]; they change with this matrix."""
        return BlockMatrix(self.storage, self.rows[which])

    def add_entries(self, rows: Int, columns: Int, entries: Float) -> None:
        """Add entries of a symmetric matrix, Int[entries] and Float[entries]; those above the diagonal are ignored."""
        self.storage.add_entries(self.rows[rows], self.rows[columns], entries)

    def zero(self, which: Bool) -> None:
        """Set rows and columns, Bool[rows], to zero."""
        marked = np.zeros(self.storage.size, dtype=bool)
        marked[self.rows] = which
        self.storage.zero(marked)

    @property
    def places(self) -> Int:
        """The row of each row of the storage, Int[whole blocks], -1 if it is left out."""
        places = np.full(self.storage.across * BLOCK, -1, dtype=np.int64)
        places[self.rows] = np.arange(self.rows.size)
        return places

    def nonzeros(self) -> tuple[Int, Int, Float]:
        """List rows, columns and values of the non-zeros on one side of the diagonal, shape (non-zeros,) each."""
        rows, columns, values = self.storage.nonzeros()
        places = self.places
        rows, columns = places[rows], places[columns]
        inside = (rows >= 0) & (columns >= 0)
        return rows[inside], columns[inside], values[inside]

    def toarray(self) -> Float:
        """Copy all of it into an array, shape (rows, rows)."""
        rows, columns, values = self.nonzeros()
        matrix = np.zeros((len(self), len(self)))
        matrix[rows, columns] = values
        matrix[columns, rows] = values
        return matrix


def add_to_block(f: FunctionWriter, row: str, column: str, value: str) -> None:
    """Write code that adds to the entry in two columns, given the parameters `BLOCKS`; zeros need no block."""
    with f.when(f.new(f"fcmp une double {value}, {ZERO}")):
        high, low = f.extreme("smax", row, column), f.extreme("smin", row, column)
        place = f.add(f.mul(_block(f, high), "%across"), _block(f, low))
        # a new block is the next free one, which is zero; the caller has reserved it
        with f.when(f.new(f"icmp slt i32 {f.load('%table', place, 'i32')}, 0")):
            count = f.load("%used", kind="i64")
            f.store(f.new(f"trunc i64 {count} to i32"), "%table", place, "i32")
            f.store(place, "%places", count, "i64")
            f.store(f.add(count, 1), "%used", kind="i64")
        _increase(f, f.load_index("%table", place), high, low, value)


def add_to_full(f: FunctionWriter, row: str, column: str, value: str) -> None:
    """Write code that adds to the entry in two columns if all blocks are stored."""
    high, low = f.extreme("smax", row, column), f.extreme("smin", row, column)
    above = _block(f, high)
    # blocks in the rows above
    before = f.new(f"lshr i64 {f.mul(above, f.add(above, 1))}, 1")
    _increase(f, f.add(before, _block(f, low)), high, low, value)


def _block(f: FunctionWriter, number: str) -> str:
    return f.new(f"lshr i64 {number}, {BLOCK.bit_length() - 1}")


def _increase(f: FunctionWriter, number: str, row: str, column: str, value: str) -> None:
    """Add to an entry of a block."""
    lanes = [f.new(f"and i64 {at}, {BLOCK - 1}") for at in (row, column)]
    f.increase(value, f.at("%entries", f.mul(number, ENTRIES)), f.add(f.mul(lanes[0], BLOCK), lanes[1]))


@cache
def _functions() -> dict[str, NativeFunction]:
    return compile_functions(_multiply())


def _multiply() -> FunctionWriter:
    """Write `multiply(blocks, vector, product)`: the product, with the diagonal twice."""
    f = FunctionWriter("multiply", [*BLOCKS, ("ptr", "vector"), ("ptr", "product")])
    v = Vector(f)
    with f.loop(0, f.load("%used", kind="i64")) as k:
        place, block = f.load("%places", k, "i64"), f.at("%entries", f.mul(k, ENTRIES))
        row, column = (f.mul(f.new(f"{part} i64 {place}, %across"), LANES) for part in ("sdiv", "srem"))
        right = v.load("%vector", column)
        # block B of the lower triangle: product[row] += B vector[column] and product[column] += B' vector[row]
        below = f.variable(v.kind, "zeroinitializer")
        for lane in range(BLOCK):
            entries, at = v.load(block, lane * BLOCK), f.add(row, lane)
            f.increase(v.reduce(ZERO, v("fmul", entries, right)), "%product", at)
            below.set(v("fadd", below.get(), v.multiply(entries, f.load("%vector", at))))
        v.store(v("fadd", v.load("%product", column), below.get()), "%product", column)
    return f
