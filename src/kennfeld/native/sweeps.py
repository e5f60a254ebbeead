"""Sums over a tape of linearised steps: gradient and Gauss-Newton matrix, or rows of the Jacobian.

They depend on the number of outputs m and of carried states n, not on the model. With free values p [free], states s
[n] and outputs y [m], the tape linearises each sample k:

    dy[k]   = C[k] ds[k] + D[k] dp        C [m, n], D [m, free] sparse, stored as entries
    ds[k+1] = A[k] ds[k] + B[k] dp        A [n, n], B [n, free] sparse, stored as entries

With sensitivities S[k] = ds[k]/dp [n, free], the Jacobian is J[k] = C[k] S[k] + D[k]. For residuals r [m] and weights W
[m], substituting J into gradient J'Wr and Gauss-Newton matrix H = J'WJ, and collecting what later samples contribute in
Q [n, n] and L [n], gives the exact sums without the rows of J:

    backward, from Q = 0, L = 0 after the last sample:
        Q[k] = A' Q[k+1] A + C' W C
        L[k] = A' L[k+1] + C' W r
    forward, from S[0] = ds[0]/dp:
        gradient += D' W r + B' L[k+1]
        G += S' (A' Q[k+1] B + C' W D) + 1/2 (D' W D + B' Q[k+1] B)
        S[k+1] = A S[k] + B
    start: gradient += S[0]' L[0],  G += 1/2 S[0]' Q[0] S[0]
    end: H = G + G'

This takes O(samples * (n^2 + n nnz) * free) operations, with nnz the entries of a sample, instead of O(samples *
free^2). G accepts repeated columns in any order; `fold` computes H from it.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

from kennfeld.native.engine import Engine
from kennfeld.native.ir import FunctionWriter, literal
from kennfeld.native.jacobian_sweeps import ManyStates, add_combination, many_tables
from kennfeld.native.tape_layout import MANY, TapeLayout

VECTOR = 8  # rows of S are padded to a multiple of this; what goes over the end of a matrix row adds zeros
ZERO, HALF = literal(0.0), literal(0.5)
Rows = list[str]

ENTRIES = (("ptr", "index"), ("ptr", "slope"), ("ptr", "count"), ("i64", "room"))
SUMS = (("ptr", "matrix"), ("i64", "columns"), ("ptr", "gradient"))  # columns from one row of the matrix to the next


class Sweeps:
    """Native sweeps for tapes of one layout, each compiled when first used."""

    def __init__(self, pattern: TapeLayout) -> None:
        self.pattern = pattern

    @cached_property
    def normal(self) -> Callable[..., None]:
        return _compile(_normal(self.pattern))

    @cached_property
    def backward(self) -> Callable[..., None]:
        return _compile(_backward(self.pattern))

    @cached_property
    def forward(self) -> Callable[..., None]:
        return _compile(*_forward(self.pattern))

    @cached_property
    def rows(self) -> Callable[..., None]:
        many = self.pattern.carried > MANY
        return _compile(*_rows(self.pattern), tables=many_tables(self.pattern) if many else "")

    @cached_property
    def fold(self) -> Callable[..., None]:
        return _compile(_fold(), loops=False)


@cache
def sweeps(pattern: TapeLayout) -> Sweeps:
    """Return the sweeps of a layout; kernels of the same layout share them."""
    return Sweeps(pattern)


def _compile(*functions: FunctionWriter, loops: bool = True, tables: str = "") -> Callable[..., None]:
    """Compile functions and return the last, which may call the others; without `loops`, LLVM skips loop passes."""
    f = functions[-1]
    return Engine(tables + "".join(g.text() for g in functions), loops=loops).function(f.name, f.parameters)


def _row(f: FunctionWriter, array: str, k: str, size: int, present: Collection[int] | None = None) -> Rows:
    """Return the `size` doubles of sample k, with zero for those not `present`."""
    base = f.mul(k, size)
    return [f.load(array, f.add(base, i)) if present is None or i in present else ZERO for i in range(size)]


def _dot(f: FunctionWriter, a: Sequence[str], b: Sequence[str]) -> str:
    return f.dot([(x, y) for x, y in zip(a, b, strict=True) if ZERO not in (x, y)])


def _times(f: FunctionWriter, a: str, b: str) -> str:
    return ZERO if ZERO in (a, b) else f.fmul(a, b)


def _entries(
    f: FunctionWriter, k: str, width: int, wanted: int | None = None
) -> tuple[str, Callable[[str], tuple[str, Rows]]]:
    """Return the number of entries of sample k, and a reader of an entry's column and (first `wanted`) slopes."""
    count = f.new(f"sext i32 {f.load('%count', k, 'i32')} to i64")
    start = f.mul(k, "%room")

    def read(number: str) -> tuple[str, Rows]:
        place = f.add(start, number)
        column = f.new(f"sext i32 {f.load('%index', place, 'i32')} to i64")
        base = f.at("%slope", f.mul(place, width))
        return column, [f.load(base, i) for i in range(width if wanted is None else wanted)]

    return count, read


