"""LLVM IR of dense layers: outputs with the slopes of their activation, and the adjoints of the inputs.

y_i = a(z_i), z_i = sum_j w_ji x_j + b_i, see `graph.dense_layer`. Up to 32 outputs are computed at once. The functions
depend on the activation, not on the size of the layer, and are compiled once each.
"""

from collections.abc import Callable, Iterator

from kennfeld.base.machine_code.ir import EIGHT, LANES, FunctionWriter, Vector
from kennfeld.graph.dense_layer import ACTIVATIONS
from kennfeld.native.elementwise import guarded_product

AT_ONCE = 4  # vectors of outputs; more sums than one keep the multipliers busy
LEAST = -700.0  # exponent below which e^x is treated as e^-700
ALL = f"<{', '.join(['i1 true'] * LANES)}>"
SIZES = (
    ("ptr", "values"),  # double[inputs + 1][outputs], a row of weights per input, then the biases
    ("i64", "inputs"),
    ("i64", "outputs"),
)


def write_layer(activation: int) -> FunctionWriter:
    """Write `layer(values, inputs, outputs, alpha, x, out)`, which computes the outputs and, behind them, their slopes.

    `activation` is an index into `ACTIVATIONS`.
    """
    f = FunctionWriter("layer", (*SIZES, ("double", "alpha"), ("ptr", "x"), ("ptr", "out")))
    v, activate = Vector(f), _ACTIVATIONS[ACTIVATIONS[activation]]
    biases = f.mul("%inputs", "%outputs")
    for first, mask, count in _outputs(f, AT_ONCE):
        columns = [f.add(first, LANES * k) for k in range(count)]
        sums = [f.variable(EIGHT, _load(f, "%values", f.add(biases, column), mask)) for column in columns]
        with f.loop(0, "%inputs") as j:
            x, row = v.splat(f.load("%x", j)), f.mul(j, "%outputs")
            for total, column in zip(sums, columns, strict=True):
                # z = b + sum over j of w[j] x[j], row by row of the weights, so that loads are contiguous
                product = v("fmul", x, _load(f, "%values", f.add(row, column), mask))
                total.set(v("fadd", total.get(), product))
        for total, column in zip(sums, columns, strict=True):
            y, slope = activate(v, total.get())
            _store(f, y, "%out", column, mask)
            _store(f, slope, "%out", f.add(column, "%outputs"), mask)
    return f


def write_pull() -> FunctionWriter:
    """Write `pull(values, inputs, outputs, slopes, adjoints, out)`, which computes the adjoints of the inputs.

    `slopes` are those of the activation, `adjoints` those of the outputs, which are overwritten. An adjoint that is 0
    stays 0 even if the slope is not finite.
    """
    f = FunctionWriter("pull", (*SIZES, ("ptr", "slopes"), ("ptr", "adjoints"), ("ptr", "out")))
    v = Vector(f)
    with f.loop(0, "%outputs") as i:
        # adjoint of z_i, then that of x_j: sum over i of w_ji times it
        f.store(guarded_product(f, f.load("%adjoints", i), f.load("%slopes", i)), "%adjoints", i)
    with f.loop(0, "%inputs") as j:
        row, total = f.mul(j, "%outputs"), f.variable(EIGHT, v.all(0.0))
        for first, mask, _ in _outputs(f, 1):
            product = v("fmul", _load(f, "%adjoints", first, mask), _load(f, "%values", f.add(row, first), mask))
            total.set(v("fadd", total.get(), product))
        f.store(v.reduce("0.0", total.get()), "%out", j)
    return f


def _outputs(f: FunctionWriter, at_once: int) -> Iterator[tuple[str, str, int]]:
    """Emit the body for `at_once` vectors of outputs at a time, for single ones, and for the rest.

    Yields the first output, the mask of the lanes, and the number of vectors.
    """
    position = f.variable("i64", "0")
    for count in dict.fromkeys((at_once, 1)):
        # each pass goes on where the one before ended: vectors at once, single ones, the last lanes
        end = f.new(f"and i64 %outputs, -{LANES * count}")
        with f.walk(end, position.get()) as (first, following):
            yield first, ALL, count
            following.set(f.add(first, LANES * count))
        position.set(end)
    first = position.get()
    rest = f.new(f"sub i64 %outputs, {first}")
    with f.when(f.new(f"icmp sgt i64 {rest}, 0")):
        yield first, _mask(f, rest), 1


