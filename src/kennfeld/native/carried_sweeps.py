"""Native sweeps over a tape with states for columns beside those of the kernel: products with its own, and their own.

A column b enters a sample as the kernel's own columns do, with slopes of the outputs, d, and of the states, e. With
sensitivities s of the states with respect to it, and the matrices A, C, D, B of `sweeps`,

    b[k] = C[k] s[k] + d[k],    s[k+1] = A[k] s[k] + e[k]

All b of a few samples are computed forward. With rows of the kernel J[k] = C[k] S[k] + D[k], the sum of J' W b over
these samples then follows backward, without a row of J, from what later samples of them make of a state:

    z = 0 after the last one,    z[k] = A' z[k+1] + C' W b
    jb += D' W b + B' z[k+1],    bb += d' W b + e' z[k+1]
    at the first one:    jb += S' z,    bb += s' z

A sample has a few entries in D and B, and two hats of an axis in d and e, so that each touches few rows of the sums; S
is needed at the first sample alone. A state of latency l has l rows of s, S and z in ring buffers at the same places.
"""

from collections.abc import Sequence

from kennfeld.base.machine_code.ir import LANES, ONE, ZERO, FunctionWriter, Vector
from kennfeld.native.tape_layout import TapeLayout
from kennfeld.native.tape_reader import ENTRIES, Rows, TapeEntries, dot, load_row, times

PART = 128  # samples that are swept forward, then backward, so that their columns stay in the cache
STRIP = 2  # vectors of columns whose part of J'WB is added at a time
TILE = 4  # factors are padded to a multiple of this
OWN, IGNORED = -1, -2  # roles of a column of the kernel: has rows of J'WB, or is none; else the number of its probe

TAPE = (*((("ptr", name)) for name in ("weight", "residual", "c", "a")), *ENTRIES)
CARRIED = (("ptr", "sensitivities"), ("i64", "width"), ("ptr", "rings"), ("ptr", "roles"), ("i64", "free"))
FACTORS = (("ptr", "probe_of"), ("i64", "factors"), ("i64", "probes"), ("ptr", "scales"))
HATS = (("ptr", "cells"), ("ptr", "shares"), ("ptr", "sides"), ("i64", "axes"), ("ptr", "hats"))
SUMS = (("ptr", "own"), ("ptr", "jb"), ("ptr", "squares"), ("ptr", "br"), ("ptr", "scratch"))


def pitch(hats: int, width: int) -> int:
    """Return the doubles of a row of an axis with so many hats and factors, padded to whole vectors."""
    return _padded(hats * width)


def scratch_size(pattern: TapeLayout, width: int, probes: int, entries: int, hats: Sequence[int]) -> int:
    """Return the number of doubles of `scratch` of `products_function`."""
    longest, rows = max(pitch(count, width) for count in hats), pattern.rows
    own = _padded(rows * probes) + _padded(PART) + PART * _padded(entries * (rows + 1))
    return own + PART * rows * (width + longest) + 2 * sum(pattern.latencies) * longest