def _normal(pattern: TapeLayout) -> FunctionWriter:
    """Write `normal(length, residual, weight, entries, sums)` for models without states: gradient += D'Wr, H
    += D'WD.
    """
    m = pattern.outputs
    head = [("i64", "length"), ("ptr", "residual"), ("ptr", "weight")]
    f = FunctionWriter("normal", [*head, *ENTRIES, *SUMS])
    with f.loop(0, "%length") as k:
        residual, weight = _row(f, "%residual", k, m), _row(f, "%weight", k, m)
        count, read = _entries(f, k, m)
        with f.loop(0, count) as e:
            column, slopes = read(e)
            weighted = [f.fmul(w, s) for w, s in zip(weight, slopes, strict=True)]
            f.increase(_dot(f, weighted, residual), "%gradient", column)
            _pairs(f, e, column, read, lambda other: _dot(f, weighted, other), slopes)
    return f


def _pairs(
    f: FunctionWriter,
    e: str,
    column: str,
    read: Callable[[str], tuple[str, Rows]],
    product: Callable[[Rows], str],
    own: Rows,
) -> None:
    """Add the products of an entry with itself, halved, and with those before it."""
    row = f.at("%matrix", f.mul(column, "%columns"))
    f.increase(f.fmul(HALF, product(own)), row, column)
    with f.loop(0, e) as other:
        other_column, other_slopes = read(other)
        f.increase(product(other_slopes), row, other_column)


def _backward(pattern: TapeLayout) -> FunctionWriter:
    """Write `backward(length, residual, weight, c, a, q, l, q_next, l_next)`.

        Q[k] = A' Q[k+1] A + C' W C,   L[k] = A' L[k+1] + C' W r

    `q` [n, n] and `l` [n] hold the values after the last sample and return those at the first; `q_next[k]` and
    `l_next[k]` receive Q[k+1] and L[k+1].
    """
    m, n = pattern.outputs, pattern.carried
    names = ("residual", "weight", "c", "a", "q", "l", "q_next", "l_next")
    f = FunctionWriter("backward", [("i64", "length"), *(("ptr", name) for name in names)])
    with f.loop(0, "%length") as back:
        k = f.new(f"sub i64 {f.add('%length', -1)}, {back}")
        q, l = _row(f, "%q", "0", n * n), _row(f, "%l", "0", n)  # noqa: E741
        for array, values, size in (("%q_next", q, n * n), ("%l_next", l, n)):
            base = f.mul(k, size)
            for i, value in enumerate(values):
                f.store(value, array, f.add(base, i))
        residual, weight = _row(f, "%residual", k, m), _row(f, "%weight", k, m)
        c, a = _row(f, "%c", k, m * n, pattern.c), _row(f, "%a", k, n * n, pattern.a)
        wc = [[_times(f, weight[o], c[o * n + i]) for i in range(n)] for o in range(m)]
        qa = [[_dot(f, q[i * n : i * n + n], a[j::n]) for j in range(n)] for i in range(n)]
        for i in range(n):
            for j in range(n):  # Q[k] = A' (Q[k+1] A) + C' W C
                later = _dot(f, a[i::n], [qa[x][j] for x in range(n)])
                now = _dot(f, [wc[o][i] for o in range(m)], [c[o * n + j] for o in range(m)])
                f.store(f.fadd(later, now), "%q", i * n + j)
            now = _dot(f, [wc[o][i] for o in range(m)], residual)  # L[k] = A' L[k+1] + C' W r
            f.store(f.fadd(_dot(f, a[i::n], l), now), "%l", i)
    return f


