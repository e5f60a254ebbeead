"""LLVM IR of table lookups: search in an axis, weights of the grid points around a coordinate, value and slopes.

A lookup has one side per axis, with the weights of the grid points around the coordinate: the two ends of a cell, or,
for a smoothed axis, a window of weights computed at run time. Smoothed interpolation is a sum of ramps that start at
the breakpoints, each convolved with a Gaussian of width s: t Phi(t/s) + s phi(t/s), with the distance t from its start
(see `graph.interpolation`). Eight breakpoints are processed at once, so exponential and normal distribution are
polynomials here and not calls of the C library. Search and window do not depend on the model and are compiled once.
"""

import math
from collections.abc import Iterator, Sequence

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.engine import shared_function
from kennfeld.base.machine_code.ir import EIGHT, LANES, ONE, ZERO, FunctionWriter, Vector, literal
from kennfeld.graph.interpolation import WINDOW

# Mills' ratio Phi(-u) / phi(u) for u from 0 to WINDOW, in powers of 4 u / (u + 4) - 1: its Chebyshev
# interpolation, with a relative error below 4e-15.
MILLS = (
    0.5561318102321344, -0.4595394127830946, 0.18100646836287246, -0.048344499212807424, 0.007933386537335673,
    -0.00046067444416927016, -8.995610227853174e-05, 1.4024624692044922e-05, 1.5985834895680192e-06,
    -3.2145155088911404e-07, -4.9235535075000134e-08, 6.10772273712855e-09, 1.7883197305282796e-09,
    -4.176163905641845e-11, -5.180767946561654e-11,
)  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """A cell of an axis: its first grid point (i64) and the fraction of the way to the second."""

    index: str
    fraction: str
    single: bool = False  # an axis of one breakpoint

    def weights(self, f: FunctionWriter) -> list[tuple[str, str]]:
        """Return (grid point, weight) pairs."""
        if self.single:
            # 1, or NaN where the coordinate is
            return [(self.index, f.fadd(ONE, f.fmul(self.fraction, ZERO)))]
        rest = f.new(f"fsub double {ONE}, {self.fraction}")
        return [(self.index, rest), (f.add(self.index, 1), self.fraction)]

    def slopes(self, f: FunctionWriter) -> list[tuple[str, str]]:
        """Return (grid point, slope of the weight) pairs."""
        if self.single:
            return [(self.index, ZERO)]
        return [(self.index, literal(-1.0)), (f.add(self.index, 1), ONE)]


@dataclass(frozen=True)
class Window:
    """The grid points from `start` to before `end` of a smoothed axis, with their weights and slopes."""

    start: str
    end: str
    weight: str
    slope: str


@dataclass(frozen=True)
class Corner:
    """A grid point of a table: its flat index and its weight."""

    index: str
    weight: str


def find_cell(f: FunctionWriter, x: str, points: str, count: int, hint: str) -> tuple[str, str, str]:
    """Return the cell, x minus its left end, and its width. `hint` stores the cell, since the next x is mostly near."""
    guess = f.load(hint, kind="i64")
    # NaN fails both comparisons, and the search puts it into cell 0
    after = f.new(f"fcmp oge double {x}, {f.load(points, guess)}")
    before = f.new(f"fcmp olt double {x}, {f.load(points, f.add(guess, 1))}")
    with f.unless(after, before):
        f.do(f"call void {SEARCH.pointer(f)}(ptr {points}, i64 {count}, double {x}, ptr {hint})")
    cell = f.load(hint, kind="i64")
    left = f.load(points, cell)
    right = f.load(points, f.add(cell, 1))
    return cell, f.new(f"fsub double {x}, {left}"), f.new(f"fsub double {right}, {left}")