def _padded(size: int) -> int:
    return -(-size // LANES) * LANES


class _Rings:
    """The oldest row of each state in its ring buffer.

    Args:
        f: the function.
        latencies: of the states.
        places: array of the indices of these rows; without, one of the function.
    """

    def __init__(self, f: FunctionWriter, latencies: Sequence[int], places: str = "") -> None:
        self._f, self._latencies = f, latencies
        self._places = places or f.slot("i64", max(len(latencies), 1))

    def copy(self, places: str) -> None:
        """Begin at the places of others."""
        for i in range(len(self._latencies)):
            self._f.store(self._f.load(places, i, "i64"), self._places, i, "i64")

    def rows(self, array: str, width: str) -> Rows:
        """Return the addresses of these rows."""
        f, first = self._f, 0
        rows: Rows = []
        for i, latency in enumerate(self._latencies):
            place = str(first) if latency == 1 else f.add(f.load(self._places, i, "i64"), first)
            rows.append(f.at(array, f.mul(width, place)))
            first += latency
        return rows

    def forward(self) -> None:
        for i, latency in enumerate(self._latencies):
            if latency > 1:
                self._f.advance(self._places, i, latency)

    def back(self) -> None:
        f = self._f
        for i, latency in enumerate(self._latencies):
            if latency > 1:
                place = f.load(self._places, i, "i64")
                first = f.new(f"icmp eq i64 {place}, 0")
                f.store(f.new(f"select i1 {first}, i64 {latency - 1}, i64 {f.add(place, -1)}"), self._places, i, "i64")


def _whole(f: FunctionWriter, size: str) -> str:
    """Return a size that is padded to whole vectors."""
    return f.new(f"and i64 {f.add(size, LANES - 1)}, {-LANES}")


def _pull(f: FunctionWriter, k: str, outputs: int) -> tuple[Rows, Rows]:
    """Return W and W r of a sample, 0 where it is not scored, whatever its residual."""
    weights, residuals = load_row(f, "%weight", k, outputs), load_row(f, "%residual", k, outputs)
    scored = [f.new(f"fcmp one double {weight}, {ZERO}") for weight in weights]
    pulls = [f.fmul(weight, residual) for weight, residual in zip(weights, residuals, strict=True)]
    return weights, [f.select(condition, pull, ZERO) for condition, pull in zip(scored, pulls, strict=True)]


def _combined(v: Vector, terms: Sequence[tuple[str, str]]) -> str:
    """Return the sum of vectors times doubles of which some are structurally zero."""
    total = ""
    for factor, vector in terms:
        if factor != ZERO:
            product = v("fmul", v.splat(factor), vector)
            total = v("fadd", total, product) if total else product
    return total or "zeroinitializer"


def _advance(f: FunctionWriter, pattern: TapeLayout, first: str, end: str) -> None:
    """Carry S over samples: S <- A S + B."""
    v, n, rings = Vector(f), pattern.carried, _Rings(f, pattern.latencies, "%rings")
    with f.loop(first, end) as k:
        rows, a = rings.rows("%sensitivities", "%width"), load_row(f, "%a", k, n * n, pattern.a)
        with f.loop(0, f.new(f"sdiv i64 %width, {LANES}")) as vector:
            at = f.mul(vector, LANES)
            old = [v.load(row, at) for row in rows]
            for i, row in enumerate(rows):
                v.store(_combined(v, [*zip(a[i * n : i * n + n], old, strict=True)]), row, at)
        entries = TapeEntries(f, k, pattern.rows)
        with f.loop(0, entries.count) as e:
            column, slopes = entries.column(e), entries.slopes(e)
            wanted = f.new(f"icmp eq i32 {f.load('%roles', column, 'i32')}, {OWN}")
            reaches = f.new(f"icmp slt i64 {column}, %width")
            with f.when(f.new(f"and i1 {wanted}, {reaches}")):
                for i, row in enumerate(rows):
                    f.increase(f.load(slopes, pattern.outputs + i), row, column)
        rings.forward()


def pulls_function(pattern: TapeLayout) -> FunctionWriter:
    """Write `pulls(length, tape, carried, z, jr)`: jr += J'Wr, Float[free], and carry S over the samples."""
    f = FunctionWriter("pulls", [("i64", "length"), *TAPE, *CARRIED, ("ptr", "z"), ("ptr", "jr")])
    m, n, depth = pattern.outputs, pattern.carried, sum(pattern.latencies)
    rings = _Rings(f, pattern.latencies)
    rings.copy("%rings")
    f.do(f"call void @llvm.memset.p0.i64(ptr %z, i8 0, i64 {8 * depth}, i1 false)")
    # once around the rings, so that they stand as after the last sample
    with f.loop(0, "%length"):
        rings.forward()
    with f.loop(0, "%length") as behind:
        k = f.new(f"sub i64 {f.add('%length', -1)}, {behind}")
        rings.back()
        places = rings.rows("%z", "1")
        later, (_, pulls) = [f.load(place) for place in places], _pull(f, k, m)
        c, a = load_row(f, "%c", k, m * n, pattern.c), load_row(f, "%a", k, n * n, pattern.a)
        entries = TapeEntries(f, k, pattern.rows)
        with f.loop(0, entries.count) as e:
            column, slopes = entries.read(e)
            f.increase(f.dot([*zip(slopes, [*pulls, *later], strict=True)]), "%jr", column)
        for i, place in enumerate(places):
            f.store(f.fadd(dot(f, a[i::n], later), dot(f, c[i::n], pulls)), place)
    with f.loop(0, depth) as slot, f.loop(0, f.extreme("smin", "%width", "%free")) as column:
        own = f.load("%sensitivities", f.add(f.mul(slot, "%width"), column))
        f.increase(f.fmul(own, f.load("%z", slot)), "%jr", column)
    _advance(f, pattern, "0", "%length")
    return f


def products_function(pattern: TapeLayout, width: int, corners: int, *, scaled: bool) -> FunctionWriter:
    """Write `products(length, tape, carried, factors, hats, sums)`: the sums over samples of one block.

    Args:
        pattern: of the tape.
        width: number of factors, padded to whole tiles.
        corners: pairs of neighbouring hats that a sample has on an axis: 1, of a map 2.
        scaled: True if the slopes of a sample are multiplied by `scales`, Float[samples, factors].
    """
    f = FunctionWriter("products", [("i64", "length"), *TAPE, *CARRIED, *FACTORS, *HATS, *SUMS])
    writer = _ProductsWriter(f, pattern, width, corners)
    with f.walk("%length") as (first, position):
        end = f.extreme("smin", f.add(first, PART), "%length")
        writer.write_factors(first, end, scaled=scaled)
        writer.write_entries(first, end)
        hats, columns, squares = (f.variable("i64", "0") for _ in range(3))
        with f.loop(0, "%axes") as axis:
            count = f.load_index("%hats", axis)
            row = _whole(f, f.mul(count, width))
            writer.begin_axis(axis, count, row, hats.get(), columns.get(), squares.get())
            writer.forward(first, end)
            writer.backward(first, end)
            writer.add_entries(first, end)
            writer.finish()
            hats.set(f.add(hats.get(), count))
            columns.set(f.add(columns.get(), row))
            squares.set(f.add(squares.get(), f.mul(count, row)))
        _advance(f, pattern, first, end)
        position.set(end)
    return f


class _ProductsWriter:
    """The sweeps over one part of the samples, for one axis after the other."""

    def __init__(self, f: FunctionWriter, pattern: TapeLayout, width: int, corners: int) -> None:
        self.f, self.pattern, self.width, self.corners = f, pattern, width, corners
        self.depth, self.tiles = sum(pattern.latencies), width // TILE
        self._v, self._tile = Vector(f), Vector(f, TILE)
        self._rings = _Rings(f, pattern.latencies)
        self._factors, self._probes = "%scratch", f.at("%scratch", PART * pattern.rows * width)
        self._counts = f.at(self._probes, _whole(f, f.mul("%probes", pattern.rows)))
        self._entry_size = _whole(f, f.mul("%room", pattern.rows + 1))
        self._entries = f.at(self._counts, _padded(PART))
        self._rest = f.at(self._entries, f.mul(self._entry_size, PART))

    def write_factors(self, first: str, end: str, *, scaled: bool) -> None:
        """Collect the slopes by the probes of all samples, Float[samples, rows, width]."""
        f, rows = self.f, self.pattern.rows
        with f.loop(first, end) as k:
            size = f.mul("%probes", 8 * rows)
            f.do(f"call void @llvm.memset.p0.i64(ptr {self._probes}, i8 0, i64 {size}, i1 false)")
            entries = TapeEntries(f, k, rows)
            with f.loop(0, entries.count) as e:
                probe = f.load_index("%roles", entries.column(e))
                slopes = entries.slopes(e)
                with f.when(f.new(f"icmp sge i64 {probe}, 0")):
                    for row in range(rows):
                        f.increase(f.load(slopes, row), self._probes, f.add(f.mul("%probes", row), probe))
            into = self._factors_of(first, k)
            with f.loop(0, "%factors") as factor:
                probe = f.load_index("%probe_of", factor)
                for row in range(rows):
                    slope = f.load(self._probes, f.add(f.mul("%probes", row), probe))
                    if scaled:
                        slope = f.fmul(slope, f.load("%scales", f.add(f.mul(k, "%factors"), factor)))
                    f.store(slope, into, f.add(factor, row * self.width))

    def write_entries(self, first: str, end: str) -> None:
        """Collect the entries in own columns: how many a sample has, and for each its column, W D and B."""
        f, m, rows = self.f, self.pattern.outputs, self.pattern.rows
        with f.loop(first, end) as k:
            weights, number = load_row(f, "%weight", k, m), f.variable("i64", "0")
            sample = f.new(f"sub i64 {k}, {first}")
            into, entries = f.at(self._entries, f.mul(sample, self._entry_size)), TapeEntries(f, k, rows)
            with f.loop(0, entries.count) as e:
                column, slopes = entries.read(e)
                with f.when(f.new(f"icmp eq i32 {f.load('%roles', column, 'i32')}, {OWN}")):
                    place = f.at(into, f.mul(number.get(), rows + 1))
                    f.store(f.mul(column, LANES), place, 0, "i64")
                    for row, slope in enumerate(slopes):
                        f.store(f.fmul(weights[row], slope) if row < m else slope, place, row + 1)
                    number.set(f.add(number.get(), 1))
            f.store(number.get(), self._counts, sample, "i64")

    def _factors_of(self, first: str, k: str) -> str:
        number = self.f.new(f"sub i64 {k}, {first}")
        return self.f.at(self._factors, self.f.mul(number, self.pattern.rows * self.width))

    def begin_axis(self, axis: str, hats: str, row: str, first: str, columns: str, squares: str) -> None:
        """Locate the arrays of an axis; `row` is the pitch of its rows, the others count what precedes it."""
        f = self.f
        self._axis, self._hats, self._row, self._first_hat = axis, hats, row, first
        self._own = f.at("%own", f.mul(columns, self.depth))
        self._jb = f.at("%jb", f.mul(columns, "%free"))
        self._br = f.at("%br", columns)
        self._squares = f.at("%squares", squares)
        self._z = self._rest
        self._begun = f.at(self._z, f.mul(row, self.depth))
        self._b = f.at(self._begun, f.mul(row, self.depth))

    def _rows_of(self, first: str, k: str) -> Rows:
        """Return the addresses of b by output, and of z[k+1] by state, of a sample."""
        f, rows = self.f, self.pattern.rows
        number = f.mul(f.new(f"sub i64 {k}, {first}"), rows)
        return [f.at(self._b, f.mul(f.add(number, row), self._row)) for row in range(rows)]

    def forward(self, first: str, end: str) -> None:
        """Compute b of all samples, and carry s over them."""
        f, v, pattern = self.f, self._v, self.pattern
        m, n = pattern.outputs, pattern.carried
        self._rings.copy("%rings")
        size = f.mul(self._row, 8 * self.depth)
        f.do(f"call void @llvm.memcpy.p0.p0.i64(ptr {self._begun}, ptr {self._own}, i64 {size}, i1 false)")
        with f.loop(first, end) as k:
            c, a = load_row(f, "%c", k, m * n, pattern.c), load_row(f, "%a", k, n * n, pattern.a)
            outputs, states = self._rows_of(first, k)[:m], self._rings.rows(self._own, self._row)
            with f.loop(0, f.new(f"sdiv i64 {self._row}, {LANES}")) as vector:
                at = f.mul(vector, LANES)
                old = [v.load(row, at) for row in states]
                for o, row in enumerate(outputs):
                    v.store(_combined(v, [*zip(c[o * n : o * n + n], old, strict=True)]), row, at)
                for i, row in enumerate(states):
                    v.store(_combined(v, [*zip(a[i * n : i * n + n], old, strict=True)]), row, at)
            factors = self._factors_of(first, k)
            for column, weight in self._sides(k):
                with f.when(f.new(f"fcmp une double {weight}, {ZERO}")):
                    for number, row in enumerate([*outputs, *states]):
                        self._inject(factors, number, weight, f.at(row, column))
            self._rings.forward()

    def _inject(self, factors: str, number: int, weight: str, target: str) -> None:
        """Add the slopes of a row by all factors, times the weight of a hat."""
        v = self._tile
        for tile in range(self.tiles):
            own = v.load(factors, number * self.width + tile * TILE)
            total = v("fadd", v.load(target, tile * TILE), v("fmul", v.splat(weight), own))
            v.store(total, target, tile * TILE)

    def _sides(self, k: str) -> list[tuple[str, str]]:
        """Return the first column and the weight of each hat that a sample may have on the axis."""
        f, sides = self.f, []
        for corner in range(self.corners):
            sample = f.add(f.mul("%length", corner), k)
            place = f.add(f.mul(sample, "%axes"), self._axis)
            hat, above = f.new(f"sub i64 {f.load_index('%cells', place)}, {self._first_hat}"), f.load("%shares", place)
            below = f.new(f"fsub double {ONE}, {above}")
            if self.corners > 1:
                whole = f.load("%sides", sample)
                below, above = f.fmul(below, whole), f.fmul(above, whole)
            sides += [(f.mul(hat, self.width), below), (f.mul(f.add(hat, 1), self.width), above)]
        return sides

    def backward(self, first: str, end: str) -> None:
        """Add the products of all samples, and compute z at the first."""
        f, pattern = self.f, self.pattern
        m, n = pattern.outputs, pattern.carried
        size = f.mul(self._row, 8 * self.depth)
        f.do(f"call void @llvm.memset.p0.i64(ptr {self._z}, i8 0, i64 {size}, i1 false)")
        with f.loop(first, end) as forward:
            k = f.new(f"sub i64 {f.add(end, -1)}, {f.new(f'sub i64 {forward}, {first}')}")
            self._rings.back()
            rows, later = self._rows_of(first, k), self._rings.rows(self._z, self._row)
            weights, pulls = _pull(f, k, m)
            self._add_squares(first, k, weights, [*rows[:m], *later])
            c, a = load_row(f, "%c", k, m * n, pattern.c), load_row(f, "%a", k, n * n, pattern.a)
            weighted = [times(f, weights[i // n], each) for i, each in enumerate(c)]
            self._step_back(rows, later, weighted, a, pulls)

    def add_entries(self, first: str, end: str) -> None:
        """Add D' W b + B' z to the rows of J'WB that the entries of the samples touch.

        A few columns at a time, whose part of J'WB fits the nearest cache.
        """
        f = self.f
        vectors = f.new(f"sdiv i64 {self._row}, {LANES}")
        strips = f.new(f"sdiv i64 {vectors}, {STRIP}")
        with f.loop(0, strips) as strip:
            self._add_strip(first, end, f.mul(strip, STRIP), STRIP)
        with f.loop(f.mul(strips, STRIP), vectors) as vector:
            self._add_strip(first, end, vector, 1)

    def _add_strip(self, first: str, end: str, vector: str, count: int) -> None:
        f, v, rows = self.f, self._v, self.pattern.rows
        vectors = [f.add(vector, number) for number in range(count)]
        targets = [f.at(self._jb, f.mul(f.mul(number, LANES), "%free")) for number in vectors]
        with f.loop(first, end) as k:
            sample, places = f.new(f"sub i64 {k}, {first}"), self._rows_of(first, k)
            own = [[v.load(row, f.mul(number, LANES)) for row in places] for number in vectors]
            entries = f.at(self._entries, f.mul(sample, self._entry_size))
            with f.loop(0, f.load(self._counts, sample, "i64")) as e:
                entry = f.at(entries, f.mul(e, rows + 1))
                column, slopes = f.load(entry, 0, "i64"), [f.load(entry, row + 1) for row in range(rows)]
                for target, vectors_of_rows in zip(targets, own, strict=True):
                    terms = [(ONE, v.load(target, column)), *zip(slopes, vectors_of_rows, strict=True)]
                    v.store(_combined(v, terms), target, column)

    def _add_squares(self, first: str, k: str, weights: Rows, rows: Rows) -> None:
        """Add d' W b + e' z to the products of the hats of a sample with all hats of the axis."""
        f, v, m = self.f, self._tile, self.pattern.outputs
        factors, sides = self._factors_of(first, k), self._sides(k)
        targets = [
            f.at(self._squares, f.mul(f.new(f"sdiv i64 {column}, {self.width}"), self._row)) for column, _ in sides
        ]
        scaled = [
            [v.load(factors, number * self.width + tile * TILE) for tile in range(self.tiles)]
            for number in range(len(rows))
        ]
        for o in range(m):
            scaled[o] = [v("fmul", v.splat(weights[o]), tile) for tile in scaled[o]]
        with f.loop(0, self._hats) as hat:
            for tile in range(self.tiles):
                at = f.add(f.mul(hat, self.width), tile * TILE)
                pull = ""
                for own, row in zip(scaled, rows, strict=True):
                    product = v("fmul", own[tile], v.load(row, at))
                    pull = v("fadd", pull, product) if pull else product
                for target, (_, weight) in zip(targets, sides, strict=True):
                    v.store(v("fadd", v.load(target, at), v("fmul", v.splat(weight), pull)), target, at)

    def _step_back(self, rows: Rows, later: Rows, c: Rows, a: Rows, pulls: Rows) -> None:
        """Keep z[k+1] and replace it by z[k], and add b W r."""
        f, v, m, n = self.f, self._v, self.pattern.outputs, self.pattern.carried
        with f.loop(0, f.new(f"sdiv i64 {self._row}, {LANES}")) as vector:
            at = f.mul(vector, LANES)
            b, z = [v.load(row, at) for row in rows[:m]], [v.load(row, at) for row in later]
            v.store(_combined(v, [(ONE, v.load(self._br, at)), *zip(pulls, b, strict=True)]), self._br, at)
            for i, row in enumerate(later):
                v.store(z[i], rows[m + i], at)
                v.store(_combined(v, [*zip(a[i::n], z, strict=True), *zip(c[i::n], b, strict=True)]), row, at)

    def finish(self) -> None:
        """Add what samples before this part contribute: S' z and s' z."""
        f, v, tile = self.f, self._v, self._tile
        reached = f.extreme("smin", "%width", "%free")
        with f.loop(0, f.new(f"sdiv i64 {self._row}, {LANES}")) as vector, f.loop(0, self.depth) as slot:
            place = f.mul(vector, LANES)
            into = f.at(self._jb, f.mul(place, "%free"))
            later, begun = v.load(self._z, f.add(f.mul(slot, self._row), place)), f.mul(slot, "%width")
            with f.loop(0, reached) as column:
                factor, at = v.splat(f.load("%sensitivities", f.add(begun, column))), f.mul(column, LANES)
                v.store(v("fadd", v.load(into, at), v("fmul", factor, later)), into, at)
        with f.loop(0, self.depth) as slot, f.loop(0, self._hats) as hat:
            begun = f.at(self._begun, f.add(f.mul(slot, self._row), f.mul(hat, self.width)))
            into, z = f.at(self._squares, f.mul(hat, self._row)), f.at(self._z, f.mul(slot, self._row))
            own = [tile.load(begun, number * TILE) for number in range(self.tiles)]
            with f.loop(0, self._hats) as other:
                for number, factor in enumerate(own):
                    at = f.add(f.mul(other, self.width), number * TILE)
                    tile.store(tile("fadd", tile.load(into, at), tile("fmul", factor, tile.load(z, at))), into, at)
