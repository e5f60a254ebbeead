"""LLVM IR of table lookups: weights of the grid points around a coordinate, value and slopes.

A lookup is a list of sides, one an axis. A side knows the weights of the grid points around the coordinate: the two
ends of a cell, or, for a smoothed axis, a window of weights computed at run time (see `smoothing`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from kennfeld.native.axis import SEARCH, SMOOTH
from kennfeld.native.ir import LANES, Function, literal

__all__ = ["Cell", "Corner", "Window", "corners", "find_cell", "smooth_window"]

ONE, ZERO = literal(1.0), literal(0.0)


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


def find_cell(f: Function, x: str, points: str, count: int, hint: str) -> tuple[str, str, str]:
    """Cell, x minus its left end, and its width. `hint` remembers the cell, as the next sample is mostly near."""
    guess = f.load(hint, kind="i64")
    after = f.new(f"fcmp oge double {x}, {f.load(points, guess)}")
    before = f.new(f"fcmp olt double {x}, {f.load(points, f.add(guess, 1))}")
    with f.unless(after, before):
        f.do(f"call void {SEARCH}(ptr {points}, i64 {count}, double {x}, ptr {hint})")
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
    """The window of weights of a smoothed axis around x."""
    weight, slope = f.slot("double", count + LANES), f.slot("double", count + LANES)
    bounds = f.slot("i64", 2)
    f.do(
        f"call void {SMOOTH}(ptr {points}, i64 {count}, double {x}, double {width}, "
        f"i1 {'true' if linear else 'false'}, ptr {weight}, ptr {slope}, ptr {bounds})"
    )
    return Window(f.load(bounds, 0, "i64"), f.load(bounds, 1, "i64"), weight, slope)
