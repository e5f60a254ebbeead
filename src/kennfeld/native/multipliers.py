"""Multipliers of a small dual program in compiled code: min 1/2 m'Sm - e'm, m >= 0 except for equalities.

S = A H^-1 A' is singular if limits depend on each other, so that a ridge is added to solve with it.
"""

from functools import cache

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.machine_code.engine import NativeFunction, compile_functions
from kennfeld.base.machine_code.ir import ONE, ZERO, FunctionWriter, literal
from kennfeld.native.addresses import INT64, address, strided

RIDGE = 1e-12  # share of each row's product with itself that is added to it, so that dependent rows have a factor
LARGER = 100.0  # factor of the next ridge if there is none
NEGATIVE = 1e-10  # a multiplier below 0 by this share of the largest is wrong
PASSED = 1e-14  # a slope below 0 by this share of what it is summed from is wrong
EMPTY = 1e-300  # product of a row without values with itself
PATIENCE = 6  # exchanges of whole blocks without a decrease of the number of wrong multipliers

INFINITE, NAN = literal(float("inf")), literal(float("nan"))
SYSTEM = (("ptr", "products"), ("i64", "stride"), ("i64", "count"), ("ptr", "inside"), ("ptr", "right"))
MEMORY = (("ptr", "m"), ("ptr", "which"), ("ptr", "rest"), ("ptr", "inverse"), ("ptr", "lower"))


def solve_active(products: Float, active: Int, right: Float) -> Float:
    """Solve S m = right for the multipliers, Float[rows], of the `active` rows (1, else 0); the others are 0.

    A ridge makes dependent rows solvable; a second solve restores the digits that it costs (J. Riley: Solving
    systems of linear equations with a positive definite, symmetric, but possibly ill-conditioned matrix, 1955). NaN if
    S is not finite.
    """
    count = active.size
    memory = np.empty((count + 4) * count)
    matrix = (*strided(products, count), count, address(active, count, INT64), address(right, count))
    _functions()["solve"](*matrix, *_memory(memory, count))
    return memory[:count]


def exchange_blocks(products: Float, excess: Float, equalities: int, guess: Int) -> Float | None:
    """Find the multipliers by block principal pivoting; None if it does not end.

    All wrong ones are exchanged at once (J. Judice, F. Pires: A block principal pivoting algorithm for large-scale
    strictly monotone linear complementarity problems, 1994).

    Args:
        products: S, Float[rows, rows].
        excess: e, Float[rows].
        equalities: number of the multipliers, the first ones, that are not bounded.
        guess: 1 for the multipliers likely to be > 0, else 0, Int[rows].

    Returns:
        Float[rows], >= 0 but for the equalities.
    """
    count = excess.size
    inside, memory = np.zeros(count + 1, dtype=np.int64), np.empty((count + 5) * count)
    inside[:count] = guess
    start = address(inside, kind=INT64)
    matrix = (*strided(products, count), count, start, address(excess, count))
    _functions()["exchange"](*matrix, *_memory(memory, count), equalities, start + count * inside.itemsize)
    return memory[:count] if inside[count] else None


def _memory(memory: Float, count: int) -> tuple[int, ...]:
    """The arguments `MEMORY` of generated code: four vectors, then a matrix; the vector `which` is of integers."""
    start, vector = address(memory), memory.itemsize * count
    return tuple(start + number * vector for number in range(5))


@cache
def _functions() -> dict[str, NativeFunction]:
    return compile_functions(_solve(), _exchange(), loops=True)


def _solve() -> FunctionWriter:
    """Write `solve(system, memory)`: see `solve_active`."""
    before = _factor_part().text() + _substitute().text()
    f = FunctionWriter("solve", [*SYSTEM, *MEMORY], before=before)
    size, ridge = f.variable("i64", "0"), f.variable("double", literal(RIDGE))
    failed = f.slot("i64")
    with f.loop(0, "%count") as i:
        f.store(ZERO, "%m", i)
        with f.when(_flag(f, "%inside", i)):
            f.store(i, "%which", size.get(), "i64")
            size.set(f.add(size.get(), 1))
    part = [("ptr", "%products"), ("i64", "%stride"), ("i64", size.get()), *((k, f"%{name}") for k, name in MEMORY)]
    # repeats with a larger ridge until the rows have a factor, or the ridge is as large as they are
    with f.walk(1) as (_, attempt):
        f.call("factor", [*part, ("double", ridge.get()), ("ptr", failed)])
        smaller = f.new(f"fcmp ole double {ridge.get()}, {ONE}")
        again = f.new(f"and i1 {_flag(f, failed, 0)}, {smaller}")
        ridge.set(f.fmul(ridge.get(), literal(LARGER)))
        attempt.set(f.new(f"select i1 {again}, i64 0, i64 1"))
    bad = _flag(f, failed, 0)
    # iterative refinement: m += (S + ridge)^-1 (e - S m), first from m = 0, then once more
    for _ in range(2):
        with f.loop(0, size.get()) as a:
            row = f.load("%which", a, "i64")
            f.store(f.new(f"fsub double {f.load('%right', row)}, {_row_times_m(f, row)}"), "%rest", a)
        f.call("substitute", [("i64", size.get()), *((kind, f"%{name}") for kind, name in MEMORY[2:])])
        with f.loop(0, size.get()) as a:
            row = f.load("%which", a, "i64")
            f.store(f.select(bad, NAN, f.fadd(f.load("%m", row), f.load("%rest", a))), "%m", row)
    return f


