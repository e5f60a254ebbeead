"""Solves with a Cholesky factor: what numpy lacks, and what importing scipy's LAPACK would take 0.2 s for."""

from collections.abc import Callable
from functools import cache

import numpy as np

from kennfeld.arrays import Float
from kennfeld.native.engine import Engine
from kennfeld.native.ir import Function, literal

__all__ = ["Cholesky", "solve_both", "solve_lower", "solve_upper"]

FACTOR = (("ptr", "factor"), ("i64", "size"), ("ptr", "rows"), ("i64", "count"))


class Cholesky:
    """Factors symmetric matrices of one size, in memory of its own: fresh memory would take as long as the work."""

    def __init__(self, size: int) -> None:
        self._matrix = np.empty((size, size))
        self._upper = np.empty((size, size), order="F")

    def factor(self, matrix: Float, diagonal: Float) -> Float | None:
        """L with L L' = matrix + diag(diagonal), until the next call; None where that is not positive definite.

        >>> Cholesky(2).factor(np.array([[4.0, 2.0], [2.0, 1.0]]), np.array([0.0, 1.0]))
        array([[2., 0.],
               [1., 1.]])
        """
        np.copyto(self._matrix, matrix)
        self._matrix[np.diag_indices_from(self._matrix)] += diagonal
        try:
            return np.asarray(self._factor().T, dtype=np.float64)
        except np.linalg.LinAlgError:
            return None

    def _factor(self) -> Float:
        """The upper factor, its columns one after the other in memory, as LAPACK leaves it.

        `np.linalg.cholesky` transposes on the way in and out, which takes longer than the factorisation; its kernel
        does not if it is given such arrays.
        """
        kernel = getattr(getattr(np.linalg, "_umath_linalg", None), "cholesky_up", None)
        if kernel is None:
            return np.asarray(np.linalg.cholesky(self._matrix).T, dtype=np.float64)
        with np.errstate(invalid="ignore"):
            kernel(self._matrix.T, self._upper, signature="d->d")
        if self._upper.size and not np.isfinite(self._upper[-1, -1]):
            raise np.linalg.LinAlgError
        return self._upper


def solve_lower(factor: Float, right: Float) -> Float:
    """X of L x = b for each row b of `right`, a vector or (rows, size); `factor` is L.

    >>> solve_lower(np.array([[2.0, 0.0], [1.0, 1.0]]), np.array([2.0, 3.0]))
    array([1., 2.])
    """
    return _solved("forward", factor, right)


def solve_upper(factor: Float, right: Float) -> Float:
    """X of L' x = b for each row b of `right`; `factor` is L."""
    return _solved("backward", factor, right)


def solve_both(factor: Float, right: Float) -> Float:
    """X of L L' x = b for each row b of `right`."""
    return solve_upper(factor, solve_lower(factor, right))


def _solved(name: str, factor: Float, right: Float) -> Float:
    lower = np.ascontiguousarray(factor)
    rows = np.array(right, dtype=np.float64, order="C")
    size = lower.shape[0]
    if rows.size:
        _functions()[name](lower.ctypes.data, size, rows.ctypes.data, rows.size // size)
    return rows


@cache
def _functions() -> dict[str, Callable[..., None]]:
    texts = [_forward(), _backward()]
    engine = Engine("".join(f.text() for f in texts))
    return {f.name: engine.function(f.name, f.parameters) for f in texts}


def _forward() -> Function:
    f = Function("forward", FACTOR)
    with f.loop(0, "%count") as number:
        x = f.at("%rows", f.mul(number, "%size"))
        with f.loop(0, "%size") as i:
            row = f.at("%factor", f.mul(i, "%size"))
            total = f.slot("double")
            f.store(literal(0.0), total)
            with f.loop(0, i) as j:
                f.increase(f.fmul(f.load(row, j), f.load(x, j)), total)
            rest = f.new(f"fsub double {f.load(x, i)}, {f.load(total)}")
            f.store(f.new(f"fdiv double {rest}, {f.load(row, i)}"), x, i)
    return f


def _backward() -> Function:
    f = Function("backward", FACTOR)
    with f.loop(0, "%count") as number:
        x = f.at("%rows", f.mul(number, "%size"))
        with f.loop(0, "%size") as back:
            i = f.new(f"sub i64 {f.add('%size', -1)}, {back}")
            row = f.at("%factor", f.mul(i, "%size"))
            value = f.new(f"fdiv double {f.load(x, i)}, {f.load(row, i)}")
            f.store(value, x, i)
            minus = f.new(f"fneg double {value}")
            with f.loop(0, i) as j:
                f.increase(f.fmul(minus, f.load(row, j)), x, j)
    return f