def _forward(pattern: TapeLayout) -> list[FunctionWriter]:
    """Write `forward(length, ..., sensitivities, width, reach, entries, sums)`: sums over a chunk, with S carried over
    it.

        gradient += D' W r + B' L[k+1]
        G += S' (A' Q[k+1] B + C' W D) + 1/2 (D' W D + B' Q[k+1] B)
        S[k+1] = A S[k] + B

    `sensitivities` holds S [n, width] for the columns that can reach a state, with room for `batch` more of them;
    `reach` has room for `batch` * n doubles per entry, its row of B' Q A + D' W C. Consecutive samples mostly touch the
    same columns: a batch of them loads and stores the matrix once.
    """
    n, batch = pattern.carried, pattern.batch
    names = ("residual", "weight", "c", "a", "q_next", "l_next", "sensitivities")
    head = [("i64", "length"), *(("ptr", name) for name in names), ("i64", "width"), ("ptr", "reach")]
    f = FunctionWriter("forward", [*head, *ENTRIES, *SUMS])
    with f.walk("%length") as (k, position):
        together = f.slot("i64")
        f.store("0", together, kind="i64")
        if batch > 1:
            with f.when(f.new(f"icmp sle i64 {f.add(k, batch)}, %length")):
                _compare_columns(f, k, batch, together)
        many = f.new(f"icmp ne i64 {f.load(together, kind='i64')}, 0")
        with f.when(many):
            _add_batch(f, pattern, k, batch)
            f.store(f.add(k, batch), position, kind="i64")
        with f.when(f.new(f"xor i1 {many}, true")):
            _add_batch(f, pattern, k, 1)
            f.store(f.add(k, 1), position, kind="i64")
    return [*(_add_rows_function(count, n * size) for count in (1, 2) for size in sorted({1, batch})), f]


def _compare_columns(f: FunctionWriter, k: str, batch: int, result: str) -> None:
    """Set `result` to 1 if the `batch` samples from k on touch the same columns."""
    differ = f.slot("i32")
    f.store("0", differ, kind="i32")

    def compare(first: str, others: Rows) -> None:
        for other in others:
            changed = f.new(f"xor i32 {first}, {other}")
            f.store(f.new(f"or i32 {f.load(differ, kind='i32')}, {changed}"), differ, kind="i32")

    samples = [f.add(k, i) for i in range(batch)]
    first, *others = (f.load("%count", sample, "i32") for sample in samples)
    compare(first, others)
    rows = [f.at("%index", f.mul(sample, "%room"), "i32") for sample in samples]
    with f.loop(0, f.new(f"sext i32 {first} to i64")) as e:
        head, *tail = (f.load(row, e, "i32") for row in rows)
        compare(head, tail)
    same = f.new(f"icmp eq i32 {f.load(differ, kind='i32')}, 0")
    f.store(f.new(f"zext i1 {same} to i64"), result, kind="i64")


def _add_batch(f: FunctionWriter, pattern: TapeLayout, k: str, size: int) -> None:
    """Add `size` samples from k on, which touch the same columns, and carry S over them."""
    n = pattern.carried
    terms = [_Terms(f, pattern, f.add(k, i)) for i in range(size)]
    count = terms[0].count
    with f.loop(0, count) as e:
        column = terms[0].column(e)
        entries = [term.of_entry(e) for term in terms]
        f.increase(f.sum([entry.gradient for entry in entries]), "%gradient", column)
        row = f.at("%matrix", f.mul(column, "%columns"))
        f.increase(f.fmul(HALF, f.sum([_dot(f, entry.weighted, entry.slopes) for entry in entries])), row, column)
        with f.loop(0, e) as other:
            products = [_dot(f, en.weighted, term.slopes(other)) for en, term in zip(entries, terms, strict=True)]
            f.increase(f.sum(products), row, terms[0].column(other))
        for i, entry in enumerate(entries):
            for number, factor in enumerate(entry.reach):
                f.store(factor, "%reach", f.add(f.mul(e, size * n), i * n + number))
    if size > 1:
        for i, term in enumerate(terms):
            _step_sensitivities(f, term, n, i, i + 1)
    _add_sensitivities(f, terms[0], n * size)
    if size > 1:
        with f.loop(0, f.mul(_whole(f), n)) as j:
            f.store(f.load(_sensitivity(f, n, size, 0), j), "%sensitivities", j)
    else:
        _step_sensitivities(f, terms[0], n, 0, 0)