def _flag(f: FunctionWriter, flags: str, i: str | int) -> str:
    return f.new(f"icmp ne i64 {f.load(flags, i, 'i64')}, 0")


def _row_times_m(f: FunctionWriter, row: str) -> str:
    """Return the product of a row of S with the multipliers."""
    return _dot(f, f.at("%products", f.mul(row, "%stride")), "%m", "%count")


def _dot(f: FunctionWriter, a: str, b: str, count: str) -> str:
    total = f.variable("double", ZERO)
    with f.loop(0, count) as k:
        total.set(f.fadd(total.get(), f.fmul(f.load(a, k), f.load(b, k))))
    return total.get()


def _factor_part() -> FunctionWriter:
    """Write `factor(products, stride, size, memory, ridge, failed)`: Cholesky of the rows and columns `which` of S.

    L[a,b] = (S[a,b] - sum over k < b of L[a,k] L[b,k]) / L[b,b], row by row, with (1 + ridge) S[a,a] on the diagonal.
    """
    system = (("ptr", "products"), ("i64", "stride"), ("i64", "size"))
    f = FunctionWriter("factor", [*system, *MEMORY, ("double", "ridge"), ("ptr", "failed")], "noinline")
    f.store("0", "%failed", kind="i64")
    with f.loop(0, "%size") as a:
        own, row = f.at("%lower", f.mul(a, "%size")), f.load("%which", a, "i64")
        source = f.at("%products", f.mul(row, "%stride"))
        with f.loop(0, a) as b:
            other = f.at("%lower", f.mul(b, "%size"))
            rest = f.new(f"fsub double {f.load(source, f.load('%which', b, 'i64'))}, {_dot(f, own, other, b)}")
            f.store(f.fmul(rest, f.load("%inverse", b)), own, b)
        diagonal = f.load(source, row)
        pivot = f.new(f"fsub double {f.fadd(diagonal, f.fmul('%ridge', diagonal))}, {_dot(f, own, own, a)}")
        positive, finite = (f.new(f"fcmp {c} double {pivot}, {side}") for c, side in (("ogt", ZERO), ("olt", INFINITE)))
        with f.unless(positive, finite):
            f.store("1", "%failed", kind="i64")
            f.do("ret void")
            f.begin(f.label("on"))
        root = f.new(f"call double @llvm.sqrt.f64(double {pivot})")
        f.store(f.new(f"fdiv double {ONE}, {root}"), "%inverse", a)
    return f


def _substitute() -> FunctionWriter:
    """Write `substitute(size, rest, inverse, lower)`: solve L L' x = b in place."""
    f = FunctionWriter("substitute", [("i64", "size"), *MEMORY[2:]], "noinline")
    with f.loop(0, "%size") as a:
        row = f.at("%lower", f.mul(a, "%size"))
        solved = f.new(f"fsub double {f.load('%rest', a)}, {_dot(f, row, '%rest', a)}")
        f.store(f.fmul(solved, f.load("%inverse", a)), "%rest", a)
    with f.loop(0, "%size") as back:
        a = f.new(f"sub i64 {f.add('%size', -1)}, {back}")
        row, value = f.at("%lower", f.mul(a, "%size")), f.fmul(f.load("%rest", a), f.load("%inverse", a))
        f.store(value, "%rest", a)
        with f.loop(0, a) as b:
            f.store(f.new(f"fsub contract double {f.load('%rest', b)}, {f.fmul(f.load(row, b), value)}"), "%rest", b)
    return f


