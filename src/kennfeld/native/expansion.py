"""LLVM IR of expansions in Gaussian bells: the value with its slopes along the inputs, and the slopes of the values.

Eight centres are worked on at once. The functions know the number of inputs, not the model, and are compiled once each.
"""

from collections.abc import Callable, Sequence
from functools import cache

from kennfeld.native.engine import Shared
from kennfeld.native.ir import EIGHT, LANES, Function, literal
from kennfeld.native.vector import Vector

__all__ = ["evaluation", "value_slopes"]

FARTHEST = 1e3  # widths from a centre, as in `kennfeld.expansion`
LEAST = -700.0  # the exponent where a bell counts as gone
MASK = f"<{LANES} x i1>"
PARAMETERS = (
    ("ptr", "values"),  # double[...], offset, slopes, weights, centres, widths; see `kennfeld.rbf`
    ("i64", "centres"),
    ("ptr", "x"),  # double[inputs]
    ("ptr", "out"),
)


@cache
def evaluation(inputs: int, *, reciprocal: bool) -> Shared:
    """`expand(values, centres, x, out)`: the value into out[0], its slopes along the inputs behind it.

    With `reciprocal` one over the widths stands in their place.
    """
    return Shared("expand", lambda: _evaluation(inputs, reciprocal).text())


@cache
def value_slopes(inputs: int) -> Shared:
    """`bells(values, centres, x, out)`: the derivatives with respect to the values, in their order."""
    return Shared("bells", lambda: _value_slopes(inputs).text())


class _Tables:
    """Where the parts of the values begin, and the coordinates."""

    def __init__(self, f: Function, inputs: int) -> None:
        self.f = f
        self.x = [f.load("%x", d) for d in range(inputs)]
        self.spread = [f.splat(x) for x in self.x]
        self.weights = 1 + inputs
        self.centres = [f.add(f.mul("%centres", 1 + d), self.weights) for d in range(inputs)]
        self.widths = [f.add(f.mul("%centres", 1 + inputs + d), self.weights) for d in range(inputs)]


Eight = Callable[[str | int], str]  # the eight numbers of the values that begin at an index


def _each_eight(f: Function, body: Callable[[str, str], None]) -> None:
    """Run `body(first, mask)` for eight centres after the other; the mask of the last ones tells which there are."""
    whole = f.new(f"and i64 %centres, -{LANES}")
    every = f"<{', '.join(['i1 true'] * LANES)}>"
    with f.walk(whole) as (first, position):
        body(first, every)
        f.store(f.add(first, LANES), position, kind="i64")
    rest = f.new(f"sub i64 %centres, {whole}")
    with f.when(f.new(f"icmp sgt i64 {rest}, 0")):
        lanes = f"<{', '.join(f'i64 {lane}' for lane in range(LANES))}>"
        counts = f.new(f"insertelement <{LANES} x i64> poison, i64 {rest}, i64 0")
        spread = f.new(
            f"shufflevector <{LANES} x i64> {counts}, <{LANES} x i64> poison, <{LANES} x i32> zeroinitializer"
        )
        body(whole, f.new(f"icmp slt <{LANES} x i64> {lanes}, {spread}"))


def _load(f: Function, mask: str, base: str | int, first: str, missing: float) -> str:
    """Eight numbers; `missing` where the mask has none."""
    at = f.at("%values", f.add(first, base))
    if "true" in mask:
        return f.load(at, kind=EIGHT)
    other = f"<{', '.join([f'double {literal(missing)}'] * LANES)}>"
    return f.new(f"call {EIGHT} @llvm.masked.load.v8f64.p0(ptr {at}, i32 8, {MASK} {mask}, {EIGHT} {other})")


def _store(f: Function, mask: str, value: str, base: str | int, first: str) -> None:
    at = f.at("%out", f.add(first, base))
    if "true" in mask:
        f.store(value, at, kind=EIGHT)
    else:
        f.do(f"call void @llvm.masked.store.v8f64.p0({EIGHT} {value}, ptr {at}, i32 8, {MASK} {mask})")


