"""Gradient and Gauss-Newton matrix of models without states, from a tape, several samples at a time.

Consecutive samples mostly touch the same grid points. A batch of them is written as dense rows over all columns that it
touches. The products of these rows are computed in tiles of eight by eight, and the sums are read and written once for
a batch. Entries without a slope are left out: of a hundred tables from which a condition selects, each sample has the
entries of one.
"""

from collections.abc import Callable

from kennfeld.base.machine_code.ir import EIGHT, HALF, LANES, ZERO, FunctionWriter, Vector
from kennfeld.native import block_matrix
from kennfeld.native.tape_reader import ENTRIES, TapeEntries

BATCH = 64  # samples
SPREAD = 2  # times the most entries of a sample: columns that a batch may touch
TAPE = (("i64", "length"), ("ptr", "residual"), ("ptr", "weight"), *ENTRIES, ("ptr", "gradient"))
DENSE = (("ptr", "matrix"), ("i64", "stride"))
# for each column its number in the batch, -1 if it has none; the columns of the batch; its rows; those times weights
SCRATCH = (("ptr", "number"), ("ptr", "columns"), ("ptr", "rows"), ("ptr", "weighted"), ("i64", "width"))
RESUMED = (("i64", "capacity"), ("ptr", "next"))

Add = Callable[[FunctionWriter, str, str, str], None]  # to the entry in two columns


