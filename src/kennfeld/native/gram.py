"""Products A H^-1 A' of sparse rows A, computed as V V' from the forward half V = A P' L^-T of each solve with H.

V consists of the rows that would follow H in a factorisation of [[H, A'], [A, 0]], and is computed as such: in blocks
of eight rows, each from its first non-zero on. Rows with a late first non-zero are cheap and are grouped together.
"""

from functools import cache

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.machine_code.engine import NativeFunction, compile_functions
from kennfeld.machine_code.ir import EIGHT, FunctionWriter, Vector
from kennfeld.native.addresses import INT64, address
from kennfeld.native.cholesky import FACTOR, Factor, column_of, divide, first_of, panel_of, reduce_block
from kennfeld.native.envelope import BLOCK


class Gram:
    """Matrix A H^-1 A' for a growing set of rows A. The factor of H must not change meanwhile.

    >>> gram = Gram(Factor.of(np.array([[2.0, 0.0], [0.0, 1.0]])))
    >>> gram.add(np.array([[0, 1]]), np.array([[1.0, -1.0]]))
    >>> gram.products
    array([[1.25]])
    """

    def __init__(self, factor: Factor) -> None:
        self._factor = factor
        self._halves = np.zeros((0, factor.inverse.size, BLOCK))  # V, block row by block row, column by column
        self._begins = np.zeros(0, dtype=np.int64)  # of each block row of V, its first block column
        self._numbers = np.zeros(0, dtype=np.int64)  # of each row of V, that of A from 1 on; 0 fills up blocks
        self._products = np.zeros((1, 1))  # row and column 0 are what fills up blocks

    def add(self, columns: Int, coefficients: Float) -> None:
        """Append rows of A, given by their columns and the coefficients there, both of shape (rows, width)."""
        place = self._factor.envelope.place[columns]
        begin = np.where(coefficients != 0, place // BLOCK, self._factor.envelope.blocks).min(axis=1)
        order = np.argsort(begin, kind="stable")
        halves = _scatter(place[order], coefficients[order], self._factor.inverse.size)
        known, before = self._begins.size, len(self._products)
        numbers = np.zeros(len(halves) * BLOCK, dtype=np.int64)
        numbers[: order.size] = before + order
        products = np.empty((before + order.size, before + order.size))
        products[:before, :before] = self._products
        self._halves = np.concatenate([self._halves, halves]) if known else halves
        self._begins = np.concatenate([self._begins, begin[order][::BLOCK]])
        self._numbers = np.concatenate([self._numbers, numbers])
        self._products = products
        blocks = self._begins.size
        rows = (address(self._halves, blocks * BLOCK * self._factor.inverse.size), address(self._begins, kind=INT64))
        table = (address(self._numbers, blocks * BLOCK, INT64), address(products), len(products))
        _functions()["halve"](*self._factor.pointers, *rows, known, blocks)
        _functions()["multiply"](*rows, known, blocks, self._factor.envelope.blocks, *table)

    @property
    def products(self) -> Float:
        """A H^-1 A', rows and columns in the order in which they were added."""
        return self._products[1:, 1:]


def _scatter(columns: Int, coefficients: Float, size: int) -> Float:
    """Return sparse rows as block rows, stored column by column."""
    full = np.zeros((-(-len(columns) // BLOCK), size, BLOCK))
    rows, entries = np.nonzero(coefficients)
    places = (rows // BLOCK * size + columns[rows, entries]) * BLOCK + rows % BLOCK
    np.add.at(full.ravel(), places, coefficients[rows, entries])
    return full


ROWS = (("ptr", "halves"), ("ptr", "begins"), ("i64", "known"), ("i64", "count"))


@cache
def _functions() -> dict[str, NativeFunction]:
    return compile_functions(_halve(), _multiply())


def _row(f: FunctionWriter, block: str, blocks: str) -> str:
    """Return the address of column 0 of a block row of V."""
    return f.at("%halves", f.mul(f.mul(block, blocks), BLOCK * BLOCK))


def _begin(f: FunctionWriter, block: str) -> str:
    """Return the first column of a block row of V."""
    return f.mul(f.load("%begins", block, "i64"), BLOCK)


def _halve() -> FunctionWriter:
    """Write `halve(factor, rows)`: solve V L' = A P' in place, block by block."""
    f = FunctionWriter("halve", [*FACTOR, *ROWS])
    with f.loop("%known", "%count") as b:
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
        row, column = f.load(rows, i, "i64"), f.load(columns, j, "i64")
        value = f.load(stored, f.add(f.mul(j, BLOCK), i))
        f.store(value, "%products", f.add(f.mul(row, "%stride"), column))
        f.store(value, "%products", f.add(f.mul(column, "%stride"), row))
