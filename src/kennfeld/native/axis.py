"""Native functions along an axis, compiled once for all models: the cell that holds a coordinate, a smoothed window."""

import math

from kennfeld.graph.interpolation import WINDOW
from kennfeld.native.engine import Shared
from kennfeld.native.ir import Function, literal
from kennfeld.native.library import call_elementary

__all__ = ["SEARCH", "SMOOTH"]

ONE, ZERO, HALF = literal(1.0), literal(0.0), literal(0.5)


def _search() -> Function:
    """`search(breakpoints, count, x, result)`: the cell that holds x, by bisection; 0 for NaN."""
    f = Function("search", [("ptr", "points"), ("i64", "count"), ("double", "x"), ("ptr", "result")])
    low, high = f.slot("i64"), f.slot("i64")
    f.store("0", low, kind="i64")
    f.store(f.add("%count", -1), high, kind="i64")
    with f.loop(0, 64):
        a, b = f.load(low, kind="i64"), f.load(high, kind="i64")
        middle = f.new(f"lshr i64 {f.add(a, b)}, 1")
        open_ = f.new(f"icmp ugt i64 {f.new(f'sub i64 {b}, {a}')}, 1")
        with f.when(open_):
            right = f.new(f"fcmp oge double %x, {f.load('%points', middle)}")
            f.store(f.new(f"select i1 {right}, i64 {middle}, i64 {a}"), low, kind="i64")
            f.store(f.new(f"select i1 {right}, i64 {b}, i64 {middle}"), high, kind="i64")
    f.store(f.load(low, kind="i64"), "%result", kind="i64")
    return f


def _smooth() -> Function:
    """`smooth(points, count, x, width, linear, weights, slopes, bounds)`: the window around x."""
    f = Function(
        "smooth",
        [
            *(("ptr", "points"), ("i64", "count"), ("double", "x"), ("double", "width"), ("i1", "linear")),
            *(("ptr", "weights"), ("ptr", "slopes"), ("ptr", "bounds")),
        ],
    )
    reach = f.fmul("%width", literal(WINDOW))
    cells = f.slot("i64", 2)
    for which, edge in enumerate(("fsub", "fadd")):
        x = f.new(f"{edge} double %x, {reach}")
        f.do(f"call void @search(ptr %points, i64 %count, double {x}, ptr {f.at(cells, which, 'i64')})")
    first, last = f.load(cells, 0, "i64"), f.load(cells, 1, "i64")
    f.store(first, "%bounds", 0, "i64")
    f.store(f.add(last, 2), "%bounds", 1, "i64")
    before = f.slot("double", 4)  # ramp and rise at the left end; share and its slope of the interval before
    ramp, rise = _ramp(f, first)
    for at, value in enumerate((ramp, rise, ONE, ZERO)):
        f.store(value, before, at)
    with f.loop(first, f.add(last, 1)) as cell:
        right = f.add(cell, 1)
        ends = _ramp(f, right)
        gap = f.new(f"fsub double {f.load('%points', right)}, {f.load('%points', cell)}")
        for at, (end, into) in enumerate(zip(ends, ("%weights", "%slopes"), strict=True)):
            climbed = f.new(f"fsub double {f.load(before, at)}, {end}")
            share = f.new(f"fdiv double {climbed}, {gap}")
            f.store(f.new(f"fsub double {f.load(before, at + 2)}, {share}"), into, cell)
            f.store(share, into, right)
            f.store(end, before, at)
            f.store(share, before, at + 2)
    return f


def _ramp(f: Function, point: str) -> tuple[str, str]:
    """The smoothed ramp that starts at a breakpoint, and its slope; with linear extrapolation the ends do not bend."""
    t = f.new(f"fsub double %x, {f.load('%points', point)}")
    u = f.new(f"fdiv double {t}, %width")
    share = f.fmul(HALF, call_elementary(f, "erfc", [f.fmul(u, literal(-(0.5**0.5)))]))
    bell = call_elementary(f, "exp", [f.fmul(f.fmul(u, u), literal(-0.5))])
    bend = f.fmul(f.fmul(bell, literal(1 / math.sqrt(2 * math.pi))), "%width")
    soft = f.new(f"fadd double {f.fmul(t, share)}, {bend}")
    above = f.new(f"fcmp ogt double {u}, {ZERO}")
    near = f.new(f"fcmp ult double {f.new(f'call double @llvm.fabs.f64(double {u})')}, {literal(WINDOW)}")
    ramp = f.select(near, soft, f.select(above, t, ZERO))
    rise = f.select(near, share, f.select(above, ONE, ZERO))
    for edge, straight in (("0", (t, ONE)), (f.add("%count", -1), (ZERO, ZERO))):
        at_edge = f.new(f"and i1 %linear, {f.new(f'icmp eq i64 {point}, {edge}')}")
        ramp, rise = f.select(at_edge, straight[0], ramp), f.select(at_edge, straight[1], rise)
    return ramp, rise


SEARCH = Shared("search", lambda: _search().text())
SMOOTH = Shared("smooth", lambda: _search().text() + _smooth().text())
