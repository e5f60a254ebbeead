"""LLVM IR of expansions in radial basis functions: value, slopes along the inputs, slopes of the values.

y = c + sum_d b_d x_d + sum_i w_i bell(r_i), r_i^2 = sum_d ((x_d - z_id) / s_id)^2, see `kennfeld.domain.rbf`. Eight
centres are processed at once. The functions depend on the number of inputs and the kernel, not on the model, and are
compiled once each.
"""

from collections.abc import Iterator
from typing import Final, get_args

from kennfeld.base.machine_code.ir import EIGHT, LANES, ONE, FunctionWriter, Vector
from kennfeld.domain.rbf import MAX_DISTANCE, Kernel

KERNELS: Final[tuple[Kernel, ...]] = get_args(Kernel)
LEAST = -700.0  # exponent below which a basis function is treated as 0
ALL = f"<{', '.join(['i1 true'] * LANES)}>"
PARAMETERS = (
    ("ptr", "values"),  # double[...], offset, slopes, weights, centres, widths; see `kennfeld.domain.rbf`
    ("i64", "centres"),
    ("ptr", "x"),  # double[inputs]
    ("ptr", "out"),
)


def write_evaluation(inputs: int, kernel: int, reciprocal: bool) -> FunctionWriter:
    """Write `expand(values, centres, x, out)`: the value goes to out[0], followed by its slopes along the inputs.

    `kernel` is a position in `KERNELS`. If `reciprocal`, the widths are stored as their reciprocals.
    """
    f = FunctionWriter("expand", PARAMETERS)
    v, x = Vector(f), [f.load("%x", d) for d in range(inputs)]
    slopes = [f.load("%values", 1 + d) for d in range(inputs)]
    # the plane: its value, and its slopes along the inputs
    starts = [f.sum([f.load("%values"), *(f.fmul(slope, at) for slope, at in zip(slopes, x, strict=True))]), *slopes]
    sums = [f.variable(EIGHT, v.all(0.0)) for _ in starts]
    for eight in _each_eight(f, x, kernel, reciprocal):
        terms = [v("fmul", eight.weight, eight.basis), *(f.new(f"fneg {EIGHT} {along}") for along in eight.along())]
        for total, term in zip(sums, terms, strict=True):
            total.set(v("fadd", total.get(), term))
    for at, (total, start) in enumerate(zip(sums, starts, strict=True)):
        f.store(v.reduce(start, total.get()), "%out", at)
    return f


def write_value_slopes(inputs: int, kernel: int) -> FunctionWriter:
    """Write `bells(values, centres, x, out)`: the derivatives with respect to the values, in their order."""
    f = FunctionWriter("bells", PARAMETERS)
    v, x = Vector(f), [f.load("%x", d) for d in range(inputs)]
    f.store(ONE, "%out")
    for d, at in enumerate(x):
        f.store(at, "%out", 1 + d)
    for eight in _each_eight(f, x, kernel, reciprocal=False):
        # with t = (x - z) / s, the slope along the centre is minus that along x, and that along the width t times it
        eight.store(eight.basis, eight.weights)
        for d, along in enumerate(eight.along()):
            eight.store(along, eight.centres[d])
            eight.store(v("fmul", along, eight.distances[d]), eight.widths[d])
    return f


def _each_eight(f: FunctionWriter, x: list[str], kernel: int, reciprocal: bool) -> Iterator["_EightCentres"]:
    """Emit the body for eight centres at a time, and once more for the remaining ones."""
    whole = f.new(f"and i64 %centres, -{LANES}")
    with f.walk(whole) as (first, position):
        yield _EightCentres(f, x, first, ALL, KERNELS[kernel], reciprocal)
        position.set(f.add(first, LANES))
    rest = f.new(f"sub i64 %centres, {whole}")
    with f.when(f.new(f"icmp sgt i64 {rest}, 0")):
        # lanes that are left are lane < rest
        kind = f"<{LANES} x i64>"
        lanes = f"<{', '.join(f'i64 {lane}' for lane in range(LANES))}>"
        single = f.new(f"insertelement {kind} poison, i64 {rest}, i64 0")
        counts = f.new(f"shufflevector {kind} {single}, {kind} poison, <{LANES} x i32> zeroinitializer")
        mask = f.new(f"icmp slt {kind} {lanes}, {counts}")
        yield _EightCentres(f, x, whole, mask, KERNELS[kernel], reciprocal)


