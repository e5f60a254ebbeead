"""The forward sweep over a tape with states: gradient and Gauss-Newton matrix, with S carried over the samples.

With m outputs, n carried states and the matrices of `sweeps`, each sample adds

    gradient += D' W r + B' L[k+1]
    G += S' (A' Q[k+1] B + C' W D) + 1/2 (D' W D + B' Q[k+1] B)
    S[k+1] = A S[k] + B

D [m, free] and B [n, free] have a few columns that are not zero, the entries of the sample. For the entry in column c,
R = B' Q A + D' W C has one row [n], its *reach*: row c of G grows by that row times S [n, width].

Consecutive samples mostly touch the same columns. For a batch of them from sample 0 on, S[k] = P[k] S[0] + T[k] with
P[k] = A[k-1] ... A[0] and T [n, entries], which is not zero in these columns only. The rows of G therefore grow by
(sum of R[k] P[k]) S[0], once for the batch, and all else that a sample adds is a small matrix over its entries.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from kennfeld.base.machine_code.ir import HALF, LANES, ONE, ZERO, FunctionWriter, Vector
from kennfeld.native.tape_layout import TapeLayout
from kennfeld.native.tape_reader import ENTRIES, SUMS, Rows, TapeEntries, dot, load_row, reaching, whole_width

BATCH = 64  # samples at most, so that products of A that grow do not overflow before S does


def scratch_size(pattern: TapeLayout, room: int) -> int:
    """Return the number of doubles for a batch of samples with up to `room` entries."""
    m, n = pattern.outputs, pattern.carried
    rows = 3 * (m + n) + 3 * n + 1 + room
    return rows * (-(-room // LANES) * LANES)


def forward_functions(pattern: TapeLayout) -> list[FunctionWriter]:
    """Write `forward(length, ..., sensitivities, width, scratch, entries, sums)`, after the functions it calls.

    `sensitivities` holds S [n, width] for the columns that can reach a state; `scratch` has room for `scratch_size`.
    """
    names = ("residual", "weight", "c", "a", "q_next", "l_next", "sensitivities")
    head = [("i64", "length"), *(("ptr", name) for name in names), ("i64", "width"), ("ptr", "scratch")]
    f = FunctionWriter("forward", [*head, *ENTRIES, *SUMS])
    with f.walk("%length") as (k, position):
        end = _end_of_batch(f, k)
        batch = _SweepBatch(f, pattern, k)
        batch.transpose(k)
        with f.loop(k, end) as sample:
            following = f.add(sample, 1)
            with f.when(f.new(f"icmp slt i64 {following}, {end}")):
                batch.transpose(following)  # ahead, as vectors that were written just now are slow to load
            batch.add(sample)
        batch.finish()
        position.set(end)
    return [*(_add_rows_function(count, pattern.carried) for count in (1, 2)), f]


def _end_of_batch(f: FunctionWriter, k: str) -> str:
    """Return the first sample after k that touches other columns, at most `BATCH` later."""
    # ends at the first sample with another number of entries or another column at the same entry
    last, following = f.extreme("smin", f.add(k, BATCH), "%length"), f.add(k, 1)
    end, count = f.variable("i64", following), f.load("%count", k, "i32")
    columns = f.at("%index", f.mul(k, "%room"), "i32")
    with f.walk(last, following) as (sample, position):
        # differences are collected by `or`, without a branch at each entry
        differ = f.variable("i32", f.new(f"xor i32 {count}, {f.load('%count', sample, 'i32')}"))
        others = f.at("%index", f.mul(sample, "%room"), "i32")
        with f.loop(0, f.new(f"sext i32 {count} to i64")) as e:
            changed = f.new(f"xor i32 {f.load(columns, e, 'i32')}, {f.load(others, e, 'i32')}")
            differ.set(f.new(f"or i32 {differ.get()}, {changed}"))
        position.set(last)
        with f.when(f.new(f"icmp eq i32 {differ.get()}, 0")):
            end.set(f.add(sample, 1))
            position.set(f.add(sample, 1))
    return end.get()


class _SweepBatch:
    """Samples that touch the same columns; writes the code that adds them.

    All of its memory consists of rows over the entries, padded to whole vectors.
    """

    def __init__(self, f: FunctionWriter, pattern: TapeLayout, first: str) -> None:
        m, n = pattern.outputs, pattern.carried
        self.f, self.pattern = f, pattern
        self.entries = TapeEntries(f, first, m + n)
        self.stride = f.new(f"and i64 {f.add('%room', LANES - 1)}, -{LANES}")
        self.used = f.new(f"and i64 {f.add(self.entries.count, LANES - 1)}, -{LANES}")
        # scratch, [rows][stride], in this order: D and B of an even and an odd sample, halves, reach, T, R P, gradient,
        # products [entries][stride]
        slopes = 2 * (m + n)  # the rows of D and B of two samples
        self.halves = self._rows(slopes, m + n)  # of W D and Q B, halved
        self.reach = self._rows(slopes + m + n, n)
        self.own = self._rows(slopes + m + 2 * n, n)  # T
        self.total = self._rows(slopes + m + 3 * n, n)  # the sum of R P
        self.gradient, self.products = self._rows(slopes + m + 4 * n, 2)  # [entries], [entries][entries] of G
        self.carried = [[f.variable("double", ONE if i == j else ZERO) for j in range(n)] for i in range(n)]  # P
        # T, R P, gradient and products follow each other: one call sets them to zero
        size = f.mul(f.mul(self.stride, f.add(self.entries.count, 2 * n + 1)), 8)
        f.do(f"call void @llvm.memset.p0.i64(ptr {self.own[0]}, i8 0, i64 {size}, i1 false)")

    def _rows(self, first: int | str, count: int) -> Rows:
        return [self.f.at("%scratch", self.f.mul(self.stride, self.f.add(str(first), i))) for i in range(count)]

    def _slopes(self, k: str) -> Rows:
        """Return where the rows of D and B of a sample are."""
        count = self.pattern.outputs + self.pattern.carried
        return self._rows(self.f.mul(self.f.new(f"and i64 {k}, 1"), count), count)

    def transpose(self, k: str) -> None:
        """Write the rows of D and B of a sample."""
        rows = self._slopes(k)
        entries = TapeEntries(self.f, k, len(rows))
        with self.f.loop(0, self.entries.count) as e:
            for row, slope in zip(rows, entries.read(e)[1], strict=True):
                self.f.store(slope, row, e)

    def add(self, k: str) -> None:
        """Add a sample to the sums of the batch, and carry P and T over it."""
        f, v = self.f, Vector(self.f)
        sample, slopes = _TapeSample(f, self.pattern, k), self._slopes(k)
        with _vectors(f, self.used) as j:
            self._weigh(sample, v, slopes, j)
        with f.loop(0, self.entries.count) as e:
            # row e of the products: 1/2 (W D)[e] D + 1/2 (Q B)[e] B + reach[e] T, over all entries
            factors = [f.load(row, e) for row in (*self.halves, *self.reach)]
            product = f.at(self.products, f.mul(e, self.stride))
            with _vectors(f, self.used) as j:
                vectors = [v.load(row, j) for row in (*slopes, *self.own)]
                v.store(_plus_products(v, v.load(product, j), factors, vectors), product, j)
        self._carry(sample, v, slopes[self.pattern.outputs :])

    def _weigh(self, sample: "_TapeSample", v: Vector, slopes: Rows, j: str) -> None:
        """Write halves and reach of eight entries; add their parts of the gradient and of R P."""
        m, n = self.pattern.outputs, self.pattern.carried
        vectors = [v.load(row, j) for row in slopes]
        # of eight entries, from Q B and W D:
        # reach[i] = sum over j of A[j,i] (Q B)[j] + sum over o of C[o,i] (W D)[o],   gradient = B' L + D' W r
        wd = [v.multiply(vector, weight) for vector, weight in zip(vectors, sample.weight, strict=False)]
        qb = [_products(v, sample.q[i * n : i * n + n], vectors[m:]) for i in range(n)]
        reach = [_products(v, [*sample.a[i::n], *sample.c[i::n]], [*qb, *wd]) for i in range(n)]
        gradient = _products(v, [*sample.l, *sample.residual], [*vectors[m:], *wd])
        for row, vector in zip(self.halves, [*wd, *qb], strict=True):
            v.store(v.multiply(vector, HALF), row, j)
        for row, vector in zip(self.reach, reach, strict=True):
            v.store(vector, row, j)
        v.store(v("fadd", v.load(self.gradient, j), gradient), self.gradient, j)
        # (R P)[i] = sum over j of R[j] P[j,i]: column i of P
        for row, column in zip(self.total, zip(*self.carried, strict=True), strict=True):
            v.store(_plus_products(v, v.load(row, j), [p.get() for p in column], reach), row, j)

    def _carry(self, sample: "_TapeSample", v: Vector, slopes: Rows) -> None:
        """Compute T of the next sample, A T + B, and A P; `slopes` are the rows of B."""
        n = self.pattern.carried
        rows = [sample.a[i * n : i * n + n] for i in range(n)]
        with _vectors(self.f, self.used) as j:
            # all rows of T are read before one is written
            old = [v.load(own, j) for own in self.own]
            new = [_plus_products(v, v.load(own, j), row, old) for own, row in zip(slopes, rows, strict=True)]
            for own, value in zip(self.own, new, strict=True):
                v.store(value, own, j)
        # P[k+1] = A P[k], by the values before any of them changes
        before = [[p.get() for p in row] for row in self.carried]
        for own_row, row in zip(self.carried, rows, strict=True):
            for p, column in zip(own_row, zip(*before, strict=True), strict=True):
                p.set(dot(self.f, row, column))

    def finish(self) -> None:
        """Add the sums of the batch to gradient and matrix, and compute S after it, P S + T."""
        f, entries, n = self.f, self.entries, self.pattern.carried
        with f.loop(0, entries.count) as e:
            column = entries.column(e)
            f.increase(f.load(self.gradient, e), "%gradient", column)
            row, products = f.at("%matrix", f.mul(column, "%columns")), f.at(self.products, f.mul(e, self.stride))
            with f.loop(0, entries.count) as other:
                # added one by one, as two entries of a sample may have the same column
                f.increase(f.load(products, other), row, entries.column(other))
        # with S at the first sample of the batch, so before S is carried over it
        _add_sensitivities(f, entries, self.total[0], self.stride)
        rows = [f.at("%sensitivities", f.mul("%width", i)) for i in range(n)]
        carried = [[p.get() for p in row] for row in self.carried]
        with f.loop(0, whole_width(f)) as j:
            old = [f.load(row, j) for row in rows]
            for row, value in zip(rows, [dot(f, p, old) for p in carried], strict=True):
                f.store(value, row, j)
        with f.loop(0, entries.count) as e:
            column = entries.column(e)
            with reaching(f, column):
                for row, own in zip(rows, self.own, strict=True):
                    f.increase(f.load(own, e), row, column)


@contextmanager
def _vectors(f: FunctionWriter, end: str) -> Iterator[str]:
    """Run the body for the first of each eight entries."""
    with f.walk(end) as (j, position):
        yield j
        position.set(f.add(j, LANES))


def _plus_products(v: Vector, total: str, factors: Rows, vectors: Rows) -> str:
    """Return a vector plus the products of doubles with vectors; some doubles are structurally zero."""
    for factor, vector in zip(factors, vectors, strict=True):
        if factor != ZERO:
            total = v("fadd", total, v.multiply(vector, factor))
    return total


def _products(v: Vector, factors: Rows, vectors: Rows) -> str:
    """Return the sum of the products of doubles with vectors."""
    return _plus_products(v, v.all(0.0), factors, vectors)


class _TapeSample:
    """The tape of one sample, loaded, without its entries."""

    def __init__(self, f: FunctionWriter, pattern: TapeLayout, k: str) -> None:
        m, n = pattern.outputs, pattern.carried
        self.residual, self.weight = load_row(f, "%residual", k, m), load_row(f, "%weight", k, m)
        self.c, self.a = load_row(f, "%c", k, m * n, pattern.c), load_row(f, "%a", k, n * n, pattern.a)
        self.q, self.l = load_row(f, "%q_next", k, n * n), load_row(f, "%l_next", k, n)


def _add_sensitivities(f: FunctionWriter, entries: TapeEntries, reach: str, stride: str) -> None:
    """Add rows of S times the reach [n][stride] to the rows of the matrix, two at a time if they differ."""

    def add(rows: Rows, e: str) -> None:
        factors = (("ptr", f.at(reach, e)), ("i64", stride))
        f.call(
            f"add_rows_{len(rows)}",
            [*(("ptr", row) for row in rows), ("ptr", "%sensitivities"), ("i64", "%width"), *factors],
        )

    def row(e: str) -> str:
        return f.at("%matrix", f.mul(entries.column(e), "%columns"))

    with f.walk(entries.count) as (e, position):
        following = f.add(e, 1)
        # two rows at a time read S once for both; equal columns are one row, which a pair would write twice
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


def _add_rows_function(count: int, states: int) -> FunctionWriter:
    """Write `add_rows_COUNT(rows..., sensitivities, width, factors, stride)`: rows += factors times rows of S."""
    rows = [f"row{i}" for i in range(count)]
    pointers = [("ptr noalias", name) for name in (*rows, "sensitivities")]
    parameters = [*pointers, ("i64", "width"), ("ptr noalias", "factors"), ("i64", "stride")]
    f = FunctionWriter(f"add_rows_{count}", parameters, "noinline")
    # loaded once, ahead of the loop over the columns
    coefficients = [[f.load(f.at("%factors", f.mul("%stride", t)), i) for t in range(states)] for i in range(count)]
    sources = [f.at("%sensitivities", f.mul("%width", t)) for t in range(states)]
    with f.loop(0, whole_width(f)) as j:
        values = [f.load(source, j) for source in sources]
        for name, own in zip(rows, coefficients, strict=True):
            f.increase(dot(f, own, values), f"%{name}", j)
    return f