def _exchange() -> FunctionWriter:
    """Write `exchange(system, memory, equalities, outcome)`: see `exchange_blocks`; `inside` is the set of rows.

    S m = e inside, m = 0 outside; wrong are m < 0 inside and slopes S m - e < 0 outside. All are measured in units of
    the length of a row, the root of its product with itself.
    """
    f = FunctionWriter("exchange", [*SYSTEM, *MEMORY, ("i64", "equalities"), ("ptr", "outcome")])
    # exchanges of blocks may cycle: it ends without a result if PATIENCE of them give no new least number of wrong ones
    scale = f.at("%lower", f.mul("%count", "%count"))  # behind the factor
    wanted = _prepare(f, scale)
    best, patience = f.variable("i64", f.add("%count", 1)), f.variable("i64", str(PATIENCE))
    with f.walk(1) as (_, done):
        f.call("solve", [(kind, f"%{name}") for kind, name in (*SYSTEM, *MEMORY)])
        wrong = _exchange_wrong(f, scale, wanted)
        better = f.new(f"icmp slt i64 {wrong}, {best.get()}")
        best.set(f.extreme("smin", best.get(), wrong))
        less = f.add(patience.get(), -1)
        patience.set(f.new(f"select i1 {better}, i64 {PATIENCE}, i64 {less}"))
        solved = f.new(f"icmp eq i64 {wrong}, 0")
        f.store(f.new(f"zext i1 {solved} to i64"), "%outcome", kind="i64")
        ended = f.new(f"or i1 {solved}, {f.new(f'icmp eq i64 {patience.get()}, 0')}")
        done.set(f.new(f"zext i1 {ended} to i64"))
    with f.loop("%equalities", "%count") as i:
        # below 0 within the tolerance
        negative = f.new(f"fcmp olt double {f.load('%m', i)}, {ZERO}")
        f.store(f.select(negative, ZERO, f.load("%m", i)), "%m", i)
    return f


def _prepare(f: FunctionWriter, scale: str) -> str:
    """Write the lengths of the rows and complete the first set; return the largest excess relative to them."""
    wanted = f.variable("double", ZERO)
    with f.loop(0, "%count") as i:
        product = f.load("%products", f.add(f.mul(i, "%stride"), i))
        entered = f.new(f"fcmp ogt double {product}, {literal(EMPTY)}")
        # a row that no value enters has length 0, stays outside and is never wrong
        root = f.new(f"call double @llvm.sqrt.f64(double {f.select(entered, product, ONE)})")
        f.store(f.select(entered, root, ZERO), scale, i)
        free = f.new(f"icmp slt i64 {i}, %equalities")
        likely = f.new(f"or i1 {free}, {_flag(f, '%inside', i)}")
        inside = f.new(f"and i1 {entered}, {likely}")
        f.store(f.new(f"zext i1 {inside} to i64"), "%inside", i, "i64")
        share = _abs(f, f.new(f"fdiv double {f.load('%right', i)}, {root}"))
        larger = f.new(f"and i1 {entered}, {f.new(f'fcmp ogt double {share}, {wanted.get()}')}")
        wanted.set(f.select(larger, share, wanted.get()))
    return wanted.get()


def _exchange_wrong(f: FunctionWriter, scale: str, wanted: str) -> str:
    """Exchange the wrong multipliers, and return their number."""
    # by Cauchy-Schwarz, a slope's terms in units of its row's length are at most |m_j| times the length of row j
    largest, total, count = f.variable("double", ZERO), f.variable("double", ZERO), f.variable("i64", "0")
    with f.loop(0, "%count") as i:
        size = _abs(f, f.fmul(f.load("%m", i), f.load(scale, i)))
        largest.set(f.new(f"call double @llvm.maxnum.f64(double {largest.get()}, double {size})"))
        total.set(f.fadd(total.get(), size))
    least = f.fmul(literal(-NEGATIVE), largest.get())
    rounding = f.fmul(literal(-PASSED), f.fadd(wanted, total.get()))
    with f.loop("%equalities", "%count") as i:
        length = f.load(scale, i)
        with f.when(f.new(f"fcmp ogt double {length}, {ZERO}")):
            inside = _flag(f, "%inside", i)
            slope = f.new(f"fsub double {_row_times_m(f, i)}, {f.load('%right', i)}")
            steep = f.new(f"fcmp olt double {f.new(f'fdiv double {slope}, {length}')}, {rounding}")
            negative = f.new(f"fcmp olt double {f.fmul(f.load('%m', i), length)}, {least}")
            # wrong ones change sides: from the set of active rows into that of the others, or back
            wrong = f.new(f"zext i1 {f.new(f'select i1 {inside}, i1 {negative}, i1 {steep}')} to i64")
            f.store(f.new(f"xor i64 {f.load('%inside', i, 'i64')}, {wrong}"), "%inside", i, "i64")
            count.set(f.add(count.get(), wrong))
    return count.get()


def _abs(f: FunctionWriter, x: str) -> str:
    return f.new(f"call double @llvm.fabs.f64(double {x})")
