"""LLVM IR of table lookups: search in an axis, weights of the grid points, value and slopes.

A lookup is a list of sides, one an axis. A side knows the weights of the grid points around the coordinate: the two
ends of a cell, or, for a smoothed axis, a window of weights computed at run time.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kennfeld.graph.interpolation import WINDOW
from kennfeld.native.ir import Function, literal

__all__ = ["Cell", "Corner", "Window", "corners", "find_cell", "search_function", "smooth_function", "smooth_window"]

ONE, ZERO, HALF = literal(1.0), literal(0.0), literal(0.5)


@dataclass(frozen=True)
class Cell:
    """A cell of an axis: its first grid point (i64) and the fraction of the way to the second."""

    index: str
    fraction: str
    single: bool = False  # an axis of one breakpoint

    def weights(self, f: Function) -> list[tuple[str, str]]:
        """(grid point, weight) pairs."""
        if self.single:
            return [(self.index, f.fadd(ONE, f.fmul(self.fraction, ZERO)))]
        rest = f.new(f"fsub double {ONE}, {self.fraction}")
        return [(self.index, rest), (f.add(self.index, 1), self.fraction)]

    def slopes(self, f: Function) -> list[tuple[str, str]]:
        """(grid point, slope of the weight) pairs."""
        if self.single:
            return [(self.index, ZERO)]
        return [(self.index, literal(-1.0)), (f.add(self.index, 1), ONE)]


@dataclass(frozen=True)
class Window:
    """The grid points `start` to before `end` of a smoothed axis, with arrays of weights and slopes by grid point."""

    start: str
    end: str
    weight: str
    slope: str


@dataclass(frozen=True)
class Corner:
    """A grid point of a table: its flat index and its weight."""

    index: str
    weight: str


def search_function() -> str:
    """`kf_search(breakpoints, count, x, result)`: the cell that holds x, 0 for NaN.

    Bisection by selects: which half it is cannot be foretold, and a branch foretold wrongly costs more than the rest.
    """
    f = Function("kf_search", [("ptr", "points"), ("i64", "count"), ("double", "x"), ("ptr", "result")], "noinline")
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
    return f.text()


def find_cell(f: Function, x: str, points: str, count: int, hint: str) -> tuple[str, str, str]:
    """Cell, x minus its left end, and its width. `hint` remembers the cell, as the next sample is mostly near."""
    guess = f.load(hint, kind="i64")
    inside = f.new(
        f"and i1 {f.new(f'fcmp oge double {x}, {f.load(points, guess)}')}, "
        f"{f.new(f'fcmp olt double {x}, {f.load(points, f.add(guess, 1))}')}"
    )
    with f.when(f.new(f"xor i1 {inside}, true")):
        f.do(f"call void @kf_search(ptr {points}, i64 {count}, double {x}, ptr {hint})")
    cell = f.load(hint, kind="i64")
    left = f.load(points, cell)
    right = f.load(points, f.add(cell, 1))
    return cell, f.new(f"fsub double {x}, {left}"), f.new(f"fsub double {right}, {left}")


def corners(
    f: Function, sides: Sequence[Cell | Window], strides: Sequence[int], slope: int | None = None
) -> Iterator[Corner]:
    """Emit the body once for each grid point around the coordinate, `slope` naming the axis to differentiate along.

    Cells are unrolled; windows become loops around the rest, so a body is emitted 2^cells times.
    """
    yield from _walk(f, list(zip(sides, strides, strict=True)), slope, "0", "")


def _walk(
    f: Function, sides: list[tuple[Cell | Window, int]], slope: int | None, index: str, weight: str
) -> Iterator[Corner]:
    if not sides:
        yield Corner(index, weight or ONE)
        return
    (side, stride), rest = sides[0], sides[1:]
    along = slope == 0
    deeper = None if slope is None else slope - 1

    def step(point: str, factor: str) -> Iterator[Corner]:
        offset = f.mul(point, stride)
        at = offset if index == "0" else f.add(index, offset)
        yield from _walk(f, rest, deeper, at, f.fmul(weight, factor) if weight else factor)

    if isinstance(side, Cell):
        for point, factor in side.slopes(f) if along else side.weights(f):
            yield from step(point, factor)
    else:
        with f.loop(side.start, side.end) as point:
            yield from step(point, f.load(side.slope if along else side.weight, point))


def smooth_window(f: Function, x: str, points: str, count: int, width: str, linear: bool) -> Window:
    """Weights of a smoothed axis: differences of the ramps t Phi(t/s) + s phi(t/s), see graph.interpolation."""
    weight, slope = f.slot("double", count), f.slot("double", count)
    bounds = f.slot("i64", 2)
    f.do(
        f"call void @kf_smooth(ptr {points}, i64 {count}, double {x}, double {width}, "
        f"i1 {'true' if linear else 'false'}, ptr {weight}, ptr {slope}, ptr {bounds})"
    )
    return Window(f.load(bounds, 0, "i64"), f.load(bounds, 1, "i64"), weight, slope)


def smooth_function() -> str:
    """`kf_smooth(points, count, x, width, linear, weights, slopes, bounds)`: the window around x."""
    f = Function(
        "kf_smooth",
        [
            *(("ptr", "points"), ("i64", "count"), ("double", "x"), ("double", "width"), ("i1", "linear")),
            *(("ptr", "weights"), ("ptr", "slopes"), ("ptr", "bounds")),
        ],
        "noinline",
    )
    reach = f.fmul("%width", literal(WINDOW))
    cells = f.slot("i64", 2)
    for which, edge in enumerate(("fsub", "fadd")):
        x = f.new(f"{edge} double %x, {reach}")
        f.do(f"call void @kf_search(ptr %points, i64 %count, double {x}, ptr {f.at(cells, which, 'i64')})")
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
    return f.text()


def _ramp(f: Function, point: str) -> tuple[str, str]:
    """The smoothed ramp that starts at a breakpoint, and its slope; with linear extrapolation the ends do not bend."""
    t = f.new(f"fsub double %x, {f.load('%points', point)}")
    u = f.new(f"fdiv double {t}, %width")
    share = f.fmul(HALF, f.new(f"call double @kf_erfc(double {f.fmul(u, literal(-(0.5**0.5)))})"))
    bell = f.new(f"call double @kf_exp(double {f.fmul(f.fmul(u, u), literal(-0.5))})")
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
