"""Envelope Cholesky factorisation of a sparse symmetric matrix, and solves with the factor.

In a model with tables, a sample couples only the few grid points around it, so J'WJ is sparse. The order of the values
determines the fill-in of the factor (see `envelope`); a dense factorisation would process its zeros as well. Matrices
are stored in block rows of eight rows each, column by column, from the first block column of the envelope on, so that
all work is on vectors of eight.

With L the factor and i, j block indices (A. George, J. Liu: Computer Solution of Large Sparse Positive Definite
Systems, 1981):

    L[i,j] L[j,j]' = H[i,j] - sum over k < j of L[i,k] L[j,k]'     for j < i
    L[i,i] L[i,i]' = H[i,i] - sum over k < i of L[i,k] L[i,k]'
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, cached_property, lru_cache

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, aligned_zeros
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import EIGHT, LANES, ONE, ZERO, FunctionWriter, Vector, literal
from kennfeld.native.addresses import INT64, address, is_strided, readable, strided
from kennfeld.native.block_matrix import BLOCKS, BlockMatrix
from kennfeld.native.envelope import BLOCK, Envelope
from kennfeld.native.symmetric import SymmetricMatrix

FACTOR = (("ptr", "panels"), ("ptr", "start"), ("ptr", "first"), ("ptr", "inverse"), ("i64", "blocks"))
MATRIX = (("ptr", "matrix"), ("i64", "stride"), ("ptr", "diagonal"), ("ptr", "order"), ("i64", "size"))
ROWS = (("ptr", "rows"), ("i64", "count"))

POOR = 1.5  # times the work of the order when it was found


@dataclass(frozen=True)
class Factor:
    """Cholesky factor L of L L' = P H P', where P permutes the values into the order of the envelope."""

    envelope: Envelope
    panels: Float  # the blocks of the envelope
    inverse: Float  # Float[blocks * BLOCK], one over the diagonal

    @classmethod
    def empty(cls, envelope: Envelope) -> "Factor":
        """Return memory for a factor."""
        return cls(envelope, aligned_zeros(int(envelope.start[-1])), np.zeros(envelope.blocks * BLOCK))

    @classmethod
    def of(cls, lower: Float) -> "Factor":
        """Take a lower triangular matrix, Float[size, size], as a factor.

        >>> Factor.of(np.array([[2.0, 0.0], [1.0, 1.0]])).solve(np.array([4.0, 4.0]))
        array([0., 2.])
        """
        size = len(lower)
        result = cls.empty(_full(size))
        # a factor as it stands needs only the reciprocals of its diagonal; those of the padding are 1
        result.load(lower, np.zeros(size))
        result.inverse[:] = 1.0
        result.inverse[:size] = 1 / lower.diagonal()
        return result

    @classmethod
    def part(cls, matrix: Float, which: Int, diagonal: Float) -> "Factor | None":
        """Factor some rows and columns of a symmetric matrix + diag(diagonal); None if not positive definite.

        >>> matrix = np.array([[4.0, 9.0, 2.0], [9.0, 9.0, 9.0], [2.0, 9.0, 1.0]])
        >>> factor = Factor.part(matrix, np.array([0, 2]), np.array([0.0, 0.0, 1.0]))
        >>> factor.solve(np.array([6.0, 4.0]))
        array([1., 1.])
        """
        envelope = Envelope.full(which.size)
        result = cls.empty(envelope)
        # `which`, as an order, picks the rows from the larger matrix; the factor itself keeps the natural order
        replace(result, envelope=Envelope(which, envelope.first)).load(matrix, diagonal)
        return result if result.factor() else None

    def load(self, matrix: Float, diagonal: Float) -> bool:
        """Load matrix + diag(diagonal), shape (size, size); return True if all non-zeros lie in the envelope."""
        counts = np.zeros(2, dtype=np.int64)
        size = self.envelope.size
        if not is_strided(matrix):
            matrix = np.require(matrix, np.float64, ["C", "A"])
        diagonal = readable(diagonal)
        pointers = (*strided(matrix, size), address(diagonal, size))
        order = (address(self.envelope.order, size, INT64), size)
        _functions()["load"](*self.pointers, *pointers, *order, address(counts, 2, INT64))
        # non-zeros on one side of the diagonal, of the whole matrix and of what lies in the envelope
        return bool(counts[0] == counts[1])

    def load_blocks(self, matrix: BlockMatrix, diagonal: Float) -> bool:
        """Load matrix + diag(diagonal), Float[size]; return True if all non-zeros of the matrix lie in the envelope."""
        outside, size = np.zeros(1, dtype=np.int64), self.envelope.size
        ordered = np.empty(size)
        ordered[:] = np.require(diagonal, np.float64, ["C"])[self.envelope.order]
        rows = np.append(self.envelope.place, -1)[matrix.places]  # -1 stays
        arguments = (*matrix.storage.pointers, address(rows, kind=INT64), address(ordered, size), size)
        _functions()["load_blocks"](*self.pointers, *arguments, address(outside, 1, INT64))
        return not outside[0]

    def factor(self) -> bool:
        """Replace the loaded matrix by its factor; return True if it is positive definite."""
        failed = np.zeros(1, dtype=np.int64)
        _functions()["factor"](*self.pointers, address(failed, 1, INT64))
        return not failed[0]

    def solve_lower(self, right: Float) -> Float:
        """Solve L x = P b for each row b of `right`, a vector or (rows, size); x is padded to whole blocks."""
        rows = np.zeros((*right.shape[:-1], self.inverse.size))
        rows[..., : self.envelope.size] = right[..., self.envelope.order]
        _functions()["forward"](*self.pointers, address(rows), rows.size // max(self.inverse.size, 1))
        return rows

    def solve_upper(self, right: Float) -> Float:
        """Solve L' P x = b for each row b of `right`, of the shape that `solve_lower` returns."""
        rows = np.array(right, dtype=np.float64, order="C")
        _functions()["backward"](*self.pointers, address(rows), rows.size // max(self.inverse.size, 1))
        solved = np.empty((*rows.shape[:-1], self.envelope.size))
        solved[..., self.envelope.order] = rows[..., : self.envelope.size]
        return solved

    def solve(self, right: Float) -> Float:
        """Solve H x = b for each row b of `right`, shape (size,) or (rows, size)."""
        return self.solve_upper(self.solve_lower(right))

    @cached_property
    def pointers(self) -> tuple[int, ...]:
        """The arguments `FACTOR` of generated code."""
        blocks = self.envelope.blocks
        panels = address(self.panels, int(self.envelope.start[-1]))
        return (panels, *self.envelope.addresses, address(self.inverse, blocks * BLOCK), blocks)


class Cholesky:
    """Factorisation of symmetric matrices of one size in reused memory; allocating it would take as long as the work.

    The envelope adapts to the non-zeros: it is extended if a matrix has one outside.
    """

    def __init__(self, size: int) -> None:
        _functions()  # compiled now, not in the first factorisation
        self._pattern: Bool | None = None  # non-zeros of all arrays so far
        self._pairs = np.zeros(0, dtype=np.int64)  # those of block matrices, as row * size + column
        self._least = 0.0  # work of the envelope when its order was found
        # blocks on the diagonal to begin with: the pattern is known from the first matrix on
        self._factor = Factor.empty(Envelope(np.arange(size), np.arange(-(-size // BLOCK))))

    @property
    def size(self) -> int:
        """Number of rows of the matrices."""
        return self._factor.envelope.size

    def factor(self, matrix: SymmetricMatrix, diagonal: Float) -> Factor | None:
        """Factor matrix + diag(diagonal); return None if it is not positive definite. The factor is valid until the
        next call.

        Args:
            matrix: symmetric, shape (size, size); of an array, either side of the diagonal may be read.
            diagonal: shape (size,).

        >>> factor = Cholesky(2).factor(np.array([[4.0, 2.0], [2.0, 1.0]]), np.array([0.0, 1.0]))
        >>> factor.solve(np.array([6.0, 4.0]))
        array([1., 1.])
        """
        if isinstance(matrix, BlockMatrix):
            if not self._factor.load_blocks(matrix, diagonal):
                self._factor = Factor.empty(self._extended(matrix))
                self._factor.load_blocks(matrix, diagonal)
        elif not self._factor.load(matrix, diagonal):
            # the union of all patterns so far: the factor grows a few times in a fit and then fits all
            filled = (matrix != 0) | np.eye(self.size, dtype=bool)
            filled |= filled.T  # rounding may leave a zero in one half alone
            self._pattern = filled if self._pattern is None else self._pattern | filled
            envelope = Envelope.ordered(self._pattern, self._factor.envelope.order)
            if envelope.work > POOR * self._least:  # the old order has become poor
                envelope = Envelope.of(self._pattern)
                self._least = envelope.work
            self._factor = Factor.empty(envelope)
            self._factor.load(matrix, diagonal)
        return self._factor if self._factor.factor() else None

    def _extended(self, matrix: BlockMatrix) -> Envelope:
        """Return an envelope of the non-zeros of all block matrices so far; the full one if many are non-zero."""
        if matrix.storage.mostly_used:
            return Envelope.full(self.size)
        rows, columns, _ = matrix.nonzeros()
        self._pairs = np.union1d(self._pairs, rows * self.size + columns)
        return Envelope.of_pairs(self.size, *np.divmod(self._pairs, self.size))


def panel_of(f: FunctionWriter, block: str) -> str:
    """Return the address of column 0 of a block row; only the columns from its first on exist."""
    return f.at("%panels", f.load("%start", block, "i64"))


def first_of(f: FunctionWriter, block: str) -> str:
    """Return the first column of a block row."""
    return f.mul(f.load("%first", block, "i64"), BLOCK)


def column_of(f: FunctionWriter, panel: str, column: str) -> str:
    """Return the address of a column of a block row."""
    return f.at(panel, column, EIGHT)


def reduce_block(f: FunctionWriter, panel: str, other: str, first: str, end: str) -> list[str]:
    """Return the columns of a block of X, minus the sum over k of X[k] Y[k]': H[i,j] - sum of L[i,k] L[j,k]'.

    The sum is over the columns k from `first` to before `end`, where the block begins. `panel` and `other` are the
    block rows X and Y. Each k updates all eight columns of the block.
    """
    v = Vector(f)
    # eight columns stay in registers while k runs over both block rows
    rest = [f.variable(EIGHT, v.load(column_of(f, panel, f.add(end, c)))) for c in range(BLOCK)]
    with f.loop(first, end) as k:
        own = v.load(column_of(f, panel, k))
        scalars = column_of(f, other, k)
        for c, column in enumerate(rest):
            column.set(v("fsub", column.get(), v.multiply(own, f.load(scalars, c))))
    return [column.get() for column in rest]


def divide(f: FunctionWriter, panel: str, other: str, j: str, rest: list[str]) -> None:
    """Solve X L' = rest for the columns X of the block, with the diagonal block L of block row j.

    Column by column, X[c] = (rest[c] - sum over d < c of X[d] L[c,d]) / L[c,c].
    """
    v, at = Vector(f), f.mul(j, BLOCK)
    solved: list[str] = []
    for c, column in enumerate(rest):
        for d, earlier in enumerate(solved):
            column = v("fsub", column, v.multiply(earlier, f.load(column_of(f, other, f.add(at, d)), c)))
        scale = v.splat(f.load("%inverse", f.add(at, c)))
        solved.append(f.new(f"fmul {EIGHT} {column}, {scale}"))
    for c, column in enumerate(solved):
        v.store(column, column_of(f, panel, f.add(at, c)))


@lru_cache(64)
def _full(size: int) -> Envelope:
    """Return the full envelope, which factors of one size share."""
    return Envelope.full(size)


@cache
def _functions() -> dict[str, NativeFunction]:
    return compile_functions(_load(), _load_blocks(), _factor(), _forward(), _backward())


def _load() -> FunctionWriter:
    """Write `load(factor, matrix, counts)`: fill the panels; count non-zeros below the diagonal, and in the panels."""
    f = FunctionWriter("load", [*FACTOR, *MATRIX, ("ptr", "counts")])
    with f.loop(0, "%size") as i:
        row = f.at("%matrix", f.mul(i, "%stride"))
        # row i before the diagonal: whole vectors first, then what is left to i
        whole = f.new(f"and i64 {i}, -{LANES}")
        _count_eights(f, row, whole)
        _count(f, row, whole, i, lambda j: j, "0")
    with f.loop(0, "%blocks") as block, f.loop(0, BLOCK) as lane:
        i = f.add(f.mul(block, BLOCK), lane)
        inside = f.new(f"icmp slt i64 {i}, %size")
        place = f.at(panel_of(f, block), lane)
        first, end = first_of(f, block), f.mul(f.add(block, 1), BLOCK)
        with f.when(inside):
            source = f.load("%order", i, "i64")
            row = f.at("%matrix", f.mul(source, "%stride"))
            with f.loop(first, i) as k:
                f.store(f.load(row, f.load("%order", k, "i64")), place, f.mul(k, BLOCK))
            _count(f, row, first, i, lambda k: f.load("%order", k, "i64"), "1")
            own = f.fadd(f.load(row, source), f.load("%diagonal", source))
            f.store(own, place, f.mul(i, BLOCK))
        # rows behind the last one are those of the identity, which leave the factor of the others as it is
        with f.when(f.new(f"xor i1 {inside}, true")):
            with f.loop(first, end) as k:
                f.store(ZERO, place, f.mul(k, BLOCK))
            f.store(ONE, place, f.mul(i, BLOCK))
    return f


def _load_blocks() -> FunctionWriter:
    """Write `load_blocks(factor, blocks, places, ordered, size, outside)`: fill the panels from a block matrix.

    `rows` holds for each row of the blocks its row in the factor, or -1; `ordered` is the diagonal to add. Non-zeros
    outside the envelope are counted.
    """
    own = (("ptr", "rows"), ("ptr", "ordered"), ("i64", "size"), ("ptr", "outside"))
    f = FunctionWriter("load_blocks", [*FACTOR, *BLOCKS, *own])
    entries = f.load("%start", "%blocks", "i64")
    f.do(f"call void @llvm.memset.p0.i64(ptr %panels, i8 0, i64 {f.mul(entries, 8)}, i1 false)")
    with f.loop(0, f.load("%used", kind="i64")) as k:
        place, block = f.load("%places", k, "i64"), f.at("%entries", f.mul(k, BLOCK * BLOCK))
        top, left = (f.new(f"{part} i64 {place}, %across") for part in ("sdiv", "srem"))
        on_diagonal = f.new(f"icmp eq i64 {top}, {left}")
        with f.loop(0, BLOCK) as a:
            row = f.load("%rows", f.add(f.mul(top, BLOCK), a), "i64")
            with f.when(f.new(f"icmp sge i64 {row}, 0")):
                # diagonal blocks hold their lower triangle only
                end = f.new(f"select i1 {on_diagonal}, i64 {f.add(a, 1)}, i64 {BLOCK}")
                with f.loop(0, end) as b:
                    column = f.load("%rows", f.add(f.mul(left, BLOCK), b), "i64")
                    with f.when(f.new(f"icmp sge i64 {column}, 0")):
                        _place_entry(f, row, column, f.load(block, f.add(f.mul(a, BLOCK), b)))
    with f.loop(0, f.mul("%blocks", BLOCK)) as i:
        own_place = f.at(_panel_row(f, i), f.mul(i, BLOCK))
        inside = f.new(f"icmp slt i64 {i}, %size")
        with f.when(inside):
            f.increase(f.load("%ordered", i), own_place)
        with f.when(f.new(f"xor i1 {inside}, true")):
            f.store(ONE, own_place)
    return f


def _panel_row(f: FunctionWriter, row: str) -> str:
    """Return the address of a row of the panels in column 0."""
    return f.at(panel_of(f, f.new(f"lshr i64 {row}, 3")), f.new(f"and i64 {row}, {BLOCK - 1}"))


def _place_entry(f: FunctionWriter, row: str, column: str, value: str) -> None:
    """Write an entry into the panels, or count it if it is a non-zero outside the envelope."""
    # the order of the factor may carry an entry below the diagonal above it
    high, low = f.extreme("smax", row, column), f.extreme("smin", row, column)
    inside = f.new(f"icmp sge i64 {low}, {first_of(f, f.new(f'lshr i64 {high}, 3'))}")
    with f.when(inside):
        f.store(value, _panel_row(f, high), f.mul(low, BLOCK))
    with f.when(f.new(f"xor i1 {inside}, true")):
        there = f.new(f"zext i1 {f.new(f'fcmp une double {value}, {ZERO}')} to i64")
        f.store(f.add(f.load("%outside", kind="i64"), there), "%outside", kind="i64")


def _count(f: FunctionWriter, row: str, first: str | int, end: str, index: Callable[[str], str], result: str) -> None:
    """Add the non-zeros of a row to the count `result`."""
    total = f.variable("i64", "0")
    with f.loop(first, end) as k:
        there = f.new(f"fcmp une double {f.load(row, index(k))}, {ZERO}")
        total.set(f.add(total.get(), f.new(f"zext i1 {there} to i64")))
    f.store(f.add(f.load("%counts", result, "i64"), total.get()), "%counts", result, "i64")


def _count_eights(f: FunctionWriter, row: str, end: str) -> None:
    """Add the non-zeros of the first `end` entries of a row, a multiple of eight, to the first count."""
    with f.walk(end) as (k, position):
        # eight comparisons are the bits of one byte, whose ones are counted
        there = f.new(f"fcmp une {EIGHT} {Vector(f).load(row, k)}, zeroinitializer")
        bits = f.new(f"bitcast <{LANES} x i1> {there} to i{LANES}")
        count = f.new(f"zext i{LANES} {f.new(f'call i{LANES} @llvm.ctpop.i{LANES}(i{LANES} {bits})')} to i64")
        f.store(f.add(f.load("%counts", 0, "i64"), count), "%counts", 0, "i64")
        position.set(f.add(k, LANES))


def _factor() -> FunctionWriter:
    """Write `factor(factor, failed)`: block row by block row, each block from those left of it."""
    f = FunctionWriter("factor", [*FACTOR, ("ptr", "failed")])
    with f.loop(0, "%blocks") as i:
        panel, first = panel_of(f, i), f.load("%first", i, "i64")
        with f.loop(first, i) as j:
            other = panel_of(f, j)
            # where either row has not begun, the products are 0
            later = f.extreme("smax", first_of(f, i), first_of(f, j))
            divide(f, panel, other, j, reduce_block(f, panel, other, later, f.mul(j, BLOCK)))
        _factor_block(f, panel, i, reduce_block(f, panel, panel, first_of(f, i), f.mul(i, BLOCK)))
    return f


def _factor_block(f: FunctionWriter, panel: str, i: str, rest: list[str]) -> None:
    """Write the factorisation of the diagonal block: column by column, each subtracted from those that follow."""
    v, at = Vector(f), f.mul(i, BLOCK)
    for c in range(BLOCK):
        pivot = v.lane(rest[c], c)
        # NaN fails both comparisons
        positive = f.new(f"fcmp ogt double {pivot}, {ZERO}")
        finite = f.new(f"fcmp olt double {pivot}, {literal(float('inf'))}")
        with f.when(f.new(f"xor i1 {f.new(f'and i1 {positive}, {finite}')}, true")):
            f.store("1", "%failed", kind="i64")
            f.do("ret void")
            f.begin(f.label("on"))
        root = f.new(f"call double @llvm.sqrt.f64(double {pivot})")
        # one division per column; factor and solves multiply by the reciprocal
        inverse = f.new(f"fdiv double {ONE}, {root}")
        f.store(inverse, "%inverse", f.add(at, c))
        rest[c] = f.new(f"fmul {EIGHT} {rest[c]}, {v.splat(inverse)}")
        for d in range(c + 1, BLOCK):
            rest[d] = v("fsub", rest[d], v.multiply(rest[c], v.lane(rest[c], d)))
        v.store(rest[c], column_of(f, panel, f.add(at, c)))


def _forward() -> FunctionWriter:
    """Write `forward(factor, rows)`: solve L x = b in place, block row by block row; zeros of b at its start stay."""
    f = FunctionWriter("forward", [*FACTOR, *ROWS])
    v = Vector(f)
    with f.loop(0, "%count") as number:
        x = f.at("%rows", f.mul(f.mul(number, "%blocks"), BLOCK))
        with f.loop(0, "%blocks") as i:
            panel, at = panel_of(f, i), f.mul(i, BLOCK)
            # x[i] = L[i,i]^-1 (b[i] - sum over k < i of L[i,k] x[k]), within the diagonal block column by column
            rest = f.variable(EIGHT, v.load(x, at))
            with f.loop(first_of(f, i), at) as k:
                column = v.load(column_of(f, panel, k))
                rest.set(v("fsub", rest.get(), v.multiply(column, f.load(x, k))))
            for c in range(BLOCK):
                now, place = rest.get(), f.add(at, c)
                value = f.fmul(v.lane(now, c), f.load("%inverse", place))
                f.store(value, x, place)
                rest.set(v("fsub", now, v.multiply(v.load(column_of(f, panel, place)), value)))
    return f


def _backward() -> FunctionWriter:
    """Write `backward(factor, rows)`: solve L' x = b in place."""
    f = FunctionWriter("backward", [*FACTOR, *ROWS])
    with f.loop(0, "%count") as number:
        substitute_backward(f, f.at("%rows", f.mul(f.mul(number, "%blocks"), BLOCK)))
    return f


def substitute_backward(f: FunctionWriter, x: str) -> None:
    """Solve L' x = b in place, where `x` is the address of b."""
    v = Vector(f)
    with f.loop(0, "%blocks") as back:
        # rows are stored, not columns: once x[i] is known, L[i,k]' x[i] is subtracted from all earlier b[k]
        i = f.new(f"sub i64 {f.add('%blocks', -1)}, {back}")
        panel, at = panel_of(f, i), f.mul(i, BLOCK)
        for c in reversed(range(BLOCK)):
            column = column_of(f, panel, f.add(at, c))
            later = [(f.load(column, d), f.load(x, f.add(at, d))) for d in range(c + 1, BLOCK)]
            rest = f.new(f"fsub double {f.load(x, f.add(at, c))}, {f.dot(later)}")
            f.store(f.fmul(rest, f.load("%inverse", f.add(at, c))), x, f.add(at, c))
        solved = v.load(x, at)
        with f.loop(first_of(f, i), at) as k:
            total = v.reduce(ZERO, v("fmul", v.load(column_of(f, panel, k)), solved))
            f.store(f.new(f"fsub double {f.load(x, k)}, {total}"), x, k)
