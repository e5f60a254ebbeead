"""Sums over a tape of linearised steps: gradient and Gauss-Newton matrix, or the Jacobian's rows.

They know the numbers of outputs m and of carried states n, and nothing of the model. Every sum goes into a matrix G
with H = G + G', which takes repeated columns as they come: `fold` makes H of it. The recursions are those of
DESIGN.md, "Exact derivatives".
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

from kennfeld.native.engine import Engine
from kennfeld.native.ir import Function, literal

__all__ = ["Pattern", "Sweeps", "sweeps"]

ZERO, HALF = literal(0.0), literal(0.5)
Rows = list[str]


@dataclass(frozen=True)
class Pattern:
    """Sizes of a tape and where its matrices can differ from zero."""

    outputs: int
    latencies: tuple[int, ...]  # of the carried states
    c: frozenset[int]  # flat indices into c[outputs][carried]
    a: frozenset[int]  # flat indices into a[carried][carried]

    @property
    def carried(self) -> int:
        """How many states carry the influence of a free value."""
        return len(self.latencies)

    @property
    def accumulates(self) -> bool:
        """Whether the backward and forward sweeps exist: a delay's memory is too long for Q."""
        return 0 < self.carried <= 8 and set(self.latencies) == {1}


class Sweeps:
    """The native sweeps for tapes of one pattern, each compiled when it is first used."""

    def __init__(self, pattern: Pattern) -> None:
        self.pattern = pattern

    @cached_property
    def normal(self) -> Callable[..., None]:
        """See `_normal`."""
        return _compiled(_normal(self.pattern))

    @cached_property
    def backward(self) -> Callable[..., None]:
        """See `_backward`."""
        return _compiled(_backward(self.pattern))

    @cached_property
    def forward(self) -> Callable[..., None]:
        """See `_forward`."""
        return _compiled(_forward(self.pattern))

    @cached_property
    def rows(self) -> Callable[..., None]:
        """See `_rows`."""
        return _compiled(_rows(self.pattern))

    @cached_property
    def fold(self) -> Callable[..., None]:
        """See `_fold`."""
        return _compiled(_fold())


@cache
def sweeps(pattern: Pattern) -> Sweeps:
    """The sweeps of a pattern; kernels that share it share them."""
    return Sweeps(pattern)


def _compiled(f: Function) -> Callable[..., None]:
    return Engine(f.text()).function(f.name, f.parameters)


def _row(f: Function, array: str, k: str, size: int, present: Collection[int] | None = None) -> Rows:
    """The `size` doubles of sample k; zero where they are not `present`."""
    base = f.mul(k, size)
    return [f.load(array, f.add(base, i)) if present is None or i in present else ZERO for i in range(size)]


def _dot(f: Function, a: Sequence[str], b: Sequence[str]) -> str:
    return f.dot([(x, y) for x, y in zip(a, b, strict=True) if ZERO not in (x, y)])


def _times(f: Function, a: str, b: str) -> str:
    return ZERO if ZERO in (a, b) else f.fmul(a, b)


def _entries(f: Function, k: str, width: int) -> tuple[str, Callable[[str], tuple[str, Rows]]]:
    """How many entries sample k has, and a reader of their column and slopes."""
    count = f.new(f"sext i32 {f.load('%count', k, 'i32')} to i64")
    start = f.mul(k, "%room")

    def read(number: str) -> tuple[str, Rows]:
        place = f.add(start, number)
        column = f.new(f"sext i32 {f.load('%index', place, 'i32')} to i64")
        base = f.at("%slope", f.mul(place, width))
        return column, [f.load(base, i) for i in range(width)]

    return count, read


ENTRIES = (("ptr", "index"), ("ptr", "slope"), ("ptr", "count"), ("i64", "room"))
SUMS = (("ptr", "matrix"), ("i64", "columns"), ("ptr", "gradient"))


