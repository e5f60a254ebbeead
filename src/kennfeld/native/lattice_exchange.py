"""Descent over whole numbers in compiled code: single values and pairs of neighbours move by one step.

The cost of whole numbers z about the centre c is (z - c)'H(z - c), whose half gradient is G = H(z - c). Moving value i
by s = +-1, and value j by t = +-1 with it, changes the cost by

    2 s G[i] + H[i,i]    and, with the pair,    + 2 t G[j] + H[j,j] + 2 s t H[i,j].

Only pairs with H[i,j] != 0 can gain more together than on their own. Rows of limits are kept: a move is made only if
every row that it touches stays within its sides.
"""

from functools import cache

import numpy as np

from kennfeld.base.arrays import Float, Int, Sparse
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import ONE, ZERO, FunctionWriter, StackVariable, literal
from kennfeld.native.addresses import INT64, address

LEAST_GAIN = 1e-12  # of the diagonal: a smaller decrease is rounding, and might be undone for ever
MATRIX = (("ptr", "first"), ("ptr", "columns"), ("ptr", "entries"), ("ptr", "diagonal"), ("i64", "size"))
STATE = (("ptr", "at"), ("ptr", "slope"), ("ptr", "lower"), ("ptr", "upper"))
ROWS = (("ptr", "begin"), ("ptr", "rows"), ("ptr", "factors"), ("ptr", "product"), ("ptr", "least"), ("ptr", "most"))


class LatticeExchange:
    """A symmetric matrix, bounds and rows, within which whole numbers are improved.

    Args:
        matrix: H, sparse with both sides of the diagonal, shape (size, size).
        lower: least whole numbers, Float[size].
        upper: largest whole numbers, Float[size].
        rows: the rows A of limits, sparse, shape (rows, size).
        least: their lower sides, Float[rows].
        most: their upper sides, Float[rows].
    """

    def __init__(self, matrix: Sparse, lower: Float, upper: Float, rows: Sparse, least: Float, most: Float) -> None:
        self._matrix, self._rows = matrix.tocsr(), rows.tocsr()
        self._size, by_value = lower.size, rows.tocsc()
        self._diagonal = np.require(self._matrix.diagonal(), np.float64, ["C"])
        self._arrays: list[Int | Float] = [
            _whole(self._matrix.indptr),
            _whole(self._matrix.indices),
            _real(self._matrix.data),
            self._diagonal,
        ]
        self._limits = [_real(lower), _real(upper)]
        self._touching: list[Int | Float] = [_whole(by_value.indptr), _whole(by_value.indices), _real(by_value.data)]
        self._sides = [_real(least), _real(most)]

    def cost(self, offset: Float) -> float:
        """Compute (z - c)'H(z - c) of an offset z - c, Float[size]."""
        return float(offset @ (self._matrix @ offset))

    def improve(self, numbers: Float, centre: Float, sweeps: int) -> Float:
        """Return whole numbers, Float[size], from which no single move and no pair of moves descends.

        Args:
            numbers: where to begin, within all limits; Float[size].
            centre: the real numbers that they should be close to, Float[size].
            sweeps: most passes over all values.
        """
        at = np.array(numbers, dtype=np.float64)
        slope, product = _real(self._matrix @ (at - centre)), _real(self._rows @ at)
        moved = np.zeros(1, dtype=np.int64)
        pointers = (
            *(_address(array) for array in self._arrays),
            self._size,
            *(address(array) for array in (at, slope, *self._limits)),
            *(_address(array) for array in (*self._touching, product, *self._sides)),
            address(moved, 1, INT64),
        )
        for _ in range(sweeps):
            _functions()["exchange"](*pointers)
            if not moved[0]:
                break
        return at


def _whole(array: Int) -> Int:
    return np.ascontiguousarray(array, dtype=np.int64)


def _real(array: Float) -> Float:
    return np.ascontiguousarray(array, dtype=np.float64)


def _address(array: Int | Float) -> int:
    return address(array, kind=INT64 if array.dtype == np.int64 else np.dtype(np.float64))


@cache
def _functions() -> dict[str, NativeFunction]:
    return compile_functions(_exchange())


