"""The forward sweep over a tape with states: gradient and Gauss-Newton matrix, with S carried over the samples.

With m outputs, n carried states and the matrices of `sweeps`, each sample adds

    gradient += D' W r + B' L[k+1]
    G += S' (A' Q[k+1] B + C' W D) + 1/2 (D' W D + B' Q[k+1] B)
    S[k+1] = A S[k] + B

D [m, free] and B [n, free] have a few columns that are not zero, the entries of the sample. For the entry in column c,
R = B' Q A + D' W C has one row [n], its *reach*: row c of G grows by that row times S [n, width].
"""

from dataclasses import dataclass

from kennfeld.machine_code.ir import HALF, FunctionWriter, StackVariable
from kennfeld.native.tape_layout import TapeLayout
from kennfeld.native.tape_reader import ENTRIES, SUMS, Rows, TapeEntries, dot, load_row, whole_width


def forward_functions(pattern: TapeLayout) -> list[FunctionWriter]:
    """Write `forward(length, ..., sensitivities, width, reach, entries, sums)`, after the functions it calls.

    `sensitivities` holds S [n, width] for the columns that can reach a state, with room for `batch` more of them;
    `reach` has room for `batch` * n doubles per entry. Consecutive samples mostly touch the same columns: a batch of
    them loads and stores the matrix once.
    """
    n, batch = pattern.carried, pattern.batch
    names = ("residual", "weight", "c", "a", "q_next", "l_next", "sensitivities")
    head = [("i64", "length"), *(("ptr", name) for name in names), ("i64", "width"), ("ptr", "reach")]
    f = FunctionWriter("forward", [*head, *ENTRIES, *SUMS])
    with f.walk("%length") as (k, position):
        together = f.variable("i64", "0")
        if batch > 1:
            with f.when(f.new(f"icmp sle i64 {f.add(k, batch)}, %length")):
                _compare_columns(f, k, batch, together)
        many = f.new(f"icmp ne i64 {together.get()}, 0")
        for condition, size in ((many, batch), (f.new(f"xor i1 {many}, true"), 1)):
            with f.when(condition):
                _add_batch(f, pattern, k, size)
                position.set(f.add(k, size))
    return [*(_add_rows_function(count, n * size) for count in (1, 2) for size in sorted({1, batch})), f]


def _compare_columns(f: FunctionWriter, k: str, batch: int, result: StackVariable) -> None:
    """Set `result` to 1 if the `batch` samples from k on touch the same columns."""
    differ = f.variable("i32", "0")

    def compare(first: str, others: Rows) -> None:
        for other in others:
            changed = f.new(f"xor i32 {first}, {other}")
            differ.set(f.new(f"or i32 {differ.get()}, {changed}"))

    samples = [f.add(k, i) for i in range(batch)]
    first, *others = (f.load("%count", sample, "i32") for sample in samples)
    compare(first, others)
    rows = [f.at("%index", f.mul(sample, "%room"), "i32") for sample in samples]
    with f.loop(0, f.new(f"sext i32 {first} to i64")) as e:
        head, *tail = (f.load(row, e, "i32") for row in rows)
        compare(head, tail)
    same = f.new(f"icmp eq i32 {differ.get()}, 0")
    result.set(f.new(f"zext i1 {same} to i64"))


def _add_batch(f: FunctionWriter, pattern: TapeLayout, k: str, size: int) -> None:
    """Add `size` samples from k on, which touch the same columns, and carry S over them."""
    n = pattern.carried
    samples = [_TapeSample(f, pattern, f.add(k, i)) for i in range(size)]
    entries = samples[0].entries
    with f.loop(0, entries.count) as e:
        column = entries.column(e)
        terms = [sample.terms(e) for sample in samples]
        f.increase(f.sum([term.gradient for term in terms]), "%gradient", column)
        # G[c, :] of the columns of entries: half of (W D, Q B)' (D, B) on the diagonal, all of it before
        row = f.at("%matrix", f.mul(column, "%columns"))
        f.increase(f.fmul(HALF, f.sum([dot(f, term.weighted, term.slopes) for term in terms])), row, column)
        with f.loop(0, e) as other:
            others = (sample.entries.read(other)[1] for sample in samples)
            products = [dot(f, term.weighted, slopes) for term, slopes in zip(terms, others, strict=True)]
            f.increase(f.sum(products), row, entries.column(other))
        for i, term in enumerate(terms):
            for number, factor in enumerate(term.reach):
                f.store(factor, "%reach", f.add(f.mul(e, size * n), i * n + number))
    if size > 1:
        for i, sample in enumerate(samples):
            _step_sensitivities(f, sample, n, i, i + 1)
    _add_sensitivities(f, entries, n * size)
    if size > 1:
        with f.loop(0, f.mul(whole_width(f), n)) as j:
            f.store(f.load(_sensitivity(f, n, size, 0), j), "%sensitivities", j)
    else:
        _step_sensitivities(f, samples[0], n, 0, 0)