@dataclass(frozen=True)
class _TapeEntry:
    """Terms of one entry: slopes, slopes times W or Q, part of the gradient, and its row of B'QA + D'WC."""

    slopes: Rows
    weighted: Rows
    gradient: str
    reach: Rows


class _Terms:
    """The tape of one sample, loaded."""

    def __init__(self, f: FunctionWriter, pattern: TapeLayout, k: str) -> None:
        m, n = pattern.outputs, pattern.carried
        self.f, self.m, self.n = f, m, n
        self.residual, self.weight = _row(f, "%residual", k, m), _row(f, "%weight", k, m)
        self.c, self.a = _row(f, "%c", k, m * n, pattern.c), _row(f, "%a", k, n * n, pattern.a)
        self.q, self.l = _row(f, "%q_next", k, n * n), _row(f, "%l_next", k, n)
        self.count, self._read = _entries(f, k, m + n)

    def column(self, e: str) -> str:
        """Return the column of entry e."""
        return self._read(e)[0]

    def slopes(self, e: str) -> Rows:
        """Return the slopes of entry e: its column of D, then of B."""
        return self._read(e)[1]

    def of_entry(self, e: str) -> _TapeEntry:
        """Return all terms that entry e adds to the sums."""
        f, m, n = self.f, self.m, self.n
        slopes = self.slopes(e)
        # D' W r + B' L of the entry's column, and its row of B' Q A + D' W C
        wd = [f.fmul(w, d) for w, d in zip(self.weight, slopes[:m], strict=True)]
        qb = [_dot(f, self.q[i * n : i * n + n], slopes[m:]) for i in range(n)]
        gradient = f.fadd(_dot(f, slopes[m:], self.l), _dot(f, wd, self.residual))
        reach = [f.fadd(_dot(f, self.a[i::n], qb), _dot(f, self.c[i::n], wd)) for i in range(n)]
        return _TapeEntry(slopes, [*wd, *qb], gradient, reach)


def _whole(f: FunctionWriter) -> str:
    """Return the width as a multiple of whole vectors, so that LLVM adds no remainder loop."""
    return f.new(f"and i64 %width, -{VECTOR}")


def _sensitivity(f: FunctionWriter, n: int, slot: int, state: int) -> str:
    """Return the row of S of one state, `slot` samples after the first."""
    return f.at("%sensitivities", f.mul("%width", slot * n + state))


def _step_sensitivities(f: FunctionWriter, term: _Terms, n: int, from_: int, to: int) -> None:
    """Compute S of the next sample, A S + B."""
    old_rows, new_rows = ([_sensitivity(f, n, slot, i) for i in range(n)] for slot in (from_, to))
    with f.loop(0, _whole(f)) as j:
        old = [f.load(row, j) for row in old_rows]
        new = [_dot(f, term.a[i * n : i * n + n], old) for i in range(n)]
        for row, value in zip(new_rows, new, strict=True):
            f.store(value, row, j)
    with f.loop(0, term.count) as e:
        column, slopes = term.column(e), term.slopes(e)[term.m :]
        for row, slope in zip(new_rows, slopes, strict=True):
            f.increase(slope, row, column)