def _distance(f: Function, v: Vector, x: str, centre: str, width: str, reciprocal: bool) -> str:
    """Distance from a centre in widths, of which a thousand are as far as any number."""
    t = v("fmul" if reciprocal else "fdiv", v("fsub", x, centre), width)
    near = f.new(f"call {EIGHT} @llvm.maxnum.v8f64({EIGHT} {t}, {EIGHT} {v.all(-FARTHEST)})")
    return f.new(f"call {EIGHT} @llvm.minnum.v8f64({EIGHT} {near}, {EIGHT} {v.all(FARTHEST)})")


def _bells(f: Function, v: Vector, distances: Sequence[str]) -> str:
    square = v("fmul", distances[0], distances[0])
    for distance in distances[1:]:
        square = v("fadd", square, v("fmul", distance, distance))
    exponent = v("fmul", square, v.all(-0.5))
    return v.exp(f.new(f"call {EIGHT} @llvm.maxnum.v8f64({EIGHT} {exponent}, {EIGHT} {v.all(LEAST)})"))


def _evaluation(inputs: int, reciprocal: bool) -> Function:
    f = Function("expand", PARAMETERS)
    v, tables = Vector(f), _Tables(f, inputs)
    sums = [f.slot(EIGHT) for _ in range(1 + inputs)]
    for total in sums:
        f.store(v.all(0.0), total, kind=EIGHT)

    def body(first: str, mask: str) -> None:
        def eight(base: str | int, missing: float) -> str:
            return _load(f, mask, base, first, missing)

        widths = [eight(at, 1.0) for at in tables.widths]
        distances = [
            _distance(f, v, x, eight(at, 0.0), width, reciprocal)
            for x, at, width in zip(tables.spread, tables.centres, widths, strict=True)
        ]
        weighted = v("fmul", eight(tables.weights, 0.0), _bells(f, v, distances))
        f.store(v("fadd", f.load(sums[0], kind=EIGHT), weighted), sums[0], kind=EIGHT)
        for total, distance, width in zip(sums[1:], distances, widths, strict=True):
            along = v("fmul" if reciprocal else "fdiv", v("fmul", weighted, distance), width)
            f.store(v("fsub", f.load(total, kind=EIGHT), along), total, kind=EIGHT)

    _each_eight(f, body)
    straight = f.sum([f.load("%values"), *(f.fmul(f.load("%values", 1 + d), x) for d, x in enumerate(tables.x))])
    for at, (total, start) in enumerate(
        zip(sums, [straight, *(f.load("%values", 1 + d) for d in range(inputs))], strict=True)
    ):
        held = f.load(total, kind=EIGHT)
        f.store(
            f.new(f"call reassoc double @llvm.vector.reduce.fadd.v8f64(double {start}, {EIGHT} {held})"), "%out", at
        )
    return f


def _value_slopes(inputs: int) -> Function:
    f = Function("bells", PARAMETERS)
    v, tables = Vector(f), _Tables(f, inputs)
    f.store(literal(1.0), "%out")
    for d, x in enumerate(tables.x):
        f.store(x, "%out", 1 + d)

    def body(first: str, mask: str) -> None:
        def eight(base: str | int, missing: float) -> str:
            return _load(f, mask, base, first, missing)

        widths = [eight(at, 1.0) for at in tables.widths]
        distances = [
            _distance(f, v, x, eight(at, 0.0), width, False)
            for x, at, width in zip(tables.spread, tables.centres, widths, strict=True)
        ]
        bells = _bells(f, v, distances)
        _store(f, mask, bells, tables.weights, first)
        weighted = v("fmul", eight(tables.weights, 0.0), bells)
        for d in range(inputs):
            along = v("fdiv", v("fmul", weighted, distances[d]), widths[d])
            _store(f, mask, along, tables.centres[d], first)
            _store(f, mask, v("fmul", along, distances[d]), tables.widths[d], first)

    _each_eight(f, body)
    return f
