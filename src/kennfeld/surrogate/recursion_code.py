"""Machine code of the free run of an expansion and of its derivatives: NumPy cannot compute successive steps at once.

For each step k and piece p, with the output y_{k-l} at each of its lags,

    y_k = flat_k + plane . y_{k-l} + sum_i w_i exp(ahead_ki - 1/2 sum_l ((y_{k-l} - z_il) / s_il)^2),  within limits

where `flat` and `ahead` are the shares of the inputs, which are known in advance. The centres are processed eight at a
time; those that fill up the last eight have the weight 0. The derivatives s_k of the free run follow from those of f by

    s_k += sum over lags l of df/dy_{k-l} s_{k-l}
"""

from functools import cache

from kennfeld.machine_code.engine import NativeFunction, compile_written
from kennfeld.machine_code.ir import EIGHT, LANES, FunctionWriter, Vector

LEAST = -700.0  # exponent below which a bell is 0


@cache
def free_run_code(lags: int) -> NativeFunction:
    """Return the compiled function for so many output lags; see `write_free_run`."""
    return compile_written(_free_run, lags)["free_run"]


@cache
def derivative_code(lags: int) -> NativeFunction:
    """Return the compiled function for so many output lags; see `write_derivatives`."""
    return compile_written(_derivatives, lags)["derivatives"]


def _free_run(lags: int) -> list[FunctionWriter]:
    return [write_free_run(lags)]


def _derivatives(lags: int) -> list[FunctionWriter]:
    return [write_derivatives(lags)]


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
            near = f.new(f"call {EIGHT} @llvm.maxnum.v8f64({EIGHT} {exponent}, {EIGHT} {v.all(LEAST)})")
            total.set(v("fadd", total.get(), v("fmul", v.load(weights, first), v.exp(near))))
            position.set(f.add(first, LANES))
        y = v.reduce(f.fadd(f.load("%flat", at), f.dot(list(zip(plane, lagged, strict=True)))), total.get())
        f.store(y, "%free", at)
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