@dataclass(frozen=True)
class _EntryTerms:
    """Terms of one entry: its column of D and B, that of W D and Q B, part of the gradient, and its reach."""

    slopes: Rows  # [m + n]
    weighted: Rows  # [m + n]
    gradient: str
    reach: Rows  # [n]


class _TapeSample:
    """The tape of one sample, loaded."""

    def __init__(self, f: FunctionWriter, pattern: TapeLayout, k: str) -> None:
        m, n = pattern.outputs, pattern.carried
        self.f, self.m, self.n = f, m, n
        self.residual, self.weight = load_row(f, "%residual", k, m), load_row(f, "%weight", k, m)
        self.c, self.a = load_row(f, "%c", k, m * n, pattern.c), load_row(f, "%a", k, n * n, pattern.a)
        self.q, self.l = load_row(f, "%q_next", k, n * n), load_row(f, "%l_next", k, n)
        self.entries = TapeEntries(f, k, m + n)

    def terms(self, e: str) -> _EntryTerms:
        """Return all terms that entry e adds to the sums."""
        f, m, n = self.f, self.m, self.n
        _, slopes = self.entries.read(e)
        d, b = slopes[:m], slopes[m:]
        wd = [f.fmul(w, x) for w, x in zip(self.weight, d, strict=True)]
        qb = [dot(f, self.q[i * n : i * n + n], b) for i in range(n)]
        gradient = f.fadd(dot(f, b, self.l), dot(f, wd, self.residual))
        reach = [f.fadd(dot(f, self.a[i::n], qb), dot(f, self.c[i::n], wd)) for i in range(n)]
        return _EntryTerms(slopes, [*wd, *qb], gradient, reach)


def _sensitivity(f: FunctionWriter, n: int, slot: int, state: int) -> str:
    """Return the row of S of one state, `slot` samples after the first."""
    return f.at("%sensitivities", f.mul("%width", slot * n + state))


def _step_sensitivities(f: FunctionWriter, sample: _TapeSample, n: int, from_: int, to: int) -> None:
    """Compute S of the next sample, A S + B, from slot to slot."""
    old_rows, new_rows = ([_sensitivity(f, n, slot, i) for i in range(n)] for slot in (from_, to))
    with f.loop(0, whole_width(f)) as j:
        old = [f.load(row, j) for row in old_rows]
        new = [dot(f, sample.a[i * n : i * n + n], old) for i in range(n)]
        for row, value in zip(new_rows, new, strict=True):
            f.store(value, row, j)
    with f.loop(0, sample.entries.count) as e:
        column, slopes = sample.entries.read(e)
        for row, slope in zip(new_rows, slopes[sample.m :], strict=True):
            f.increase(slope, row, column)


def _add_sensitivities(f: FunctionWriter, entries: TapeEntries, factors: int) -> None:
    """Add rows of S times `%reach` to the rows of the matrix, two at a time if they differ."""

    def add(rows: Rows, e: str) -> None:
        reach = f.at("%reach", f.mul(e, factors))
        arguments = [*(("ptr", row) for row in rows), ("ptr", "%sensitivities"), ("i64", "%width"), ("ptr", reach)]
        f.call(f"add_rows_{len(rows)}_{factors}", arguments)

    def row(e: str) -> str:
        return f.at("%matrix", f.mul(entries.column(e), "%columns"))

    with f.walk(entries.count) as (e, position):
        following = f.add(e, 1)
        paired = f.variable("i64", "0")
        with f.when(f.new(f"icmp slt i64 {following}, {entries.count}")):
            differ = f.new(f"icmp ne i64 {entries.column(e)}, {entries.column(following)}")
            paired.set(f.new(f"zext i1 {differ} to i64"))
        two = f.new(f"icmp ne i64 {paired.get()}, 0")
        with f.when(two):
            add([row(e), row(following)], e)
        with f.when(f.new(f"xor i1 {two}, true")):
            add([row(e)], e)
        position.set(f.add(following, paired.get()))


def _add_rows_function(count: int, factors: int) -> FunctionWriter:
    """Write `add_rows_COUNT_FACTORS(rows..., sensitivities, width, factors)`: rows += factors times rows of S."""
    rows = [f"row{i}" for i in range(count)]
    pointers = [("ptr noalias", name) for name in (*rows, "sensitivities")]
    parameters = [*pointers, ("i64", "width"), ("ptr noalias", "factors")]
    f = FunctionWriter(f"add_rows_{count}_{factors}", parameters, "noinline")
    coefficients = [[f.load("%factors", i * factors + t) for t in range(factors)] for i in range(count)]
    sources = [f.at("%sensitivities", f.mul("%width", t)) for t in range(factors)]
    with f.loop(0, whole_width(f)) as j:
        values = [f.load(source, j) for source in sources]
        for name, own in zip(rows, coefficients, strict=True):
            f.increase(dot(f, own, values), f"%{name}", j)
    return f
