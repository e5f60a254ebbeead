"""Native functions along an axis, compiled once for all models: the cell that holds a coordinate, a smoothed window."""

from kennfeld.native.engine import Shared
from kennfeld.native.ir import Function
from kennfeld.native.smoothing import smooth

__all__ = ["SEARCH", "SMOOTH"]


def _search() -> Function:
    """`search(breakpoints, count, x, result)`: the cell that holds x, 0 for NaN.

    Bisection by selects: which half it is cannot be foretold, and a branch foretold wrongly costs more than the rest.
    """
    f = Function("search", [("ptr", "points"), ("i64", "count"), ("double", "x"), ("ptr", "result")])
    cells, low = f.add("%count", -1), f.slot("i64")
    f.store("0", low, kind="i64")
    with f.walk(f.add("%count", -2)) as (excluded, position):
        half = f.new(f"lshr i64 {f.new(f'sub i64 {cells}, {excluded}')}, 1")
        left = f.load(low, kind="i64")
        middle = f.add(left, half)
        right = f.new(f"fcmp oge double %x, {f.load('%points', middle)}")
        f.store(f.new(f"select i1 {right}, i64 {middle}, i64 {left}"), low, kind="i64")
        f.store(f.add(excluded, half), position, kind="i64")
    f.store(f.load(low, kind="i64"), "%result", kind="i64")
    return f


SEARCH = Shared("search", lambda: _search().text())
SMOOTH = Shared("smooth", lambda: _search().text() + smooth().text())