def _normal(pattern: Pattern) -> Function:
    """`normal(length, residual, weight, entries, sums)`: without states, sparse rows go straight into the sums."""
    m = pattern.outputs
    head = [("i64", "length"), ("ptr", "residual"), ("ptr", "weight")]
    f = Function("normal", [*head, *ENTRIES, *SUMS])
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
    f: Function,
    e: str,
    column: str,
    read: Callable[[str], tuple[str, Rows]],
    product: Callable[[Rows], str],
    own: Rows,
) -> None:
    """Products of an entry with itself, halved, and with those before it."""
    row = f.at("%matrix", f.mul(column, "%columns"))
    f.increase(f.fmul(HALF, product(own)), row, column)
    with f.loop(0, e) as other:
        other_column, other_slopes = read(other)
        f.increase(product(other_slopes), row, other_column)


def _backward(pattern: Pattern) -> Function:
    """`backward(length, residual, weight, c, a, q, l, q_next, l_next)`: Q and L, the later steps' share of the cost.

    `q`, `l` come in as of after the last sample and leave as of the first; `q_next[k]`, `l_next[k]` are those after k.
    """
    m, n = pattern.outputs, pattern.carried
    names = ("residual", "weight", "c", "a", "q", "l", "q_next", "l_next")
    f = Function("backward", [("i64", "length"), *(("ptr", name) for name in names)])
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
            for j in range(n):
                later = _dot(f, a[i::n], [qa[x][j] for x in range(n)])
                now = _dot(f, [wc[o][i] for o in range(m)], [c[o * n + j] for o in range(m)])
                f.store(f.fadd(later, now), "%q", i * n + j)
            now = _dot(f, [wc[o][i] for o in range(m)], residual)
            f.store(f.fadd(_dot(f, a[i::n], l), now), "%l", i)
    return f


def _forward(pattern: Pattern) -> Function:
    """`forward(length, ..., sensitivities, width, entries, sums)`: the sums, from S at the first sample to S after.

    `sensitivities` is S, n rows of `width`, the columns that can reach a state.
    """
    m, n = pattern.outputs, pattern.carried
    names = ("residual", "weight", "c", "a", "q_next", "l_next", "sensitivities")
    head = [("i64", "length"), *(("ptr", name) for name in names), ("i64", "width")]
    f = Function("forward", [*head, *ENTRIES, *SUMS])
    s = [f.at("%sensitivities", f.mul("%width", i)) for i in range(n)]
    with f.loop(0, "%length") as k:
        residual, weight = _row(f, "%residual", k, m), _row(f, "%weight", k, m)
        c, a = _row(f, "%c", k, m * n, pattern.c), _row(f, "%a", k, n * n, pattern.a)
        q, l = _row(f, "%q_next", k, n * n), _row(f, "%l_next", k, n)  # noqa: E741
        count, read = _entries(f, k, m + n)
        with f.loop(0, count) as e:
            column, slopes = read(e)
            wd = [f.fmul(w, d) for w, d in zip(weight, slopes[:m], strict=True)]
            qb = [_dot(f, q[i * n : i * n + n], slopes[m:]) for i in range(n)]
            f.increase(f.fadd(_dot(f, slopes[m:], l), _dot(f, wd, residual)), "%gradient", column)
            _pairs(f, e, column, read, lambda other: _dot(f, [*wd, *qb], other), slopes)
            reach = [f.fadd(_dot(f, a[i::n], qb), _dot(f, c[i::n], wd)) for i in range(n)]
            _add_rows(f, f.at("%matrix", f.mul(column, "%columns")), s, reach)
        _step_sensitivities(f, s, a)
        with f.loop(0, count) as e:
            column, slopes = read(e)
            for i in range(n):
                f.increase(slopes[m + i], s[i], column)
    return f


def _add_rows(f: Function, target: str, rows: Rows, factors: Rows) -> None:
    """target[:width] += sum of factors times rows."""
    if all(factor == ZERO for factor in factors):
        return
    with f.loop(0, "%width") as j:
        f.increase(_dot(f, factors, [f.load(row, j) for row in rows]), target, j)


def _step_sensitivities(f: Function, s: Rows, a: Rows) -> None:
    """S <- A S, column by column."""
    n = len(s)
    with f.loop(0, "%width") as j:
        old = [f.load(row, j) for row in s]
        new = [_dot(f, a[i * n : i * n + n], old) for i in range(n)]
        for row, value in zip(s, new, strict=True):
            f.store(value, row, j)