def corners(
    f: FunctionWriter,
    sides: Sequence[Cell | Window],
    strides: Sequence[int],
    slope: int | None = None,
    before: Corner | None = None,
) -> Iterator[Corner]:
    """Emit the body for each grid point around the coordinate; `slope` is the axis to differentiate along.

    Cells are unrolled; windows become loops around the rest, so a body is emitted 2^cells times. `before` is the part
    of the index and the weight from earlier axes.
    """
    if not sides:
        yield before or Corner("0", ONE)
        return
    # slope counts the axes that remain up to the one to differentiate along
    side, along = sides[0], slope == 0

    def step(point: str, factor: str) -> Iterator[Corner]:
        offset = f.mul(point, strides[0])
        corner = Corner(offset, factor)
        if before is not None:
            index = offset if before.index == "0" else f.add(before.index, offset)
            corner = Corner(index, f.fmul(before.weight, factor))
        yield from corners(f, sides[1:], strides[1:], None if slope is None else slope - 1, corner)

    if isinstance(side, Cell):
        for point, factor in side.slopes(f) if along else side.weights(f):
            yield from step(point, factor)
    else:
        with f.loop(side.start, side.end) as point:
            yield from step(point, f.load(side.slope if along else side.weight, point))


def smooth_window(f: FunctionWriter, x: str, points: str, count: int, width: str, linear: bool) -> Window:
    """Return the window of weights of a smoothed axis around x."""
    weight, slope = f.slot("double", count + LANES), f.slot("double", count + LANES)
    bounds = f.slot("i64", 2)
    numbers = f"ptr {points}, i64 {count}, double {x}, double {width}, i1 {'true' if linear else 'false'}"
    f.do(f"call void {SMOOTH.pointer(f)}({numbers}, ptr {weight}, ptr {slope}, ptr {bounds})")
    return Window(f.load(bounds, 0, "i64"), f.load(bounds, 1, "i64"), weight, slope)


def _smooth() -> FunctionWriter:
    """Write `smooth(points, count, x, width, linear, weights, slopes, bounds)`: the window around x.

    `points`, `weights` and `slopes` have room for `LANES` more.
    """
    numbers = (("ptr", "points"), ("i64", "count"), ("double", "x"), ("double", "width"), ("i1", "linear"))
    f = FunctionWriter(
        "smooth", [*numbers, ("ptr", "weights"), ("ptr", "slopes"), ("ptr", "bounds")], before=_search().text()
    )
    # from the cell of x - 4 s to the end of that of x + 4 s; outside, all ramps are either 0 or x minus their start
    reach = f.fmul("%width", literal(WINDOW))
    cells = f.slot("i64", 2)
    for which, edge in enumerate(("fsub", "fadd")):
        x = f.new(f"{edge} double %x, {reach}")
        f.do(f"call void @search(ptr %points, i64 %count, double {x}, ptr {f.at(cells, which, 'i64')})")
    first, last = f.load(cells, 0, "i64"), f.load(cells, 1, "i64")
    end = f.add(last, 2)
    f.store(first, "%bounds", 0, "i64")
    f.store(end, "%bounds", 1, "i64")
    _ramps(f, first, end)
    with f.when("%linear"):
        _straight_ends(f)
    _differences(f, first, end)
    return f


def _ramps(f: FunctionWriter, first: str, end: str) -> None:
    """Write the smoothed ramp that starts at each breakpoint to the weights, its slope to the slopes."""
    # a width of 0 makes the distances infinite, so that each ramp is the exact one
    positive = f.new(f"call double @llvm.maxnum.f64(double %width, double {literal(1e-300)})")
    inverse = f.new(f"fdiv double {ONE}, {positive}")
    v = Vector(f)
    all_x, all_inverse, all_width = v.splat("%x"), v.splat(inverse), v.splat("%width")
    groups = f.new(f"sdiv i64 {f.add(f.new(f'sub i64 {end}, {first}'), LANES - 1)}, {LANES}")
    with f.loop(0, groups) as group:
        place = f.add(first, f.mul(group, LANES))
        t = v("fsub", all_x, v.load("%points", place))
        ramp, rise = _ramp(v, t, v("fmul", t, all_inverse), all_width)
        v.store(ramp, "%weights", place)
        v.store(rise, "%slopes", place)


