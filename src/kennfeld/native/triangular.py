"""Solves with a Cholesky factor: what numpy lacks, and what importing scipy's LAPACK would take 0.2 s for."""

from collections.abc import Callable
from functools import cache

import numpy as np

from kennfeld.arrays import Float
from kennfeld.native.engine import Engine
from kennfeld.native.ir import Function, literal

__all__ = ["cholesky", "solve_both", "solve_lower", "solve_upper"]

FACTOR = (("ptr", "factor"), ("i64", "size"), ("ptr", "rows"), ("i64", "count"))


def cholesky(matrix: Float) -> Float | None:
    """The lower factor L of a symmetric matrix, L L' = matrix; None where it is not positive definite.

    >>> cholesky(np.array([[4.0, 2.0], [2.0, 2.0]]))
    array([[2., 0.],
           [1., 1.]])
    """
    try:
        return np.asarray(_upper(matrix).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        return None


def _upper(matrix: Float) -> Float:
    """The upper factor, its columns in memory one after the other, as LAPACK leaves it.

    `np.linalg.cholesky` transposes on the way in and out, which takes longer than the factorisation; its kernel does
    not if it is given such arrays.
    """
    kernel = getattr(getattr(np.linalg, "_umath_linalg", None), "cholesky_up", None)
    if kernel is None:
        return np.asarray(np.linalg.cholesky(matrix).T, dtype=np.float64)
    upper = np.empty(matrix.shape, order="F")
    with np.errstate(invalid="ignore"):
        kernel(matrix.T, upper, signature="d->d")
    if upper.size and not np.isfinite(upper[-1, -1]):
        raise np.linalg.LinAlgError
    return upper


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