def _rows(pattern: Pattern) -> Function:
    """`rows(length, weight, c, a, sensitivities, width, rings, entries, jacobian, columns)`: sqrt(w) times rows of J.

    A state of latency d has d rows of S in a ring; `rings[i]` is where its oldest one stands.
    """
    m, n, latencies = pattern.outputs, pattern.carried, pattern.latencies
    names = ("weight", "c", "a", "sensitivities")
    head = [("i64", "length"), *(("ptr", name) for name in names), ("i64", "width"), ("ptr", "rings"), ("ptr", "next")]
    f = Function("rows", [*head, *ENTRIES, ("ptr", "jacobian"), ("i64", "columns")])
    bases = [sum(latencies[:i]) for i in range(n)]
    with f.loop(0, "%length") as k:
        weight = _row(f, "%weight", k, m)
        roots = [f.new(f"call double @llvm.sqrt.f64(double {w})") for w in weight]
        c, a = _row(f, "%c", k, m * n, pattern.c), _row(f, "%a", k, n * n, pattern.a)
        places = [f.add(f.load("%rings", i, "i64"), bases[i]) for i in range(n)]
        s = [f.at("%sensitivities", f.mul("%width", place)) for place in places]
        out = [f.at("%jacobian", f.mul(f.add(f.mul(k, m), o), "%columns")) for o in range(m)]
        for o in range(m):
            with f.loop(0, "%columns") as j:
                f.store(ZERO, out[o], j)
            if n:
                factors = [_times(f, roots[o], c[o * n + i]) for i in range(n)]
                _add_rows(f, out[o], s, factors)
        if n:
            _next_rows(f, s, a)
        count, read = _entries(f, k, m + n)
        with f.loop(0, count) as e:
            column, slopes = read(e)
            for o in range(m):
                f.increase(f.fmul(roots[o], slopes[o]), out[o], column)
            for i in range(n):
                f.increase(slopes[m + i], f.at("%next", f.mul("%width", i)), column)
        _turn_rings(f, s, latencies)
    return f


def _next_rows(f: Function, s: Rows, a: Rows) -> None:
    """The next S, A S, without the entries' part."""
    n = len(s)
    with f.loop(0, "%width") as j:
        old = [f.load(row, j) for row in s]
        for i in range(n):
            f.store(_dot(f, a[i * n : i * n + n], old), f.at("%next", f.mul("%width", i)), j)


def _turn_rings(f: Function, s: Rows, latencies: Sequence[int]) -> None:
    """Put the next rows in the place of the oldest, and move on."""
    for i, latency in enumerate(latencies):
        with f.loop(0, "%width") as j:
            f.store(f.load(f.at("%next", f.mul("%width", i)), j), s[i], j)
        if latency > 1:
            following = f.add(f.load("%rings", i, "i64"), 1)
            wrapped = f.new(f"icmp eq i64 {following}, {latency}")
            f.store(f.new(f"select i1 {wrapped}, i64 0, i64 {following}"), "%rings", i, "i64")


def _fold() -> Function:
    """`fold(matrix, columns)`: G becomes H = G + G', in blocks that fit a cache."""
    f = Function("fold", [("ptr", "matrix"), ("i64", "columns")])
    block = 32
    blocks = f.new(f"sdiv i64 {f.add('%columns', block - 1)}, {block}")
    with f.loop(0, blocks) as bi, f.loop(0, f.add(bi, 1)) as bj:
        top, left = f.mul(bi, block), f.mul(bj, block)
        bottom = f.new(f"call i64 @llvm.smin.i64(i64 {f.add(top, block)}, i64 %columns)")
        right = f.new(f"call i64 @llvm.smin.i64(i64 {f.add(left, block)}, i64 %columns)")
        with f.loop(top, bottom) as i:
            end = f.new(f"call i64 @llvm.smin.i64(i64 {right}, i64 {f.add(i, 1)})")
            row = f.at("%matrix", f.mul(i, "%columns"))
            with f.loop(left, end) as j:
                mirror = f.at("%matrix", f.add(f.mul(j, "%columns"), i))
                both = f.fadd(f.load(row, j), f.load(mirror))
                f.store(both, row, j)
                f.store(both, mirror)
    return f