def _ramp(v: Vector, t: str, u: str, width: str) -> tuple[str, str]:
    """Return smoothed ramps and their slopes at distances t = u width from their start."""
    above, below = v.compare("oge", u, WINDOW), v.compare("ole", u, -WINDOW)
    # within the range of the polynomial and of the exponential; what lies outside is replaced below
    u = v.where(above, v.all(WINDOW), v.where(below, v.all(-WINDOW), u))
    # Phi(-|u|) = phi(u) Mills(|u|) and Phi(|u|) = 1 - Phi(-|u|); then the ramp is t Phi(u) + s phi(u)
    size = v.f.new(f"call {EIGHT} @llvm.fabs.v8f64({EIGHT} {u})")
    density = v("fmul", v.exp(v("fmul", v("fmul", u, u), v.all(-0.5))), v.all(1 / math.sqrt(2 * math.pi)))
    mapped = v("fsub", v("fdiv", v("fmul", size, v.all(4.0)), v("fadd", size, v.all(4.0))), v.all(1.0))
    tail = v("fmul", density, v.polynomial(mapped, MILLS))
    share = v.where(v.compare("ogt", u, 0.0), v("fsub", v.all(1.0), tail), tail)
    soft = v("fadd", v("fmul", t, share), v("fmul", density, width))
    zero, one = v.all(0.0), v.all(1.0)
    return v.where(above, t, v.where(below, zero, soft)), v.where(above, one, v.where(below, zero, share))


def _straight_ends(f: FunctionWriter) -> None:
    """Extend the first and last cell linearly: with linear extrapolation the ends have no kink."""
    # the ramps that start at the ends are exact: x minus the first breakpoint, and nothing at the last one
    last = f.add("%count", -1)
    f.store(f.new(f"fsub double %x, {f.load('%points')}"), "%weights")
    f.store(ONE, "%slopes")
    f.store(ZERO, "%weights", last)
    f.store(ZERO, "%slopes", last)


def _differences(f: FunctionWriter, first: str, end: str) -> None:
    """Convert ramps to weights in place: the fraction passed before a grid point minus that after it."""
    arrays = ("%weights", "%slopes")
    previous = f.slot("double", 4)  # ramp and its slope at the left end; share and its slope of the interval before
    # before the window, each interval has been passed as a whole
    for at, (array, before) in enumerate(zip(arrays, (1.0, 0.0), strict=True)):
        f.store(f.load(array, first), previous, at)
        f.store(literal(before), previous, at + 2)
    with f.loop(first, f.add(end, -1)) as cell:
        right = f.add(cell, 1)
        # share passed of interval i = (ramp[i] - ramp[i + 1]) / gap, and weight[i] = share[i - 1] - share[i];
        # in place: the ramp at the right end is read before the share is kept there for the next interval
        gap = f.new(f"fsub double {f.load('%points', right)}, {f.load('%points', cell)}")
        for at, array in enumerate(arrays):
            ramp = f.load(array, right)
            share = f.new(f"fdiv double {f.new(f'fsub double {f.load(previous, at)}, {ramp}')}, {gap}")
            f.store(f.new(f"fsub double {f.load(previous, at + 2)}, {share}"), array, cell)
            f.store(share, array, right)
            f.store(ramp, previous, at)
            f.store(share, previous, at + 2)


def _search() -> FunctionWriter:
    """Write `search(breakpoints, count, x, result)`: the cell that holds x, 0 for NaN.

    Bisection by selects: the branch would be unpredictable, and a misprediction costs more than the rest.
    """
    f = FunctionWriter("search", [("ptr", "points"), ("i64", "count"), ("double", "x"), ("ptr", "result")])
    # the cell is one of cells - excluded ones from `low` on; the number of steps does not depend on x
    cells, low = f.add("%count", -1), f.variable("i64", "0")
    with f.walk(f.add("%count", -2)) as (excluded, position):
        half = f.new(f"lshr i64 {f.new(f'sub i64 {cells}, {excluded}')}, 1")
        left = low.get()
        middle = f.add(left, half)
        right = f.new(f"fcmp oge double %x, {f.load('%points', middle)}")
        low.set(f.new(f"select i1 {right}, i64 {middle}, i64 {left}"))
        position.set(f.add(excluded, half))
    f.store(low.get(), "%result", kind="i64")
    return f


SEARCH, SMOOTH = shared_function(_search), shared_function(_smooth)