def _add_sensitivities(f: FunctionWriter, term: _Terms, factors: int) -> None:
    """Add rows of S times `%reach` to the rows of the matrix, two at a time if they differ."""

    def add(rows: Rows, e: str) -> None:
        reach = f.at("%reach", f.mul(e, factors))
        arguments = [*(("ptr", row) for row in rows), ("ptr", "%sensitivities"), ("i64", "%width"), ("ptr", reach)]
        f.call(f"add_rows_{len(rows)}_{factors}", arguments)

    def row(e: str) -> str:
        return f.at("%matrix", f.mul(term.column(e), "%columns"))

    with f.walk(term.count) as (e, position):
        following = f.add(e, 1)
        paired = f.slot("i64")
        f.store("0", paired, kind="i64")
        with f.when(f.new(f"icmp slt i64 {following}, {term.count}")):
            differ = f.new(f"icmp ne i64 {term.column(e)}, {term.column(following)}")
            f.store(f.new(f"zext i1 {differ} to i64"), paired, kind="i64")
        two = f.new(f"icmp ne i64 {f.load(paired, kind='i64')}, 0")
        with f.when(two):
            add([row(e), row(following)], e)
        with f.when(f.new(f"xor i1 {two}, true")):
            add([row(e)], e)
        f.store(f.add(following, f.load(paired, kind="i64")), position, kind="i64")


def _add_rows_function(count: int, factors: int) -> FunctionWriter:
    """Write `add_rows_COUNT_FACTORS(rows..., sensitivities, width, factors)`: rows += factors times rows of S."""
    rows = [f"row{i}" for i in range(count)]
    pointers = [("ptr noalias", name) for name in (*rows, "sensitivities")]
    f = FunctionWriter(
        f"add_rows_{count}_{factors}", [*pointers, ("i64", "width"), ("ptr noalias", "factors")], "noinline"
    )
    coefficients = [[f.load("%factors", i * factors + t) for t in range(factors)] for i in range(count)]
    sources = [f.at("%sensitivities", f.mul("%width", t)) for t in range(factors)]
    with f.loop(0, _whole(f)) as j:
        values = [f.load(source, j) for source in sources]
        for name, own in zip(rows, coefficients, strict=True):
            f.increase(_dot(f, own, values), f"%{name}", j)
    return f


def _add_rows(f: FunctionWriter, target: str, rows: Rows, factors: Rows) -> None:
    """Write target[:width] += sum of factors times rows."""
    if all(factor == ZERO for factor in factors):
        return
    with f.loop(0, _whole(f)) as j:
        f.increase(_dot(f, factors, [f.load(row, j) for row in rows]), target, j)


def _rows(pattern: TapeLayout) -> list[FunctionWriter]:
    """Write `rows(length, weight, c, a, sensitivities, width, rings, entries, jacobian, columns)`.

        jacobian[k] = sqrt(W) (C S[k] + D),   S[k+1] = A S[k] + B

    A state of latency d has d rows of S in a ring buffer; `rings[i]` is the index of the oldest.
    """
    m, n = pattern.outputs, pattern.carried
    names = ("weight", "c", "a", "sensitivities")
    head = [("i64", "length"), *(("ptr", name) for name in names), ("i64", "width"), ("ptr", "rings"), ("ptr", "next")]
    f = FunctionWriter("rows", [*head, *ENTRIES, ("ptr", "jacobian"), ("i64", "columns")])
    states = ManyStates(f, pattern) if n > MANY else None
    with f.loop(0, "%length") as k:
        weight = _row(f, "%weight", k, m)
        roots = [f.new(f"call double @llvm.sqrt.f64(double {w})") for w in weight]
        out = [f.at("%jacobian", f.mul(f.add(f.mul(k, m), o), "%columns")) for o in range(m)]
        if states is not None:
            _many_rows(f, pattern, k, states, roots, out)
        else:
            _few_rows(f, pattern, k, roots, out)
    return [add_combination(n), f] if n > MANY else [f]