def _exchange() -> FunctionWriter:
    """Write `exchange(matrix, state, rows, moved)`: a pass over all values, each with its best allowed move."""
    f = FunctionWriter("exchange", [*MATRIX, *STATE, *ROWS, ("ptr", "moved")])
    total = f.variable("i64", "0")
    best, sign = f.variable("double", ZERO), f.variable("double", ZERO)
    other, partner = f.variable("double", ZERO), f.variable("i64", "-1")
    with f.loop(0, "%size") as i:
        own = f.load("%diagonal", i)
        best.set(f.fmul(literal(-LEAST_GAIN), own))
        sign.set(ZERO)
        partner.set("-1")
        with f.loop(0, 2) as way:
            s = _sign(f, way)
            with f.when(_inside(f, i, s)):
                alone = f.fadd(_twice(f, s, f.load("%slope", i)), own)
                _keep_if_better(f, best, alone, (i, s), None, (sign, partner, other))
                with f.loop(f.load("%first", i, "i64"), f.load("%first", f.add(i, 1), "i64")) as k:
                    j = f.load("%columns", k, "i64")
                    with f.when(f.new(f"icmp ne i64 {j}, {i}")), f.loop(0, 2) as back:
                        t = _sign(f, back)
                        with f.when(_inside(f, j, t)):
                            # slope of j after the move of i
                            slope = f.fadd(f.load("%slope", j), f.fmul(s, f.load("%entries", k)))
                            pair = f.fadd(f.fadd(alone, _twice(f, t, slope)), f.load("%diagonal", j))
                            _keep_if_better(f, best, pair, (i, s), (j, t), (sign, partner, other))
        with f.when(f.new(f"fcmp une double {sign.get()}, {ZERO}")):
            total.set(f.add(total.get(), 1))
            _move(f, i, sign.get())
            j = partner.get()
            with f.when(f.new(f"icmp sge i64 {j}, 0")):
                _move(f, j, other.get())
    f.store(total.get(), "%moved", kind="i64")
    return f


def _sign(f: FunctionWriter, way: str) -> str:
    """Return +1 for the first way, -1 for the second one."""
    return f.select(f.new(f"icmp eq i64 {way}, 0"), ONE, literal(-1.0))


def _twice(f: FunctionWriter, a: str, b: str) -> str:
    return f.fmul(literal(2.0), f.fmul(a, b))


def _inside(f: FunctionWriter, i: str, step: str) -> str:
    """Return if a value stays within its bounds."""
    moved = f.fadd(f.load("%at", i), step)
    above = f.new(f"fcmp oge double {moved}, {f.load('%lower', i)}")
    return f.new(f"and i1 {above}, {f.new(f'fcmp ole double {moved}, ' + f.load('%upper', i))}")


def _keep_if_better(
    f: FunctionWriter,
    best: StackVariable,
    change: str,
    first: tuple[str, str],
    second: tuple[str, str] | None,
    kept: tuple[StackVariable, StackVariable, StackVariable],
) -> None:
    """Remember a move of one or two values if it descends more than the best one and no row forbids it."""
    sign, partner, other = kept
    with f.when(f.new(f"fcmp olt double {change}, {best.get()}")):
        allowed = f.variable("i64", "1")
        _check_rows(f, allowed, first, second)
        if second is not None:
            _check_rows(f, allowed, second, first)
        with f.when(f.new(f"icmp ne i64 {allowed.get()}, 0")):
            best.set(change)
            sign.set(first[1])
            partner.set("-1" if second is None else second[0])
            if second is not None:
                other.set(second[1])


def _check_rows(
    f: FunctionWriter, allowed: StackVariable, moved: tuple[str, str], along: tuple[str, str] | None
) -> None:
    """Set `allowed` to 0 if a row of the first value leaves its sides when that value and another one move."""
    i, s = moved
    with f.loop(*_rows_of(f, i)) as k:
        row = f.load("%rows", k, "i64")
        product = f.variable("double", f.fadd(f.load("%product", row), f.fmul(s, f.load("%factors", k))))
        if along is not None:
            # a value is in few rows, so that a search for the same one is short
            with f.loop(*_rows_of(f, along[0])) as other:
                same = f.new(f"icmp eq i64 {f.load('%rows', other, 'i64')}, {row}")
                with f.when(same):
                    product.set(f.fadd(product.get(), f.fmul(along[1], f.load("%factors", other))))
        below = f.new(f"fcmp olt double {product.get()}, {f.load('%least', row)}")
        above = f.new(f"fcmp ogt double {product.get()}, {f.load('%most', row)}")
        with f.when(f.new(f"or i1 {below}, {above}")):
            allowed.set("0")


def _rows_of(f: FunctionWriter, i: str) -> tuple[str, str]:
    return f.load("%begin", i, "i64"), f.load("%begin", f.add(i, 1), "i64")


def _move(f: FunctionWriter, i: str, step: str) -> None:
    """Move a value by a step, with the slopes of its neighbours and the products of its rows."""
    f.increase(step, "%at", i)
    with f.loop(f.load("%first", i, "i64"), f.load("%first", f.add(i, 1), "i64")) as k:
        f.increase(f.fmul(step, f.load("%entries", k)), "%slope", f.load("%columns", k, "i64"))
    with f.loop(*_rows_of(f, i)) as k:
        f.increase(f.fmul(step, f.load("%factors", k)), "%product", f.load("%rows", k, "i64"))
