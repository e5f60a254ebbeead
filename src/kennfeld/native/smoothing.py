"""LLVM IR of smoothed lookups: the weights of the grid points around a coordinate, and their slopes.

The interpolation along an axis is a sum of ramps that start at the breakpoints; convolved with a Gaussian of width s,
a ramp becomes t Phi(t/s) + s phi(t/s) (see graph.interpolation). Eight breakpoints are worked on at once, so the
exponential and the normal distribution are polynomials here and not calls of the C library.
"""

import math

from kennfeld.graph.interpolation import WINDOW
from kennfeld.native.ir import EIGHT, LANES, Function, literal
from kennfeld.native.vector import Vector

__all__ = ["smooth"]

# Mills' ratio Phi(-u) / phi(u) for u from 0 to WINDOW, in powers of 4 u / (u + 4) - 1: its Chebyshev
# interpolation, with a relative error below 4e-15.
MILLS = (
    0.5561318102321344, -0.4595394127830946, 0.18100646836287246, -0.048344499212807424, 0.007933386537335673,
    -0.00046067444416927016, -8.995610227853174e-05, 1.4024624692044922e-05, 1.5985834895680192e-06,
    -3.2145155088911404e-07, -4.9235535075000134e-08, 6.10772273712855e-09, 1.7883197305282796e-09,
    -4.176163905641845e-11, -5.180767946561654e-11,
)  # fmt: skip


def smooth() -> Function:
    """`smooth(points, count, x, width, linear, weights, slopes, bounds)`: the window around x.

    `points`, `weights` and `slopes` have room for `LANES` more.
    """
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
    end = f.add(last, 2)
    f.store(first, "%bounds", 0, "i64")
    f.store(end, "%bounds", 1, "i64")
    _ramps(f, first, end)
    with f.when("%linear"):
        _straight_ends(f)
    _differences(f, first, end)
    return f


def _ramps(f: Function, first: str, end: str) -> None:
    """The smoothed ramp that starts at each breakpoint into the weights, its slope into the slopes."""
    positive = f.new(f"call double @llvm.maxnum.f64(double %width, double {literal(1e-300)})")
    inverse = f.new(f"fdiv double {literal(1.0)}, {positive}")
    f_x, f_inverse, f_width = f.splat("%x"), f.splat(inverse), f.splat("%width")
    groups = f.new(f"sdiv i64 {f.add(f.new(f'sub i64 {end}, {first}'), LANES - 1)}, {LANES}")
    with f.loop(0, groups) as group:
        place = f.add(first, f.mul(group, LANES))
        v = Vector(f)
        t = v("fsub", f_x, f.load(f.at("%points", place), kind=EIGHT))
        ramp, rise = _ramp(v, t, v("fmul", t, f_inverse), f_width)
        f.store(ramp, f.at("%weights", place), kind=EIGHT)
        f.store(rise, f.at("%slopes", place), kind=EIGHT)


def _ramp(v: Vector, t: str, u: str, width: str) -> tuple[str, str]:
    """Smoothed ramps and their slopes at distances t = u width from their start."""
    above, below = v.compare("oge", u, WINDOW), v.compare("ole", u, -WINDOW)
    u = v.where(above, v.all(WINDOW), v.where(below, v.all(-WINDOW), u))
    size = v.f.new(f"call {EIGHT} @llvm.fabs.v8f64({EIGHT} {u})")
    bell = v("fmul", v.exp(v("fmul", v("fmul", u, u), v.all(-0.5))), v.all(1 / math.sqrt(2 * math.pi)))
    mapped = v("fsub", v("fdiv", v("fmul", size, v.all(4.0)), v("fadd", size, v.all(4.0))), v.all(1.0))
    tail = v("fmul", bell, v.polynomial(mapped, MILLS))
    share = v.where(v.compare("ogt", u, 0.0), v("fsub", v.all(1.0), tail), tail)
    soft = v("fadd", v("fmul", t, share), v("fmul", bell, width))
    zero, one = v.all(0.0), v.all(1.0)
    return v.where(above, t, v.where(below, zero, soft)), v.where(above, one, v.where(below, zero, share))


def _straight_ends(f: Function) -> None:
    """With linear extrapolation the lookup does not bend at its first and last breakpoint."""
    last = f.add("%count", -1)
    f.store(f.new(f"fsub double %x, {f.load('%points')}"), "%weights")
    f.store(literal(1.0), "%slopes")
    f.store(literal(0.0), "%weights", last)
    f.store(literal(0.0), "%slopes", last)


def _differences(f: Function, first: str, end: str) -> None:
    """Weights from ramps, in place: a grid point's weight is the share climbed before it less that after it."""
    arrays = ("%weights", "%slopes")
    climbed = f.slot("double", 4)  # ramp and its slope at the left end; share and its slope of the interval before
    for at, (array, before) in enumerate(zip(arrays, (1.0, 0.0), strict=True)):
        f.store(f.load(array, first), climbed, at)
        f.store(literal(before), climbed, at + 2)
    with f.loop(first, f.add(end, -1)) as cell:
        right = f.add(cell, 1)
        gap = f.new(f"fsub double {f.load('%points', right)}, {f.load('%points', cell)}")
        for at, array in enumerate(arrays):
            ramp = f.load(array, right)
            share = f.new(f"fdiv double {f.new(f'fsub double {f.load(climbed, at)}, {ramp}')}, {gap}")
            f.store(f.new(f"fsub double {f.load(climbed, at + 2)}, {share}"), array, cell)
            f.store(share, array, right)
            f.store(ramp, climbed, at)
            f.store(share, climbed, at + 2)