def _mask(f: FunctionWriter, count: str) -> str:
    """Return a mask of the first `count` lanes."""
    kind = f"<{LANES} x i64>"
    lanes = f"<{', '.join(f'i64 {lane}' for lane in range(LANES))}>"
    single = f.new(f"insertelement {kind} poison, i64 {count}, i64 0")
    counts = f.new(f"shufflevector {kind} {single}, {kind} poison, <{LANES} x i32> zeroinitializer")
    return f.new(f"icmp slt {kind} {lanes}, {counts}")


def _load(f: FunctionWriter, pointer: str, index: str, mask: str) -> str:
    at = f.at(pointer, index)
    if mask == ALL:
        return f.load(at, kind=EIGHT)
    zeros = f"{EIGHT} {Vector(f).all(0.0)}"
    return f.new(f"call {EIGHT} @llvm.masked.load.v8f64.p0(ptr {at}, i32 8, <{LANES} x i1> {mask}, {zeros})")


def _store(f: FunctionWriter, value: str, pointer: str, index: str, mask: str) -> None:
    at = f.at(pointer, index)
    if mask == ALL:
        f.store(value, at, kind=EIGHT)
    else:
        f.do(f"call void @llvm.masked.store.v8f64.p0({EIGHT} {value}, ptr {at}, i32 8, <{LANES} x i1> {mask})")


def _identity(v: Vector, z: str) -> tuple[str, str]:
    return z, v.all(1.0)


def _relu(v: Vector, z: str) -> tuple[str, str]:
    # NaN is not below 0, and passes through
    below = v.compare("olt", z, 0.0)
    return v.where(below, v.all(0.0), z), v.where(below, v.all(0.0), v.all(1.0))


def _leaky_relu(v: Vector, z: str) -> tuple[str, str]:
    below, alpha = v.compare("olt", z, 0.0), v.splat("%alpha")
    return v.where(below, v("fmul", alpha, z), z), v.where(below, alpha, v.all(1.0))


def _elu(v: Vector, z: str) -> tuple[str, str]:
    below, alpha = v.compare("olt", z, 0.0), v.splat("%alpha")
    # e^z only where it is taken: for a large z it would overflow
    exponent = _limited(v, v.where(below, z, v.all(0.0)))
    value, slope = v("fmul", alpha, v.expm1(exponent)), v("fmul", alpha, v.exp(exponent))
    return v.where(below, value, z), v.where(below, slope, v.all(1.0))


def _tanh(v: Vector, z: str) -> tuple[str, str]:
    """Compute tanh(|z|) = -m / (m + 2) with m = e^(-2 |z|) - 1."""
    m = v.expm1(_limited(v, v("fmul", _abs(v, z), v.all(-2.0))))
    size = v("fdiv", _negated(v, m), v("fadd", m, v.all(2.0)))
    y = v.where(v.compare("olt", z, 0.0), _negated(v, size), size)
    # `maxnum` in the exponent drops NaN, which is put back
    y = v.where(v.compare("uno", z, 0.0), z, y)
    return y, v("fsub", v.all(1.0), v("fmul", y, y))


def _sigmoid(v: Vector, z: str) -> tuple[str, str]:
    """Compute 1 / (1 + e^-z) from e^-|z|, which cannot overflow."""
    e = v.exp(_limited(v, _negated(v, _abs(v, z))))
    share = v("fdiv", v.all(1.0), v("fadd", e, v.all(1.0)))
    # 1 - share without cancellation; the slope is the product of both
    rest = v("fmul", e, share)
    missing = v.compare("uno", z, 0.0)
    y = v.where(v.compare("olt", z, 0.0), rest, share)
    return v.where(missing, z, y), v.where(missing, z, v("fmul", share, rest))


def _limited(v: Vector, x: str) -> str:
    return v.f.new(f"call {EIGHT} @llvm.maxnum.v8f64({EIGHT} {x}, {EIGHT} {v.all(LEAST)})")


def _abs(v: Vector, x: str) -> str:
    return v.f.new(f"call {EIGHT} @llvm.fabs.v8f64({EIGHT} {x})")


def _negated(v: Vector, x: str) -> str:
    return v.f.new(f"fneg {EIGHT} {x}")


_ACTIVATIONS: dict[str, Callable[[Vector, str], tuple[str, str]]] = {
    "identity": _identity,
    "relu": _relu,
    "leaky_relu": _leaky_relu,
    "elu": _elu,
    "tanh": _tanh,
    "sigmoid": _sigmoid,
}
