"""Products A H^-1 A' of sparse rows A, computed as V V' from the forward half V = A P' L^-T of each solve with H.

V consists of the rows that would follow H in a factorisation of [[H, A'], [A, 0]], and is computed as such: in blocks
of eight rows, each from its first non-zero on. Rows with a late first non-zero are cheap and are grouped together.
"""

from functools import cache

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import EIGHT, ZERO, FunctionWriter, Vector
from kennfeld.native.addresses import INT64, address
from kennfeld.native.cholesky import (
    FACTOR,
    Factor,
    column_of,
    divide,
    first_of,
    panel_of,
    reduce_block,
    substitute_backward,
)
from kennfeld.native.envelope import BLOCK, Envelope


class Gram:
    """Matrix A H^-1 A' for a growing set of rows A. The factor of H must not change meanwhile.

    >>> gram = Gram(Factor.of(np.array([[2.0, 0.0], [0.0, 1.0]])))
    >>> gram.add(np.array([[0, 1]]), np.array([[1.0, -1.0]]))
    >>> gram.products
    array([[1.25]])
    >>> gram.displacement(np.array([4.0]))
    array([ 1., -4.])
    """

    def __init__(self, factor: Factor) -> None:
        self._blocks = 0
        self._size = factor.inverse.size
        self._memory = _Memory(1, self._size)
        self._envelope: Envelope | None = None
        self.restart(factor)

    def restart(self, factor: Factor) -> None:
        """Begin again without rows, with a factor of the same size; the memory is used again."""
        self._memory.clear(self._blocks)
        # factors of one pattern share an envelope, of which the address is taken once
        if self._envelope is not factor.envelope:
            self._envelope = factor.envelope
            self._placed = address(self._envelope.place, kind=INT64)
        self._factor = factor
        self._rows = self._blocks = 0  # of A, and block rows of V

    def add(self, columns: Int, coefficients: Float) -> None:
        """Append rows of A, given by their columns and the coefficients there, both of shape (rows, width)."""
        (count, width), known = columns.shape, self._blocks
        # new rows begin a block row of their own; what is missing to a whole one has the number 0
        blocks = known - (-count // BLOCK)
        if blocks > self._memory.room:
            # twice the need, so that a set that grows row by row is copied rarely
            self._memory = self._memory.enlarged(known, self._rows, 2 * blocks)
        memory, factor = self._memory, self._factor.pointers
        rows = (*memory.rows, known, blocks)
        entries = (address(columns, kind=INT64), address(coefficients, columns.size), count, width, self._rows)
        _functions()["scatter"](*factor, *rows, self._placed, *entries, memory.numbered)
        _functions()["halve"](*factor, *rows)
        _functions()["multiply"](*rows, self._factor.envelope.blocks, memory.numbered, *memory.table)
        self._rows, self._blocks = self._rows + count, blocks

    @property
    def products(self) -> Float:
        """A H^-1 A', Float[rows, rows], in the order in which the rows were added."""
        return self._memory.products[1 : self._rows + 1, 1 : self._rows + 1]

    def displacement(self, multipliers: Float) -> Float:
        """Return H^-1 A'm for multipliers m of all rows, Float[values]: L' P x = V'm is solved for x."""
        memory, result = self._memory, np.empty(self._factor.envelope.size)
        memory.weights[1 : self._rows + 1] = multipliers
        memory.half[:] = 0.0
        rows = (*memory.rows, 0, self._blocks, memory.numbered, *memory.solution)
        _functions()["displace"](*self._factor.pointers, *rows, self._placed, address(result), result.size)
        return result


class _Memory:
    """Memory for block rows of V and the products; row and column 0 of the products are what fills up blocks."""

    def __init__(self, room: int, size: int) -> None:
        self.room, self.size = room, size
        self.halves = np.zeros((room, size, BLOCK))  # V, block row by block row, column by column
        self.begins = np.zeros(room, dtype=np.int64)  # of each block row of V, its first block column
        self.numbers = np.zeros(room * BLOCK, dtype=np.int64)  # of each row of V, that of A from 1 on; 0 fills up
        self.products = np.empty((room * BLOCK + 1, room * BLOCK + 1))
        self.weights, self.half = np.zeros(room * BLOCK + 1), np.zeros(size)
        self.rows = (address(self.halves), address(self.begins, kind=INT64))
        self.numbered = address(self.numbers, kind=INT64)
        self.table = (address(self.products), len(self.products))
        self.solution = (address(self.weights), address(self.half))

    def clear(self, blocks: int) -> None:
        """Set the used block rows to zero."""
        self.halves[:blocks] = 0.0
        self.numbers[: blocks * BLOCK] = 0
        # the multiplier of the rows that fill up blocks
        self.weights[0] = 0.0

    def enlarged(self, blocks: int, rows: int, room: int) -> "_Memory":
        """Return a copy of the used block rows, and of the products of `rows` rows, with room for more."""
        other = _Memory(room, self.size)
        other.halves[:blocks], other.begins[:blocks] = self.halves[:blocks], self.begins[:blocks]
        other.numbers[: blocks * BLOCK] = self.numbers[: blocks * BLOCK]
        other.products[: rows + 1, : rows + 1] = self.products[: rows + 1, : rows + 1]
        return other


ROWS = (("ptr", "halves"), ("ptr", "begins"), ("i64", "known"), ("i64", "count"))


@cache
def _functions() -> dict[str, NativeFunction]:
    return compile_functions(_scatter(), _halve(), _multiply(), _displace())


def _row(f: FunctionWriter, block: str, blocks: str) -> str:
    """Return the address of column 0 of a block row of V."""
    return f.at("%halves", f.mul(f.mul(block, blocks), BLOCK * BLOCK))


def _begin(f: FunctionWriter, block: str) -> str:
    """Return the first column of a block row of V."""
    return f.mul(f.load("%begins", block, "i64"), BLOCK)


def _scatter() -> FunctionWriter:
    """Write `scatter(factor, rows, place, columns, coefficients, added, width, before, numbers)`: rows of A P' into V.

    They are sorted by their first block column, those without entries come last.
    """
    entries = (("ptr", "columns"), ("ptr", "coefficients"), ("i64", "added"), ("i64", "width"), ("i64", "before"))
    f = FunctionWriter("scatter", [*FACTOR, *ROWS, ("ptr", "place"), *entries, ("ptr", "numbers")])
    # a counting sort: for each block column in turn, the rows that begin there; those without entries come last
    following = f.variable("i64", f.mul("%known", BLOCK))
    with f.loop(0, f.add("%blocks", 1)) as block, f.loop(0, "%added") as row:
        first = f.new(f"icmp eq i64 {_first_block(f, row)}, {block}")
        with f.when(first):
            number = following.get()
            following.set(f.add(number, 1))
            f.store(f.add(f.add("%before", row), 1), "%numbers", number, "i64")
            own, lane = f.new(f"sdiv i64 {number}, {BLOCK}"), f.new(f"srem i64 {number}, {BLOCK}")
            # of sorted rows, the first one of a block row begins first
            with f.when(f.new(f"icmp eq i64 {lane}, 0")):
                f.store(block, "%begins", own, "i64")
            target = f.at(_row(f, own, "%blocks"), lane)
            with f.loop(0, "%width") as k:
                column, coefficient = _entry(f, row, k)
                # added, as a row may name a column twice
                f.increase(coefficient, target, f.mul(column, BLOCK))
    return f


def _first_block(f: FunctionWriter, row: str) -> str:
    """Return the first block column of a row of A P'; the number of blocks if it has no entries."""
    first = f.variable("i64", "%blocks")
    with f.loop(0, "%width") as k:
        column, coefficient = _entry(f, row, k)
        with f.when(f.new(f"fcmp une double {coefficient}, {ZERO}")):
            # coefficients of 0 fill up narrow rows, and their columns say nothing
            first.set(f.extreme("smin", first.get(), f.new(f"sdiv i64 {column}, {BLOCK}")))
    return first.get()


def _entry(f: FunctionWriter, row: str, k: str) -> tuple[str, str]:
    """Return the column and the coefficient of an entry of A P'."""
    entry = f.add(f.mul(row, "%width"), k)
    return f.load("%place", f.load("%columns", entry, "i64"), "i64"), f.load("%coefficients", entry)


def _halve() -> FunctionWriter:
    """Write `halve(factor, rows)`: solve V L' = A P' in place, block by block."""
    f = FunctionWriter("halve", [*FACTOR, *ROWS])
    with f.loop("%known", "%count") as b:
        # V[b,j] L[j,j]' = (A P')[b,j] - sum over k < j of V[b,k] L[j,k]', from where both rows have begun
        panel = _row(f, b, "%blocks")
        with f.loop(f.load("%begins", b, "i64"), "%blocks") as j:
            other = panel_of(f, j)
            later = f.extreme("smax", _begin(f, b), first_of(f, j))
            divide(f, panel, other, j, reduce_block(f, panel, other, later, f.mul(j, BLOCK)))
    return f


def _multiply() -> FunctionWriter:
    """Write `multiply(rows, blocks, numbers, products, stride)`: V V' of the new block rows with all."""
    result = (("ptr", "numbers"), ("ptr", "products"), ("i64", "stride"))
    f = FunctionWriter("multiply", [*ROWS, ("i64", "blocks"), *result])
    v = Vector(f)
    with f.loop("%known", "%count") as b, f.loop(0, f.add(b, 1)) as c:
        own, other = _row(f, b, "%blocks"), _row(f, c, "%blocks")
        later = f.extreme("smax", _begin(f, b), _begin(f, c))
        # lane i of sum j: row i of block row b times row j of block row c
        sums = [f.variable(EIGHT, "zeroinitializer") for _ in range(BLOCK)]
        with f.loop(later, f.mul("%blocks", BLOCK)) as k:
            vector, scalars = v.load(column_of(f, own, k)), column_of(f, other, k)
            for lane, total in enumerate(sums):
                total.set(v("fadd", total.get(), v.multiply(vector, f.load(scalars, lane))))
        _write_products(f, [total.get() for total in sums], b, c)
    return f


def _write_products(f: FunctionWriter, block: list[str], b: str, c: str) -> None:
    """Write the columns of a block into the symmetric matrix of products, on both sides of its diagonal."""
    stored = f.slot(EIGHT, BLOCK)
    for lane, vector in enumerate(block):
        f.store(vector, stored, lane, EIGHT)
    rows, columns = (f.at("%numbers", f.mul(number, BLOCK)) for number in (b, c))
    with f.loop(0, BLOCK) as i, f.loop(0, BLOCK) as j:
        # one value for both sides, so that the products are symmetric bit for bit
        row, column = f.load(rows, i, "i64"), f.load(columns, j, "i64")
        value = f.load(stored, f.add(f.mul(j, BLOCK), i))
        f.store(value, "%products", f.add(f.mul(row, "%stride"), column))
        f.store(value, "%products", f.add(f.mul(column, "%stride"), row))


def _displace() -> FunctionWriter:
    """Write `displace(factor, rows, numbers, weights, half, place, result, size)`: see `Gram.displacement`."""
    lists = (("ptr", "numbers"), ("ptr", "weights"), ("ptr", "half"))
    f = FunctionWriter("displace", [*FACTOR, *ROWS, *lists, ("ptr", "place"), ("ptr", "result"), ("i64", "size")])
    v, own = Vector(f), f.slot(EIGHT)
    with f.loop(0, "%count") as b:
        numbers, panel = f.at("%numbers", f.mul(b, BLOCK)), _row(f, b, "%blocks")
        # half = V'm, column by column of V, which the backward substitution turns into the solution
        for lane in range(BLOCK):
            f.store(f.load("%weights", f.load(numbers, lane, "i64")), own, lane)
        weights = v.load(own)
        with f.loop(_begin(f, b), f.mul("%blocks", BLOCK)) as k:
            f.increase(v.reduce(ZERO, v("fmul", v.load(column_of(f, panel, k)), weights)), "%half", k)
    substitute_backward(f, "%half")
    with f.loop(0, "%size") as i:
        f.store(f.load("%half", f.load("%place", i, "i64")), "%result", i)
    return f
