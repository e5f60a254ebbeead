"""Machine code of the free run of an expansion and of its derivatives: NumPy cannot compute successive steps at once.

For each step k and piece p, with the output y_{k-l} at each of its lags,

    y_k = flat_k + plane . y_{k-l} + sum_i w_i exp(ahead_ki - 1/2 sum_l ((y_{k-l} - z_il) / s_il)^2),  within limits

where `flat` and `ahead` are the shares of the inputs, which are known in advance. The centres are processed eight at a
time; those that fill up the last eight have the weight 0. The derivatives s_k of the free run follow from those of f by

    s_k += sum over lags l of df/dy_{k-l} s_{k-l}

An error that is fed back, e_k = sum over lags l of df/dy_{k-l} e_{k-l} + w_k with independent w_k, has the covariances
c_kj = cov(e_k, e_{k-j}), which follow from those of earlier steps:

    c_kj = sum over lags l of df/dy_{k-l} c_{k-min(l, j), |l - j|} for j > 0
    c_k0 = sum over lags l of df/dy_{k-l} c_kl + var w_k
"""

from collections.abc import Sequence
from functools import cache

from kennfeld.base.machine_code.engine import NativeFunction, compile_written
from kennfeld.base.machine_code.ir import EIGHT, LANES, ONE, ZERO, FunctionWriter, Vector, literal

LEAST = -700.0  # exponent below which a bell is 0
LARGEST = 1e150  # magnitude of a covariance; its square is a finite number


@cache
def free_run_code(lags: int) -> NativeFunction:
    """Return the compiled function for so many output lags; see `write_free_run`."""
    return compile_written(_free_run, lags)["free_run"]


@cache
def derivative_code(lags: int) -> NativeFunction:
    """Return the compiled function for so many output lags; see `write_derivatives`."""
    return compile_written(_derivatives, lags)["derivatives"]


@cache
def covariance_code(lags: tuple[int, ...]) -> NativeFunction:
    """Return the compiled function for these output lags; see `write_covariances`."""
    return compile_written(_covariances, lags)["covariances"]


def _free_run(lags: int) -> list[FunctionWriter]:
    return [write_free_run(lags)]


def _derivatives(lags: int) -> list[FunctionWriter]:
    return [write_derivatives(lags)]


def _covariances(lags: tuple[int, ...]) -> list[FunctionWriter]:
    return [write_covariances(lags)]


def write_free_run(lags: int) -> FunctionWriter:
    """Write `free_run(count, centres, offsets, model, flat, ahead, past, free, back)`, arrays of doubles but one."""
    parameters = (
        ("i64", "count"),  # steps times pieces
        ("i64", "centres"),  # a multiple of eight
        ("ptr", "offsets"),  # i64[lags], from the number of a result in `free` to its lagged outputs in `past`
        ("ptr", "model"),  # plane[lags], limits[2], weights[centres], z[lags, centres], 1 / s[lags, centres]
        ("ptr", "flat"),  # [steps, pieces]
        ("ptr", "ahead"),  # [steps, pieces, centres]
        ("ptr", "past"),  # [longest lag + steps, pieces]: the outputs before, then the results within the limits
        ("ptr", "free"),  # [steps, pieces]: the results without the limits
        ("i64", "back"),  # longest lag times pieces
    )
    f = FunctionWriter("free_run", parameters)
    v = Vector(f)
    plane = [f.load("%model", i) for i in range(lags)]
    lower, upper = f.load("%model", lags), f.load("%model", lags + 1)
    weights = f.at("%model", lags + 2)
    centres = [f.at(weights, f.mul("%centres", 1 + i)) for i in range(lags)]
    steep = [f.at(weights, f.mul("%centres", 1 + lags + i)) for i in range(lags)]
    offsets = [f.load("%offsets", i, "i64") for i in range(lags)]
    with f.loop(0, "%count") as at:
        lagged = [f.load("%past", f.add(at, offset)) for offset in offsets]
        wide = [v.splat(y) for y in lagged]
        exponents = f.at("%ahead", f.mul(at, "%centres"))
        total = f.variable(EIGHT, v.all(0.0))
        with f.walk("%centres") as (first, position):
            square = v.all(0.0)
            for y, z, s in zip(wide, centres, steep, strict=True):
                distance = v("fmul", v("fsub", y, v.load(z, first)), v.load(s, first))
                square = v("fadd", square, v("fmul", distance, distance))
            exponent = v("fsub", v.load(exponents, first), v("fmul", square, v.all(0.5)))
            # maxnum of NaN is the other argument, so that a run that diverged stays NaN by its plane alone
            near = f.new(f"call {EIGHT} @llvm.maxnum.v8f64({EIGHT} {exponent}, {EIGHT} {v.all(LEAST)})")
            total.set(v("fadd", total.get(), v("fmul", v.load(weights, first), v.exp(near))))
            position.set(f.add(first, LANES))
        y = v.reduce(f.fadd(f.load("%flat", at), f.dot(list(zip(plane, lagged, strict=True)))), total.get())
        f.store(y, "%free", at)
        # ordered comparisons: NaN fails both and stays NaN
        above = f.select(f.new(f"fcmp olt double {y}, {lower}"), lower, y)
        within = f.select(f.new(f"fcmp ogt double {above}, {upper}"), upper, above)
        f.store(within, "%past", f.add(at, "%back"))
    return f


