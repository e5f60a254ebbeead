"""Sensitivities of many states: S[k+1] = A[k] S[k] + B[k] by loops over the states that skip structural zeros of A.

S [states, width] are the derivatives of the states with respect to the columns that can reach a state. Of the slopes
between a hundred states most are structural zeros in most models: only the others are read. If a state takes over the
previous value of another one, as in a shift register, it takes over its row of S.
"""

from collections.abc import Sequence
from itertools import accumulate, chain

from kennfeld.native.ir import EIGHT, LANES, FunctionWriter, literal
from kennfeld.native.tape_layout import TapeLayout

ZERO = literal(0.0)
STRIP = 4  # vectors of columns at a time: as many sums as hide the time that one takes


def many_tables(pattern: TapeLayout) -> str:
    """Return the constants that `ManyStates` reads."""
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
    """The sensitivities S of all states within one sample, in `%sensitivities`: rows of `%width` columns.

    A state of latency d has d rows, of which `%rings` gives the oldest. `%next` has room for the rows of the next
    sample.
    """

    def __init__(self, f: FunctionWriter, pattern: TapeLayout) -> None:
        self.f, self.pattern, self.count = f, pattern, pattern.carried
        self._rows, self._factors = f.slot("ptr", self.count), f.slot("double", self.count)

    def begin(self) -> None:
        """Locate the rows of a sample."""
        f = self.f
        with f.loop(0, self.count) as i:
            place = f.add(f.load("%rings", i, "i64"), self._number("bases", i))
            f.store(f.at("%sensitivities", f.mul("%width", place)), self._rows, i, "ptr")

    def add_output(self, target: str, output: int, factor: str, slopes: str) -> None:
        """Add factor times the row of S of an output to the target, C S; `slopes` points to its row of c."""
        f, seen = self.f, self.pattern.seen
        states = f.at("@many_seen", sum(map(len, seen[:output])), "i32")
        with f.loop(0, len(seen[output])) as i:
            state = f.new(f"sext i32 {f.load(states, i, 'i32')} to i64")
            f.store(f.fmul(factor, f.load(slopes, state)), self._factors, i)
        self._combine(target, states, self._factors, str(len(seen[output])))

    def step(self, slopes: str) -> None:
        """Compute A S, the next S without the entries' part; `slopes` points to the sample's cells of a."""
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
        """Add B, the slopes of the kept states with respect to one value."""
        f = self.f
        with f.loop(0, len(self.pattern.kept)) as row:
            f.increase(f.load(slopes, row), self._next(self._number("kept", row)), column)

    def turn(self) -> None:
        """Replace the oldest rows by the next ones, and advance the rings."""
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
        arguments = f"ptr {target}, ptr {source}, i64 {self.f.mul('%width', 8)}, i1 false"
        self.f.do(f"call void @llvm.memcpy.p0.p0.i64({arguments})")

    def _combine(self, target: str, states: str, factors: str, count: str) -> None:
        arguments = [("ptr", target), ("ptr", self._rows), ("ptr", states), ("ptr", factors), ("i64", count)]
        self.f.call("add_combination", [*arguments, ("i64", "%width")])


def add_combination(most: int) -> FunctionWriter:
    """Write `add_combination(target, rows, states, factors, count, width)`: target += factors[i] times the row of
    states[i].

    Rows multiplied by zero are skipped, even if not finite. `count` is at most `most`.
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
    """Write the sums of some vectors of columns from `column` on."""
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