def _few_rows(f: FunctionWriter, pattern: TapeLayout, k: str, roots: Rows, out: Rows) -> None:
    """Write the rows of one sample and the next S, unrolled."""
    m, n, latencies = pattern.outputs, pattern.carried, pattern.latencies
    places = [f.add(f.load("%rings", i, "i64"), sum(latencies[:i])) for i in range(n)]
    s = [f.at("%sensitivities", f.mul("%width", place)) for place in places]
    c, a = _row(f, "%c", k, m * n, pattern.c), _row(f, "%a", k, n * n, pattern.a)
    for o in range(m):
        _clear_row(f, out[o])
        if n:
            _add_rows(f, out[o], s, [_times(f, roots[o], c[o * n + i]) for i in range(n)])
    if n:
        _next_rows(f, s, a)
    count, read = _entries(f, k, m + n)
    with f.loop(0, count) as e:
        column, slopes = read(e)
        for o in range(m):
            f.increase(f.fmul(roots[o], slopes[o]), out[o], column)
        for i in range(n):
            f.increase(slopes[m + i], f.at("%next", f.mul("%width", i)), column)
    for i in range(n):
        with f.loop(0, _whole(f)) as j:
            f.store(f.load(f.at("%next", f.mul("%width", i)), j), s[i], j)
    _turn_rings(f, latencies)


def _many_rows(f: FunctionWriter, pattern: TapeLayout, k: str, states: ManyStates, roots: Rows, out: Rows) -> None:
    """Write the rows of one sample and the next S as loops over the states."""
    m, n = pattern.outputs, pattern.carried
    states.begin()
    for o in range(m):
        _clear_row(f, out[o])
        states.add_output(out[o], o, roots[o], f.at("%c", f.mul(f.add(f.mul(k, m), o), n)))
    states.step(f.at("%a", f.mul(k, pattern.cells)))
    count, read = _entries(f, k, pattern.rows, m)
    with f.loop(0, count) as e:
        column, slopes = read(e)
        for o in range(m):
            f.increase(f.fmul(roots[o], slopes[o]), out[o], column)
        place = f.mul(f.add(f.mul(k, "%room"), e), pattern.rows)
        states.add_entry(column, f.at("%slope", f.add(place, m)))
    states.turn()


def _clear_row(f: FunctionWriter, row: str) -> None:
    with f.loop(0, "%columns") as j:
        f.store(ZERO, row, j)


def _next_rows(f: FunctionWriter, s: Rows, a: Rows) -> None:
    """Write A S, the next S without the entries' part."""
    n = len(s)
    with f.loop(0, _whole(f)) as j:
        old = [f.load(row, j) for row in s]
        for i in range(n):
            f.store(_dot(f, a[i * n : i * n + n], old), f.at("%next", f.mul("%width", i)), j)


def _turn_rings(f: FunctionWriter, latencies: Sequence[int]) -> None:
    """Advance each state to its oldest row."""
    for i, latency in enumerate(latencies):
        if latency > 1:
            following = f.add(f.load("%rings", i, "i64"), 1)
            wrapped = f.new(f"icmp eq i64 {following}, {latency}")
            f.store(f.new(f"select i1 {wrapped}, i64 0, i64 {following}"), "%rings", i, "i64")


def _fold() -> FunctionWriter:
    """Write `fold(matrix, columns, count)`: H = G + G' in place for `count` columns, in blocks that fit the cache."""
    f = FunctionWriter("fold", [("ptr", "matrix"), ("i64", "columns"), ("i64", "count")])
    block = 32
    blocks = f.new(f"sdiv i64 {f.add('%count', block - 1)}, {block}")
    with f.loop(0, blocks) as bi, f.loop(0, f.add(bi, 1)) as bj:
        top, left = f.mul(bi, block), f.mul(bj, block)
        bottom = f.new(f"call i64 @llvm.smin.i64(i64 {f.add(top, block)}, i64 %count)")
        right = f.new(f"call i64 @llvm.smin.i64(i64 {f.add(left, block)}, i64 %count)")
        with f.loop(top, bottom) as i:
            end = f.new(f"call i64 @llvm.smin.i64(i64 {right}, i64 {f.add(i, 1)})")
            row = f.at("%matrix", f.mul(i, "%columns"))
            with f.loop(left, end) as j:
                mirror = f.at("%matrix", f.add(f.mul(j, "%columns"), i))
                both = f.fadd(f.load(row, j), f.load(mirror))
                f.store(both, row, j)
                f.store(both, mirror)
    return f