class _EightCentres:
    """The basis functions of eight centres at a point; lanes that the mask excludes have weight 0."""

    def __init__(
        self, f: FunctionWriter, x: list[str], first: str, mask: str, kernel: Kernel, reciprocal: bool
    ) -> None:
        self._f, self._v, self._first, self._mask = f, Vector(f), first, mask
        self._divide = "fmul" if reciprocal else "fdiv"
        inputs = len(x)
        self.weights = str(1 + inputs)  # offset of their values
        self.centres = [f.add(f.mul("%centres", 1 + d), self.weights) for d in range(inputs)]
        self.widths = [f.add(f.mul("%centres", 1 + inputs + d), self.weights) for d in range(inputs)]
        # missing lanes divide by 1
        self._width = [self._load(at, 1.0) for at in self.widths]
        self.distances = []  # in widths, limited to +-`MAX_DISTANCE`
        for at, centre, width in zip(x, self.centres, self._width, strict=True):
            t = self._v(self._divide, self._v("fsub", self._v.splat(at), self._load(centre, 0.0)), width)
            # limited, so that squares do not overflow
            self.distances.append(self._extreme("minnum", self._extreme("maxnum", t, -MAX_DISTANCE), MAX_DISTANCE))
        square = self._v("fmul", self.distances[0], self.distances[0])
        for t in self.distances[1:]:
            square = self._v("fadd", square, self._v("fmul", t, t))
        self.weight = self._load(self.weights, 0.0)
        self.basis, self._declines = self._gaussian(square) if kernel == "gaussian" else self._matern52(square)

    def _gaussian(self, square: str) -> tuple[str, str]:
        """Compute the basis functions and their declines, as `kernel_of_square` does."""
        exponent = self._v("fmul", square, self._v.all(-0.5))
        basis = self._v.exp(self._extreme("maxnum", exponent, LEAST))
        return basis, basis

    def _matern52(self, square: str) -> tuple[str, str]:
        """Compute the basis functions and their declines, as `kernel_of_square` does."""
        v = self._v
        five = v("fmul", square, v.all(5.0))
        # s = sqrt(5) r: basis (1 + s + s^2 / 3) e^-s, and its decline -db/dr / r = 5/3 (1 + s) e^-s
        s = self._f.new(f"call {EIGHT} @llvm.sqrt.v8f64({EIGHT} {five})")
        fading = v.exp(self._extreme("maxnum", v("fmul", s, v.all(-1.0)), LEAST))
        rising = v("fadd", s, v.all(1.0))
        basis = v("fmul", v("fadd", rising, v("fmul", five, v.all(1.0 / 3.0))), fading)
        return basis, v("fmul", v("fmul", rising, v.all(5.0 / 3.0)), fading)

    def along(self) -> list[str]:
        """Return the slopes of the weighted basis functions along each input, with the opposite sign."""
        v = self._v
        weighted = v("fmul", self.weight, self._declines)
        return [v(self._divide, v("fmul", weighted, t), w) for t, w in zip(self.distances, self._width, strict=True)]

    def store(self, value: str, base: str) -> None:
        """Write eight numbers of the output that begin at `base`."""
        at = self._f.at("%out", self._f.add(self._first, base))
        if self._mask == ALL:
            self._f.store(value, at, kind=EIGHT)
        else:
            # a masked access leaves the memory of missing lanes alone, which may end there
            mask = f"<{LANES} x i1> {self._mask}"
            self._f.do(f"call void @llvm.masked.store.v8f64.p0({EIGHT} {value}, ptr {at}, i32 8, {mask})")

    def _load(self, base: str, missing: float) -> str:
        at = self._f.at("%values", self._f.add(self._first, base))
        if self._mask == ALL:
            return self._f.load(at, kind=EIGHT)
        mask = f"<{LANES} x i1> {self._mask}"
        other = f"{EIGHT} {self._v.all(missing)}"
        return self._f.new(f"call {EIGHT} @llvm.masked.load.v8f64.p0(ptr {at}, i32 8, {mask}, {other})")

    def _extreme(self, which: str, a: str, limit: float) -> str:
        return self._f.new(f"call {EIGHT} @llvm.{which}.v8f64({EIGHT} {a}, {EIGHT} {self._v.all(limit)})")
