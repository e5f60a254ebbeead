"""Native functions along an axis, compiled once for all models: the cell that holds a coordinate, a smoothed window."""

import threading
from functools import cache
from typing import Literal

from kennfeld.native.engine import Engine
from kennfeld.native.ir import Function
from kennfeld.native.smoothing import smooth

__all__ = ["axis_function"]

_compiling = threading.Lock()  # or two threads would both compile, and one of the engines would go


def axis_function(name: Literal["search", "smooth"]) -> str:
    """A function of this module as generated code calls it."""
    with _compiling:
        return f"inttoptr (i64 {_engine(name).address(name)} to ptr)"


@cache
def _engine(name: str) -> Engine:
    return Engine(_search().text() + (smooth().text() if name == "smooth" else ""))


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
