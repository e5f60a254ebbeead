"""Library functions of interpolation, polynomials and discrete filters."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.library.reduction_functions import sum_along
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, format_sizes
from kennfeld.models.imperative.symbolic_values import SymbolicValue, constants

_METHODS = {"linear": "linear", "*linear": "linear", "nearest": "nearest", "previous": "previous", "next": "next"}


def _axis(args: SymbolicArguments, at: int) -> Numbers:
    """Return breakpoints, which must be constant and increasing."""
    points = args.numbers(at, f"the breakpoints of {args.name}").ravel(order="F")
    if points.size < 2 or not np.all(np.diff(points) > 0):
        raise args.refuse("its breakpoints are not increasing")
    return points


def _options(args: SymbolicArguments, begin: int) -> tuple[str, SymbolicValue | None]:
    """Return the method and the extrapolation: "extrap", a number, or none."""
    rest = list(args.values[begin:])
    method = "linear"
    if rest and isinstance(rest[0], str) and rest[0] != "extrap":
        method = rest[0].casefold()
        rest = rest[1:]
    if method not in _METHODS:
        raise args.refuse(f"unknown method {method!r}", "Use linear, nearest, previous or next.")
    return _METHODS[method], rest[0] if rest else None


@function("interp1", least=2, most=5)
def interpolate_curve(args: SymbolicArguments) -> SymbolicValue:
    """Interpolate over constant breakpoints; NaN beyond the ends by default."""
    first = 1 if len(args) == 2 or (len(args) > 2 and isinstance(args.values[2], str)) else 2
    x = args.array(first)
    method, beyond = _options(args, first + 1)
    if first == 2 and method == "linear" and args.table(1):
        points = _axis(args, 0)
        kind = "linear" if beyond == "extrap" else "clip"
        result = args.context.tables(args.table(1), [(points, args.table(0))], [x], kind)
        if result is not None:
            return _beyond(args, result, x, points, beyond)
    values = args.array(first - 1)
    points = _axis(args, 0) if first == 2 else np.arange(1.0, values.size + 1)
    if values.size != points.size:
        raise args.refuse(f"{values.size} values for {points.size} breakpoints; columns are not supported")
    rows = [value.reshape(1, 1) for value in values.ravel(order="F")]
    result = _interpolate(args, points, rows, x, method)
    return _beyond(args, result, x, points, beyond)


def _interpolate(args: SymbolicArguments, points: Numbers, rows: Sequence[Nodes], x: Nodes, method: str) -> Nodes:
    """Interpolate by decisions between the cells; `rows` are the values at the points, of size 1 or that of x."""
    args.context.room(float(points.size) * x.size)
    apply, (result, _) = args.apply, np.broadcast_arrays(rows[0], x)
    for at, (low, high) in enumerate(pairwise(rows)):
        begin, end = float(points[at]), float(points[at + 1])
        if method == "linear":
            share = apply("div", apply("sub", x, begin), end - begin)
            line = apply("add", low, apply("mul", share, apply("sub", high, low)))
            result = line if at == 0 else apply("select", apply("ge", x, begin), line, result)
        else:
            limit = {"nearest": (begin + end) / 2, "previous": end, "next": begin}[method]
            above = apply("gt" if method == "next" else "ge", x, limit)
            result = apply("select", above, high, result)
    return result


def _beyond(args: SymbolicArguments, inner: Nodes, x: Nodes, points: Numbers, beyond: SymbolicValue | None) -> Nodes:
    if isinstance(beyond, str):
        if beyond != "extrap":
            raise args.refuse(f"unknown extrapolation {beyond!r}")
        return inner
    apply = args.apply
    inside = apply("and", apply("ge", x, float(points[0])), apply("le", x, float(points[-1])))
    outside = constants(args.builder, float("nan")) if beyond is None else beyond
    if not isinstance(outside, np.ndarray) or outside.size != 1:
        raise args.refuse("the extrapolation value is not a scalar")
    return apply("select", inside, inner, outside)


@function("interp2", least=5, most=7)
def interpolate_map(args: SymbolicArguments) -> SymbolicValue:
    """Interpolate a map over constant breakpoints, x along its columns and y along its rows; linear or nearest."""
    xs, ys = (_vector(args, at) for at in (0, 1))
    x, y = args.array(3), args.array(4)
    method, beyond = _options(args, 5)
    if method == "linear" and args.table(2):
        axes = [(ys, args.table(1)), (xs, args.table(0))]
        result = args.context.tables(args.table(2), axes, [y, x], "clip")
        if result is not None:
            return _beyond(args, _beyond(args, result, x, xs, beyond), y, ys, beyond)
    values = args.array(2)
    if values.shape != (ys.size, xs.size):
        raise args.refuse(f"a table of {format_sizes(values)} for {ys.size} by {xs.size} breakpoints")
    rows = [_interpolate(args, xs, [value.reshape(1, 1) for value in row], x, method) for row in values]
    result = _beyond(args, _interpolate(args, ys, rows, y, method), x, xs, beyond)
    return _beyond(args, result, y, ys, beyond)


def _vector(args: SymbolicArguments, at: int) -> Numbers:
    """Return breakpoints as a vector, also if given as a grid."""
    array = args.array(at)
    if 1 in array.shape:
        return _axis(args, at)
    numbers = args.numbers(at)
    points = numbers[0] if at == 0 else numbers[:, 0]
    if not np.all(np.diff(points) > 0):
        raise args.refuse("its breakpoints are not increasing")
    return np.asarray(points)


@function("conv", least=2, most=2)
def convolve(args: SymbolicArguments) -> SymbolicValue:
    """Multiply two polynomials; the product has the orientation of the longer one."""
    a, b = args.vector(0).ravel(), args.vector(1).ravel()
    args.context.room(float(a.size) * b.size)
    sums: list[list[Nodes]] = [[np.zeros((0, 1), dtype=np.int64)] for _ in range(a.size + b.size - 1)]
    for i, left in enumerate(a):
        for j, right in enumerate(b):
            sums[i + j].append(args.apply("mul", left.reshape(1, 1), right.reshape(1, 1)))
    result = np.concatenate([sum_along(args.apply, np.concatenate(parts)) for parts in sums], axis=1)
    longer = args.array(0 if a.size > b.size else 1)
    return result.T if longer.shape[1] == 1 else result


@function("filter", least=3, most=3)
def filter_vector(args: SymbolicArguments) -> SymbolicValue:
    """Filter a vector by a discrete filter with zero initial conditions."""
    apply = args.apply
    b, a, x = (args.vector(at).ravel() for at in range(3))
    args.context.room(float(x.size) * (a.size + b.size))
    result: list[Nodes] = []
    for at in range(x.size):
        terms = [apply("mul", c.reshape(1), x[at - k].reshape(1)) for k, c in enumerate(b) if at >= k]
        rest = sum_along(apply, np.concatenate(terms).reshape(-1, 1)).ravel()
        for k in range(1, min(a.size, at + 1)):
            rest = apply("sub", rest, apply("mul", a[k].reshape(1), result[at - k]))
        result.append(apply("div", rest, a[0].reshape(1)))
    return np.concatenate(result).reshape(args.array(2).shape, order="F")
