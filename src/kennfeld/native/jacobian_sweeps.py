"""Rows of the Jacobian from a tape, with the sensitivities S carried over the samples.

    J[k] = C[k] S[k] + D[k],    S[k+1] = A[k] S[k] + B[k]

S [states, width] are the derivatives of the states with respect to the columns that can reach a state. A state of
latency d has d rows of S in a ring buffer. For few states, the code is unrolled. For many, it loops over the states: of
the slopes between a hundred states most are structural zeros in most models, and only the others are read. If a state
takes over the previous value of another one, as in a shift register, it takes over its row of S.
"""

from contextlib import AbstractContextManager
from itertools import accumulate, chain

from kennfeld.base.machine_code.ir import EIGHT, LANES, ZERO, FunctionWriter, Vector, integer_table
from kennfeld.native.tape_layout import MANY, TapeLayout
from kennfeld.native.tape_reader import ENTRIES, Rows, TapeEntries, dot, load_row, reaching, times, whole_width

STRIP = 4  # vectors of columns at a time: as many sums as hide the time that one takes


def rows_functions(pattern: TapeLayout) -> list[FunctionWriter]:
    """Write `rows(length, weight, c, a, sensitivities, width, rings, next, entries, jacobian, columns)`.

        jacobian[k] = sqrt(W) (C S[k] + D)

    `rings[i]` is the index of the oldest row of S of state i; `next` has room for the rows of the next sample.
    """
    m, n = pattern.outputs, pattern.carried
    names = ("weight", "c", "a", "sensitivities")
    head = [("i64", "length"), *(("ptr", name) for name in names), ("i64", "width"), ("ptr", "rings"), ("ptr", "next")]
    f = FunctionWriter("rows", [*head, *ENTRIES, ("ptr", "jacobian"), ("i64", "columns")])
    states = _ManyStates(f, pattern) if n > MANY else _FewStates(f, pattern)
    with f.loop(0, "%length") as k:
        roots = [f.new(f"call double @llvm.sqrt.f64(double {w})") for w in load_row(f, "%weight", k, m)]
        out = [f.at("%jacobian", f.mul(f.add(f.mul(k, m), o), "%columns")) for o in range(m)]
        states.begin(k)
        for o in range(m):
            with f.loop(0, "%columns") as j:
                f.store(ZERO, out[o], j)
            states.add_output(out[o], o, roots[o])
        states.step()
        entries = TapeEntries(f, k, pattern.rows)
        with f.loop(0, entries.count) as e:
            column, slopes = entries.column(e), entries.slopes(e)
            for o in range(m):
                f.increase(f.fmul(roots[o], f.load(slopes, o)), out[o], column)
            with reaching(f, column):
                states.add_entry(column, f.at(slopes, m))
        # last: rows of S are replaced once all sums of this sample have read them
        states.turn()
    return [add_combination(n, many_tables(pattern)), f] if n > MANY else [f]


class _FewStates:
    """The sensitivities S of all states within one sample, unrolled."""

    def __init__(self, f: FunctionWriter, pattern: TapeLayout) -> None:
        self.f, self.pattern = f, pattern

    def begin(self, k: str) -> None:
        """Locate the rows of S and load C and A of sample k."""
        f, n, latencies = self.f, self.pattern.carried, self.pattern.latencies
        # the oldest row in the ring of a state is its S now; the rings follow each other
        places = [f.add(f.load("%rings", i, "i64"), sum(latencies[:i])) for i in range(n)]
        self._rows = [f.at("%sensitivities", f.mul("%width", place)) for place in places]
        self._next = [f.at("%next", f.mul("%width", i)) for i in range(n)]
        self._c = load_row(f, "%c", k, self.pattern.outputs * n, self.pattern.c)
        self._a = load_row(f, "%a", k, n * n, self.pattern.a)

    def add_output(self, target: str, output: int, factor: str) -> None:
        """Add factor times the row of C S of an output to the target."""
        n = self.pattern.carried
        factors = [times(self.f, factor, c) for c in self._c[output * n : output * n + n]]
        # an output that sees no state needs no loop
        if any(c != ZERO for c in factors):
            with self._each_column() as j:
                self.f.increase(dot(self.f, factors, self._load(j)), target, j)

    def step(self) -> None:
        """Compute A S, the next S without the entries' part."""
        f, n = self.f, self.pattern.carried
        with self._each_column() as j:
            old = self._load(j)
            for i, row in enumerate(self._next):
                f.store(dot(f, self._a[i * n : i * n + n], old), row, j)

    def add_entry(self, column: str, slopes: str) -> None:
        """Add B, the slopes of the states with respect to one value."""
        for i, row in enumerate(self._next):
            self.f.increase(self.f.load(slopes, i), row, column)

    def turn(self) -> None:
        """Replace the oldest rows by the next ones, and advance the rings."""
        f = self.f
        for row, following in zip(self._rows, self._next, strict=True):
            with self._each_column() as j:
                f.store(f.load(following, j), row, j)
        for i, latency in enumerate(self.pattern.latencies):
            if latency > 1:
                f.advance("%rings", i, latency)

    def _each_column(self) -> AbstractContextManager[str]:
        return self.f.loop(0, whole_width(self.f))

    def _load(self, j: str) -> Rows:
        return [self.f.load(row, j) for row in self._rows]


def many_tables(pattern: TapeLayout) -> str:
    """Return the constants that `_ManyStates` reads."""
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
    return "".join(integer_table(f"many_{name}", numbers) for name, numbers in tables.items())