def write_derivatives(lags: int) -> FunctionWriter:
    """Write `derivatives(count, width, offsets, back, slopes, rows)`, which adds to `rows` in place."""
    parameters = (
        ("i64", "count"),  # steps times pieces
        ("i64", "width"),  # derivatives of each step and piece
        ("ptr", "offsets"),  # i64[lags], from the number of a step and piece to that of its lagged row
        ("i64", "back"),  # longest lag times pieces
        ("ptr", "slopes"),  # [steps, pieces, lags]: df/dy
        ("ptr", "rows"),  # [longest lag + steps, pieces, width]
    )
    f = FunctionWriter("derivatives", parameters)
    v = Vector(f)
    offsets = [f.load("%offsets", i, "i64") for i in range(lags)]
    # derivatives in whole vectors; the rest one by one
    whole = f.new(f"and i64 %width, -{LANES}")
    with f.loop(0, "%count") as at:
        row = f.at("%rows", f.new(f"mul i64 {f.add(at, '%back')}, %width"))
        before = [f.at("%rows", f.new(f"mul i64 {f.add(at, offset)}, %width")) for offset in offsets]
        steep = [f.load("%slopes", f.add(f.mul(at, lags), i)) for i in range(lags)]
        wide = [v.splat(slope) for slope in steep]
        with f.walk(whole) as (first, position):
            total = v.load(row, first)
            for slope, earlier in zip(wide, before, strict=True):
                total = v("fadd", total, v("fmul", slope, v.load(earlier, first)))
            v.store(total, row, first)
            position.set(f.add(first, LANES))
        with f.loop(whole, "%width") as column:
            products = [(slope, f.load(earlier, column)) for slope, earlier in zip(steep, before, strict=True)]
            f.store(f.fadd(f.load(row, column), f.dot(products)), row, column)
    return f


def write_covariances(lags: Sequence[int]) -> FunctionWriter:
    """Write `covariances(count, runs, limits, free, slopes, added, rows)`, which sets `rows` from its step 0 on.

    Where a limit cuts off part of the interval of two deviations about the output, the error is multiplied by the share
    that is left, which is the slope of the secant of the limited output over that interval.
    """
    back = max(lags)
    parameters = (
        ("i64", "count"),  # steps times runs
        ("i64", "runs"),  # side by side
        ("ptr", "limits"),  # [2]
        ("ptr", "free"),  # [steps, runs]: the output without the limits
        ("ptr", "slopes"),  # [steps, runs, lags]: df/dy
        ("ptr", "added"),  # [steps, runs]: var w
        ("ptr", "rows"),  # [longest lag + steps, runs, longest lag + 1]: c_kj, first those before the first step
    )
    f = FunctionWriter("covariances", parameters)
    limits = [f.load("%limits", i) for i in range(2)]
    width = back + 1
    ages = [
        f.new(f"mul i64 %runs, {back - age}") for age in range(width)
    ]  # of steps, as offsets to the step `back` ago
    with f.loop(0, "%count") as at:
        rows = [f.at("%rows", f.new(f"mul i64 {f.add(at, age)}, {width}")) for age in ages]
        slopes = [f.load("%slopes", f.add(f.mul(at, len(lags)), i)) for i in range(len(lags))]
        across = {
            j: f.dot([(a, f.load(rows[min(lag, j)], abs(lag - j))) for a, lag in zip(slopes, lags, strict=True)])
            for j in range(1, width)
        }
        # by the covariances of this step, which are complete for all j > 0
        fed_back = f.dot([(a, across[lag]) for a, lag in zip(slopes, lags, strict=True)])
        # rounding may make it negative; beyond LARGEST, the products of the next steps would be infinite
        variance = _clamp(f, f.fadd(fed_back, f.load("%added", at)), literal(0.0), literal(LARGEST))
        share = _share_within(f, f.load("%free", at), variance, limits)
        # the limited error is share * e_k: its variance has the square, its covariances with earlier errors the share
        f.store(f.fmul(f.fmul(share, share), variance), rows[0], 0)
        for j in range(1, width):
            f.store(_clamp(f, f.fmul(share, across[j]), literal(-LARGEST), literal(LARGEST)), rows[0], j)
    return f


def _share_within(f: FunctionWriter, y: str, variance: str, limits: Sequence[str]) -> str:
    """Return the share of the interval of two deviations about y that is within the limits; 1 without a deviation."""
    half = f.fmul(literal(2.0), f.new(f"call double @llvm.sqrt.f64(double {variance})"))
    negative = f.new(f"fneg double {half}")
    below, above = (_clamp(f, f.new(f"fsub double {limit}, {y}"), negative, half) for limit in limits)
    inside, whole = f.new(f"fsub double {above}, {below}"), f.new(f"fsub double {half}, {negative}")
    return f.select(f.new(f"fcmp ogt double {whole}, {ZERO}"), f.new(f"fdiv double {inside}, {whole}"), ONE)


def _clamp(f: FunctionWriter, value: str, low: str, high: str) -> str:
    """Return a double within limits; the upper one for NaN."""
    least = f.select(f.new(f"fcmp olt double {value}, {high}"), value, high)
    return f.select(f.new(f"fcmp ogt double {least}, {low}"), least, low)