def batch_width(room: int) -> int:
    """Return the number of columns for which a batch needs memory if a sample has up to `room` entries."""
    # beside those of a full batch, the columns of the sample that is found not to fit
    return -(-(1 + SPREAD) * room // LANES) * LANES


def dense_sums(outputs: int) -> FunctionWriter:
    """Write `normal(length, residual, weight, entries, gradient, matrix, stride, scratch)`.

        gradient += D' W r,   G += D' W D below the diagonal, half of it on the diagonal

    for D [outputs, free] of each sample, stored as entries (column, slopes [outputs]). The matrix is G + G'.
    """
    f = FunctionWriter("normal", [*TAPE, *DENSE, *SCRATCH])

    def add(f: FunctionWriter, row: str, column: str, value: str) -> None:
        f.increase(value, "%matrix", f.add(f.mul(row, "%stride"), column))

    with f.walk("%length") as (k, position):
        batch = _Batch(f, k, outputs)
        batch.add_sums(add, HALF)
        position.set(batch.end.get())
    return f


def block_sums(outputs: int, *, full: bool) -> FunctionWriter:
    """Write `normal(length, ..., gradient, blocks, scratch, capacity, next)`: the same into a block matrix.

    It begins at sample `next` and ends early, with `next` at the first sample that is missing, if the blocks of a batch
    might exceed the `capacity`. `full` is for matrices of which all blocks are stored.
    """
    f = FunctionWriter("normal", [*TAPE, *block_matrix.BLOCKS, *SCRATCH, *RESUMED])
    with f.walk("%length", f.load("%next", kind="i64")) as (k, position):
        batch = _Batch(f, k, outputs)
        used = batch.used.get()
        # each pair of columns may need a block of its own
        needed = f.add(f.load("%used", kind="i64"), f.mul(used, used))
        fits = f.new(f"icmp sle i64 {needed}, %capacity")
        with f.when(f.new(f"xor i1 {fits}, true")):
            batch.forget_columns()
            f.do("ret void")
            f.begin(f.label("on"))
        batch.add_sums(block_matrix.add_to_full if full else block_matrix.add_to_block, None)
        end = batch.end.get()
        f.store(end, "%next", kind="i64")
        position.set(end)
    return f


class _Batch:
    """Samples from k to before `end`, and the number of columns that they touch.

    A sample joins if fewer products are added to the sums for all samples together than for it apart. Writes the code
    that numbers the columns.
    """

    def __init__(self, f: FunctionWriter, k: str, outputs: int) -> None:
        self.f, self.first, self.outputs = f, k, outputs
        self.end, self.used = f.variable("i64", k), f.variable("i64", "0")
        last = f.extreme("smin", f.add(k, BATCH), "%length")
        with f.walk(last, k) as (sample, position):
            before = self.used.get()
            own = self._number_columns(sample)
            now = self.used.get()
            # products on both sides of the diagonal: (columns together)^2 against the sum of both squares
            apart = f.add(f.mul(before, before), f.mul(own, own))
            worse = f.new(f"icmp sgt i64 {f.mul(now, now)}, {apart}")
            full = f.new(f"icmp sgt i64 {now}, {f.mul('%room', SPREAD)}")
            # the first sample always joins, however many columns it has
            late = f.new(f"icmp sgt i64 {sample}, {k}")
            ends = f.new(f"and i1 {f.new(f'or i1 {worse}, {full}')}, {late}")
            position.set(f.add(sample, 1))
            with f.when(ends):
                # the sample that ends the batch gives the numbers of its columns back
                self.forget_columns(before)
                position.set(last)
            with f.when(f.new(f"xor i1 {ends}, true")):
                self.end.set(f.add(sample, 1))

    def _each_entry(self, sample: str, work: Callable[[str, list[str]], None]) -> None:
        """Write code for each entry of a sample that has a slope, given its column and its slopes."""
        f = self.f
        entries = TapeEntries(f, sample, self.outputs)
        with f.loop(0, entries.count) as e:
            column, slopes = entries.read(e)
            flat = [f.new(f"fcmp oeq double {slope}, {ZERO}") for slope in slopes]
            with f.unless(*flat):
                work(column, slopes)

    def _number_columns(self, sample: str) -> str:
        """Write code that numbers the new columns of a sample; returns how many entries it has."""
        f = self.f
        own = f.variable("i64", "0")

        def number(column: str, _: list[str]) -> None:
            own.set(f.add(own.get(), 1))
            with f.when(f.new(f"icmp slt i32 {f.load('%number', column, 'i32')}, 0")):
                count = self.used.get()
                f.store(f.new(f"trunc i64 {count} to i32"), "%number", column, "i32")
                f.store(f.new(f"trunc i64 {column} to i32"), "%columns", count, "i32")
                self.used.set(f.add(count, 1))

        self._each_entry(sample, number)
        return own.get()

    def forget_columns(self, first: str = "0") -> None:
        """Write code that takes the numbers away, from the column `first` of the batch on."""
        f = self.f
        with f.loop(first, self.used.get()) as number:
            f.store("-1", "%number", f.load_index("%columns", number), "i32")
        self.used.set(first)

    def add_sums(self, add: Add, diagonal: str | None) -> None:
        """Write code that adds the products of the batch; entries on the diagonal are multiplied by a number."""
        f = self.f
        used = self.used.get()
        # of eight columns each; the rows of the batch are one per sample and output
        tiles = f.new(f"sdiv i64 {f.add(used, LANES - 1)}, {LANES}")
        count = f.mul(f.new(f"sub i64 {self.end.get()}, {self.first}"), self.outputs)
        self._fill(tiles)
        block = f.slot(EIGHT, LANES)
        with f.loop(0, tiles) as i:
            self._add_gradient(i, count, used, block)
            with f.loop(0, f.add(i, 1)) as j:
                self._multiply(i, j, count, block)
                self._add_tile(i, j, used, block, add, diagonal)
        self.forget_columns()

    def _row(self, array: str, row: str) -> str:
        return self.f.at(array, self.f.mul(row, "%width"))

    def _fill(self, tiles: str) -> None:
        """Write the rows of the batch."""
        f, m, v = self.f, self.outputs, Vector(self.f)
        with f.loop(self.first, self.end.get()) as sample:
            begin = f.mul(f.new(f"sub i64 {sample}, {self.first}"), m)
            rows = [self._row("%rows", f.add(begin, o)) for o in range(m)]
            for row in rows:
                with f.loop(0, tiles) as t:
                    v.store("zeroinitializer", row, f.mul(t, LANES))

            def put(column: str, slopes: list[str], rows: list[str] = rows) -> None:
                number = f.load_index("%number", column)
                for row, slope in zip(rows, slopes, strict=True):
                    # added, as a sample may touch a column twice
                    f.increase(slope, row, number)

            self._each_entry(sample, put)
            for o, row in enumerate(rows):
                weight = f.load("%weight", f.add(f.mul(sample, m), o))
                weighted = self._row("%weighted", f.add(begin, o))
                with f.loop(0, tiles) as t:
                    at = f.mul(t, LANES)
                    v.store(v.multiply(v.load(row, at), weight), weighted, at)

    def _add_gradient(self, tile: str, count: str, used: str, block: str) -> None:
        f, v = self.f, Vector(self.f)
        first = f.mul(tile, LANES)
        total = f.variable(EIGHT, "zeroinitializer")
        residual = f.at("%residual", f.mul(self.first, self.outputs))
        with f.loop(0, count) as row:
            product = v.multiply(v.load(self._row("%weighted", row), first), f.load(residual, row))
            total.set(v("fadd", total.get(), product))
        v.store(total.get(), block)
        with f.loop(first, f.extreme("smin", f.add(first, LANES), used)) as i:
            value = f.load(block, f.new(f"sub i64 {i}, {first}"))
            f.increase(value, "%gradient", f.load_index("%columns", i))

    def _multiply(self, i: str, j: str, count: str, block: str) -> None:
        """Write the products of eight columns with eight others to `block`, row by row."""
        f, v = self.f, Vector(self.f)
        across, down = f.mul(j, LANES), f.mul(i, LANES)
        sums = [f.variable(EIGHT, "zeroinitializer") for _ in range(LANES)]
        with f.loop(0, count) as row:
            # eight sums in registers: sum over rows of weighted[down + lane] times rows[across ...]
            vector = v.load(self._row("%rows", row), across)
            scalars = f.at(self._row("%weighted", row), down)
            for lane, total in enumerate(sums):
                total.set(v("fadd", total.get(), v.multiply(vector, f.load(scalars, lane))))
        for lane, total in enumerate(sums):
            v.store(total.get(), block, lane * LANES)

    def _add_tile(self, i: str, j: str, used: str, block: str, add: Add, diagonal: str | None) -> None:
        f = self.f
        top, left = f.mul(i, LANES), f.mul(j, LANES)
        with f.loop(top, f.extreme("smin", f.add(top, LANES), used)) as row:
            own = f.load_index("%columns", row)
            line = f.at(block, f.mul(f.new(f"sub i64 {row}, {top}"), LANES))
            # pairs below the diagonal by their numbers in the batch; in the matrix they may lie on either side
            with f.loop(left, f.extreme("smin", f.add(left, LANES), row)) as column:
                value = f.load(line, f.new(f"sub i64 {column}, {left}"))
                add(f, own, f.load_index("%columns", column), value)
            with f.when(f.new(f"icmp eq i64 {i}, {j}")):
                value = f.load(line, f.new(f"sub i64 {row}, {left}"))
                add(f, own, own, value if diagonal is None else f.fmul(diagonal, value))