class _ManyStates:
    """The same by loops over the states; A and C are read where they are not structurally zero."""

    def __init__(self, f: FunctionWriter, pattern: TapeLayout) -> None:
        self.f, self.pattern, self.count = f, pattern, pattern.carried
        self._rows, self._factors = f.slot("ptr", self.count), f.slot("double", self.count)

    def begin(self, k: str) -> None:
        """Locate the rows of S, C and A of sample k."""
        f = self.f
        with f.loop(0, self.count) as i:
            place = f.add(f.load("%rings", i, "i64"), self._number("bases", i))
            f.store(f.at("%sensitivities", f.mul("%width", place)), self._rows, i, "ptr")
        self._c = f.at("%c", f.mul(k, self.pattern.outputs * self.count))
        self._a = f.at("%a", f.mul(k, self.pattern.cells))

    def add_output(self, target: str, output: int, factor: str) -> None:
        f, seen = self.f, self.pattern.seen
        states = f.at("@many_seen", sum(map(len, seen[:output])), "i32")
        slopes = f.at(self._c, output * self.count)
        with f.loop(0, len(seen[output])) as i:
            f.store(f.fmul(factor, f.load(slopes, f.load_index(states, i))), self._factors, i)
        self._combine(target, states, self._factors, str(len(seen[output])))

    def step(self) -> None:
        f = self.f
        bytes_ = f.mul("%width", 8 * self.count)
        # combinations are added to what is there
        f.do(f"call void @llvm.memset.p0.i64(ptr %next, i8 0, i64 {bytes_}, i1 false)")
        with f.loop(0, len(self.pattern.copies)) as pair:
            first = f.mul(pair, 2)
            row, source = self._number("copies", first), self._number("copies", f.add(first, 1))
            # S of the source before this step, as its row is replaced in `turn` only
            self._copy(self._next(row), f.load(self._rows, source, "ptr"))
        with f.loop(0, len(self.pattern.kept)) as row:
            begin, end = self._number("ends", row), self._number("ends", f.add(row, 1))
            states, factors = f.at("@many_sources", begin, "i32"), f.at(self._a, begin)
            self._combine(self._next(self._number("kept", row)), states, factors, f.new(f"sub i64 {end}, {begin}"))

    def add_entry(self, column: str, slopes: str) -> None:
        """Add B, the slopes of the kept states with respect to one value."""
        f = self.f
        with f.loop(0, len(self.pattern.kept)) as row:
            f.increase(f.load(slopes, row), self._next(self._number("kept", row)), column)

    def turn(self) -> None:
        f = self.f
        with f.loop(0, self.count) as i:
            self._copy(f.load(self._rows, i, "ptr"), self._next(i))
            f.advance("%rings", i, self._number("latencies", i))

    def _number(self, table: str, at: str) -> str:
        return self.f.load_index(f"@many_{table}", at)

    def _next(self, state: str) -> str:
        return self.f.at("%next", self.f.new(f"mul i64 {state}, %width"))

    def _copy(self, target: str, source: str) -> None:
        arguments = f"ptr {target}, ptr {source}, i64 {self.f.mul('%width', 8)}, i1 false"
        self.f.do(f"call void @llvm.memcpy.p0.p0.i64({arguments})")

    def _combine(self, target: str, states: str, factors: str, count: str) -> None:
        arguments = [("ptr", target), ("ptr", self._rows), ("ptr", states), ("ptr", factors), ("i64", count)]
        self.f.call("add_combination", [*arguments, ("i64", "%width")])


def add_combination(most: int, tables: str) -> FunctionWriter:
    """Write `add_combination(target, rows, states, factors, count, width)`: target += factors[i] rows[states[i]].

    Rows multiplied by zero are skipped, even if not finite. `count` is at most `most`.
    """
    head = [("ptr noalias", "target"), ("ptr", "rows"), ("ptr", "states"), ("ptr", "factors")]
    f = FunctionWriter("add_combination", [*head, ("i64", "count"), ("i64", "width")], "noinline", tables)
    picked, weights, number = f.slot("ptr", most), f.slot("double", most), f.variable("i64", "0")
    with f.loop(0, "%count") as i:
        # written in any case, and kept by advancing only if the factor is not 0: no branch
        at, factor = number.get(), f.load("%factors", i)
        f.store(f.load("%rows", f.load_index("%states", i), "ptr"), picked, at, "ptr")
        f.store(factor, weights, at)
        counts = f.new(f"fcmp une double {factor}, {ZERO}")
        number.set(f.add(at, f.new(f"zext i1 {counts} to i64")))
    # strips of STRIP vectors, then the vectors that are left; the width is a multiple of LANES
    vectors = f.new(f"sdiv i64 %width, {LANES}")
    strips = f.new(f"sdiv i64 {vectors}, {STRIP}")
    with f.loop(0, strips) as strip:
        _add(f, f.mul(strip, STRIP * LANES), STRIP, picked, weights, number.get())
    with f.loop(f.mul(strips, STRIP), vectors) as vector:
        _add(f, f.mul(vector, LANES), 1, picked, weights, number.get())
    return f


def _add(f: FunctionWriter, column: str, vectors: int, rows: str, weights: str, count: str) -> None:
    """Write the sums of some vectors of columns from `column` on."""
    v = Vector(f)
    columns = [f.add(column, i * LANES) for i in range(vectors)]
    sums = [f.variable(EIGHT, v.load("%target", at)) for at in columns]
    with f.loop(0, count) as i:
        row, weight = f.load(rows, i, "ptr"), v.splat(f.load(weights, i))
        for total, at in zip(sums, columns, strict=True):
            product = v("fmul", weight, v.load(row, at))
            total.set(v("fadd", total.get(), product))
    for total, at in zip(sums, columns, strict=True):
        v.store(total.get(), "%target", at)
