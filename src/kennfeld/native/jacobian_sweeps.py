"""Rows of the Jacobian where many states carry free values: loops over the states, past slopes that are zero.

Of the slopes between a hundred states most are zero in most models: only those that can differ from zero are looked
at. A state that takes over what another was, as in a shift register, takes over its row of S.
"""

from collections.abc import Sequence
from itertools import accumulate, chain

from kennfeld.native.ir import EIGHT, LANES, FunctionWriter, literal
from kennfeld.native.tape_layout import TapeLayout

__all__ = ["ManyStates", "add_combination", "many_tables"]

ZERO = literal(0.0)
STRIP = 4  # vectors of columns at a time: as many sums as hide the time that one takes


def many_tables(pattern: TapeLayout) -> str:
    """The constants that `ManyStates` reads."""
    latencies = pattern.latencies
    tables = {
        "bases": [0, *accumulate(latencies[:-1])],
        "latencies": latencies,
        "copies": [*chain.from_iterable(pattern.copies)],
        "kept": pattern.kept,
        "ends": [0, *accumulate(map(len, pattern.sources))],
        "sources": [*chain.from_iterable(pattern.sources)],
        "seen": [*chain.from_iterable(pattern.seen)],
    }
    return "".join(_table(name, numbers) for name, numbers in tables.items())


def _table(name: str, numbers: Sequence[int]) -> str:
    held = ", ".join(f"i32 {number}" for number in numbers)
    return f"@many_{name} = internal constant [{len(numbers)} x i32] [{held}]\n"


class ManyStates:
    """The sensitivities S of all states within one sample: a row of `%width` columns a state, in `%sensitivities`.

    A state of latency d has d rows there, of which `%rings` says the oldest. `%next` has room for the rows of the next
    sample.
    """

    def __init__(self, f: FunctionWriter, pattern: TapeLayout) -> None:
        self.f, self.pattern, self.count = f, pattern, pattern.carried
        self._rows, self._factors = f.slot("ptr", self.count), f.slot("double", self.count)

    def begin(self) -> None:
        """Find the rows of a sample."""
        f = self.f
        with f.loop(0, self.count) as i:
            place = f.add(f.load("%rings", i, "i64"), self._number("bases", i))
            f.store(f.at("%sensitivities", f.mul("%width", place)), self._rows, i, "ptr")

    def add_output(self, target: str, output: int, factor: str, slopes: str) -> None:
        """Target += factor times the row of S of an output; `slopes` points to its row of c."""
        f, seen = self.f, self.pattern.seen
        states = f.at("@many_seen", sum(map(len, seen[:output])), "i32")
        with f.loop(0, len(seen[output])) as i:
            state = f.new(f"sext i32 {f.load(states, i, 'i32')} to i64")
            f.store(f.fmul(factor, f.load(slopes, state)), self._factors, i)
        self._combine(target, states, self._factors, str(len(seen[output])))

    def step(self, slopes: str) -> None:
        """The next S without the entries' part; `slopes` points to the sample's cells of a."""
        f = self.f
        bytes_ = f.mul("%width", 8 * self.count)
        f.do(f"call void @llvm.memset.p0.i64(ptr %next, i8 0, i64 {bytes_}, i1 false)")
        with f.loop(0, len(self.pattern.copies)) as pair:
            first = f.mul(pair, 2)
            row, source = self._number("copies", first), self._number("copies", f.add(first, 1))
            self._copy(self._next(row), f.load(self._rows, source, "ptr"))
        with f.loop(0, len(self.pattern.kept)) as row:
            begin, end = self._number("ends", row), self._number("ends", f.add(row, 1))
            states, factors = f.at("@many_sources", begin, "i32"), f.at(slopes, begin)
            self._combine(self._next(self._number("kept", row)), states, factors, f.new(f"sub i64 {end}, {begin}"))

    def add_entry(self, column: str, slopes: str) -> None:
        """Add the slopes of the kept states with respect to one value."""
        f = self.f
        with f.loop(0, len(self.pattern.kept)) as row:
            f.increase(f.load(slopes, row), self._next(self._number("kept", row)), column)

    def turn(self) -> None:
        """Put the next rows in the place of the oldest, and move on to what is the oldest then."""
        f = self.f
        with f.loop(0, self.count) as i:
            self._copy(f.load(self._rows, i, "ptr"), self._next(i))
            following = f.add(f.load("%rings", i, "i64"), 1)
            wrapped = f.new(f"icmp eq i64 {following}, {self._number('latencies', i)}")
            f.store(f.new(f"select i1 {wrapped}, i64 0, i64 {following}"), "%rings", i, "i64")

    def _number(self, table: str, at: str) -> str:
        return self.f.new(f"sext i32 {self.f.load(f'@many_{table}', at, 'i32')} to i64")

    def _next(self, state: str) -> str:
        return self.f.at("%next", self.f.new(f"mul i64 {state}, %width"))

    def _copy(self, target: str, source: str) -> None:
        given = f"ptr {target}, ptr {source}, i64 {self.f.mul('%width', 8)}, i1 false"
        self.f.do(f"call void @llvm.memcpy.p0.p0.i64({given})")

    def _combine(self, target: str, states: str, factors: str, count: str) -> None:
        given = [("ptr", target), ("ptr", self._rows), ("ptr", states), ("ptr", factors), ("i64", count)]
        self.f.call("add_combination", [*given, ("i64", "%width")])


def add_combination(most: int) -> FunctionWriter:
    """`add_combination(target, rows, states, factors, count, width)`: adds factors[i] times the row of states[i].

    What is multiplied by zero does not count, even where it is not finite. `count` is `most` at most.
    """
    head = [("ptr noalias", "target"), ("ptr", "rows"), ("ptr", "states"), ("ptr", "factors")]
    f = FunctionWriter("add_combination", [*head, ("i64", "count"), ("i64", "width")], "noinline")
    picked, weights, number = f.slot("ptr", most), f.slot("double", most), f.slot("i64")
    f.store("0", number, kind="i64")
    with f.loop(0, "%count") as i:
        at, factor = f.load(number, kind="i64"), f.load("%factors", i)
        state = f.new(f"sext i32 {f.load('%states', i, 'i32')} to i64")
        f.store(f.load("%rows", state, "ptr"), picked, at, "ptr")
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


def _add(f: FunctionWriter, column: str, vectors: int, rows: str, weights: str, number: str) -> None:
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
