"""Rows of the Jacobian where many states carry free values: loops over the states, past factors that are zero.

Of the slopes between a hundred states most are zero in most models.
"""

from collections.abc import Sequence

from kennfeld.native.ir import EIGHT, LANES, Function, literal

__all__ = ["ManyStates", "add_combination"]

ZERO = literal(0.0)
STRIP = 4  # vectors of columns at a time: as many sums as hide the time that one takes


class ManyStates:
    """The sensitivities S of all states within one sample: a row of `%width` columns a state, at the pointers `rows`.

    `%next` has room for those of the next sample.
    """

    def __init__(self, f: Function, rows: Sequence[str]) -> None:
        self.f, self.count = f, len(rows)
        self._rows, self._factors = f.slot("ptr", len(rows)), f.slot("double", len(rows))
        for i, row in enumerate(rows):
            f.store(row, self._rows, i, "ptr")

    def add_output(self, target: str, factor: str, slopes: str) -> None:
        """Target += factor times `slopes`, a row of c, times S."""
        f = self.f
        with f.loop(0, self.count) as i:
            f.store(f.fmul(factor, f.load(slopes, i)), self._factors, i)
        self._combine(target, self._factors)

    def step(self, slopes: str) -> None:
        """The next S, `slopes` times S, without the entries' part; `slopes` points to the matrix a."""
        f = self.f
        bytes_ = f.mul("%width", 8 * self.count)
        f.do(f"call void @llvm.memset.p0.i64(ptr %next, i8 0, i64 {bytes_}, i1 false)")
        with f.loop(0, self.count) as i:
            self._combine(self._next(i), f.at(slopes, f.mul(i, self.count)))

    def add_entry(self, column: str, slopes: str) -> None:
        """Add the slopes of all states with respect to one value."""
        f = self.f
        with f.loop(0, self.count) as i:
            f.increase(f.load(slopes, i), self._next(i), column)

    def turn(self) -> None:
        """Put the next rows in the place of those of now."""
        f = self.f
        with f.loop(0, self.count) as i:
            given = f"ptr {f.load(self._rows, i, 'ptr')}, ptr {self._next(i)}, i64 {f.mul('%width', 8)}, i1 false"
            f.do(f"call void @llvm.memcpy.p0.p0.i64({given})")

    def _next(self, state: str) -> str:
        return self.f.at("%next", self.f.new(f"mul i64 {state}, %width"))

    def _combine(self, target: str, factors: str) -> None:
        given = [("ptr", target), ("ptr", self._rows), ("ptr", factors), ("i64", "%width")]
        self.f.call(_name(self.count), given)


def _name(count: int) -> str:
    return f"add_combination_{count}"


def add_combination(count: int) -> Function:
    """`add_combination_COUNT(target, rows, factors, width)`: target += sum of factors[i] times what rows[i] points to.

    What is multiplied by zero does not count, even where it is not finite.
    """
    head = [("ptr noalias", "target"), ("ptr", "rows"), ("ptr", "factors"), ("i64", "width")]
    f = Function(_name(count), head, "noinline")
    picked, weights, number = f.slot("ptr", count), f.slot("double", count), f.slot("i64")
    f.store("0", number, kind="i64")
    with f.loop(0, count) as i:
        at, factor = f.load(number, kind="i64"), f.load("%factors", i)
        f.store(f.load("%rows", i, "ptr"), picked, at, "ptr")
        f.store(factor, weights, at)
        counts = f.new(f"fcmp une double {factor}, {ZERO}")
        f.store(f.add(at, f.new(f"zext i1 {counts} to i64")), number, kind="i64")
    vectors = f.new(f"sdiv i64 %width, {LANES}")
    strips = f.new(f"sdiv i64 {vectors}, {STRIP}")
    with f.loop(0, strips) as strip:
        _add(f, f.mul(strip, STRIP * LANES), STRIP, picked, weights, number)
    with f.loop(f.mul(strips, STRIP), vectors) as vector:
        _add(f, f.mul(vector, LANES), 1, picked, weights, number)
    return f


def _add(f: Function, column: str, vectors: int, rows: str, weights: str, number: str) -> None:
    """The sums of some vectors of columns from `column` on."""
    columns = [f.add(column, i * LANES) for i in range(vectors)]
    sums = [f.slot(EIGHT) for _ in columns]
    for total, at in zip(sums, columns, strict=True):
        f.store(f.load(f.at("%target", at), kind=EIGHT), total, kind=EIGHT)
    with f.loop(0, f.load(number, kind="i64")) as i:
        row, weight = f.load(rows, i, "ptr"), f.splat(f.load(weights, i))
        for total, at in zip(sums, columns, strict=True):
            product = f.new(f"fmul contract {EIGHT} {weight}, {f.load(f.at(row, at), kind=EIGHT)}")
            f.store(f.new(f"fadd contract {EIGHT} {f.load(total, kind=EIGHT)}, {product}"), total, kind=EIGHT)
    for total, at in zip(sums, columns, strict=True):
        f.store(f.load(total, kind=EIGHT), f.at("%target", at), kind=EIGHT)
