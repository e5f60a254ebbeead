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

from functools import cache, cached_property

from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import ZERO, FunctionWriter
from kennfeld.native.forward_sweep import forward_functions
from kennfeld.native.jacobian_sweeps import rows_functions
from kennfeld.native.sample_sums import block_sums, dense_sums
from kennfeld.native.tape_layout import TapeLayout
from kennfeld.native.tape_reader import ENTRIES, TapeEntries, dot, load_row, times


class Sweeps:
    """Native sweeps for tapes of one layout, each compiled when first used."""

    def __init__(self, pattern: TapeLayout) -> None:
        self.pattern = pattern

    @cached_property
    def normal(self) -> NativeFunction:
        return compile_functions(dense_sums(self.pattern.outputs), loops=True)["normal"]

    @cached_property
    def block_normal(self) -> NativeFunction:
        return compile_functions(block_sums(self.pattern.outputs, full=False), loops=True)["normal"]

    @cached_property
    def full_normal(self) -> NativeFunction:
        return compile_functions(block_sums(self.pattern.outputs, full=True), loops=True)["normal"]

    @cached_property
    def backward(self) -> NativeFunction:
        return compile_functions(_backward(self.pattern), loops=True)["backward"]

    @cached_property
    def forward(self) -> NativeFunction:
        return compile_functions(*forward_functions(self.pattern), loops=True)["forward"]

    @cached_property
    def rows(self) -> NativeFunction:
        return compile_functions(*rows_functions(self.pattern), loops=True)["rows"]

    @cached_property
    def touched(self) -> NativeFunction:
        return compile_functions(_touched(self.pattern))["touched"]

    @cached_property
    def fold(self) -> NativeFunction:
        return compile_functions(_fold())["fold"]


@cache
def sweeps(pattern: TapeLayout) -> Sweeps:
    """Return the sweeps of a layout; kernels of the same layout share them."""
    return Sweeps(pattern)


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
        # in registers, so that Q[k] and L[k] can replace them below
        q, l_next = load_row(f, "%q", "0", n * n), load_row(f, "%l", "0", n)
        for array, values, size in (("%q_next", q, n * n), ("%l_next", l_next, n)):
            base = f.mul(k, size)
            for i, value in enumerate(values):
                f.store(value, array, f.add(base, i))
        residual, weight = load_row(f, "%residual", k, m), load_row(f, "%weight", k, m)
        c, a = load_row(f, "%c", k, m * n, pattern.c), load_row(f, "%a", k, n * n, pattern.a)
        wc = [[times(f, weight[o], c[o * n + i]) for i in range(n)] for o in range(m)]
        qa = [[dot(f, q[i * n : i * n + n], a[j::n]) for j in range(n)] for i in range(n)]
        for i in range(n):
            weighted = [row[i] for row in wc]  # column i of W C
            for j in range(n):  # Q[k] = A' (Q[k+1] A) + C' W C
                later = dot(f, a[i::n], [row[j] for row in qa])
                f.store(f.fadd(later, dot(f, weighted, c[j::n])), "%q", i * n + j)
            now = dot(f, weighted, residual)  # L[k] = A' L[k+1] + C' W r
            f.store(f.fadd(dot(f, a[i::n], l_next), now), "%l", i)
    return f


def _touched(pattern: TapeLayout) -> FunctionWriter:
    """Write `touched(length, weight, entries, first, latest, counts)`: count samples by the columns in which they act.

    A scored sample adds 1 to `counts` of each column in which it has a slope; without states, in which a scored output
    has one. `latest` is the last such sample of each column; `first` is the number of the first sample of the tape.
    """
    numbers = (("i64", "first"), ("ptr", "latest"), ("ptr", "counts"))
    f = FunctionWriter("touched", [("i64", "length"), ("ptr", "weight"), *ENTRIES, *numbers])
    with f.loop(0, "%length") as k:
        weights = load_row(f, "%weight", k, pattern.outputs)
        # unordered: a weight that is NaN does not count either
        unscored = [f.new(f"fcmp ule double {weight}, {ZERO}") for weight in weights]
        entries, sample = TapeEntries(f, k, pattern.rows), f.add("%first", k)
        with f.unless(*unscored), f.loop(0, entries.count) as e:
            column, slopes = entries.read(e)
            flat = [f.new(f"fcmp oeq double {slope}, {ZERO}") for slope in slopes]
            # with states, a slope of a state counts as well, since it acts on later samples
            if not pattern.carried:
                flat = [f.new(f"or i1 {a}, {b}") for a, b in zip(flat, unscored, strict=True)]
            with f.unless(*flat):
                # a sample may touch a column twice
                known = f.new(f"icmp eq i64 {f.load('%latest', column, 'i64')}, {sample}")
                with f.unless(known):
                    f.store(sample, "%latest", column, "i64")
                    f.store(f.add(f.load("%counts", column, "i64"), 1), "%counts", column, "i64")
    return f


def _fold() -> FunctionWriter:
    """Write `fold(matrix, columns, count)`: H = G + G' in place for `count` columns, in blocks that fit the cache."""
    f = FunctionWriter("fold", [("ptr", "matrix"), ("i64", "columns"), ("i64", "count")])
    # a block and its mirror image, which is read by columns, take 16 KB of the nearest cache
    block = 32
    blocks = f.new(f"sdiv i64 {f.add('%count', block - 1)}, {block}")
    with f.loop(0, blocks) as bi, f.loop(0, f.add(bi, 1)) as bj:
        top, left = f.mul(bi, block), f.mul(bj, block)
        bottom, right = (f.extreme("smin", f.add(first, block), "%count") for first in (top, left))
        with f.loop(top, bottom) as i:
            # each pair once, from below the diagonal
            end = f.extreme("smin", right, f.add(i, 1))
            row = f.at("%matrix", f.mul(i, "%columns"))
            with f.loop(left, end) as j:
                mirror = f.at("%matrix", f.add(f.mul(j, "%columns"), i))
                both = f.fadd(f.load(row, j), f.load(mirror))
                f.store(both, row, j)
                f.store(both, mirror)
    return f
