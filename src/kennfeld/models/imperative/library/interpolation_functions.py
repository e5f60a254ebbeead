"""Library functions of interpolation, polynomials and discrete filters."""

from collections.abc import Sequence

import numpy as np

from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.library.reduction_functions import combine, reduce_along
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, elementwise
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
    rest = list(args.held[begin:])
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
    first = 1 if len(args) == 2 or (len(args) > 2 and isinstance(args.held[2], str)) else 2
    x = args.array(first)
    method, beyond = _options(args, first + 1)
    if first == 2 and method == "linear" and args.table(1):
        points = _axis(args, 0)
        result = args.calls.context.tables(args.table(1), [(points, args.table(0))], [x], _extrapolation_kind(beyond))
        if result is not None:
            return _beyond(args, result, x, points, beyond)
    values = args.array(first - 1)
    points = _axis(args, 0) if first == 2 else np.arange(1.0, values.size + 1)
    if values.size != points.size:
        raise args.refuse(f"{values.size} values for {points.size} breakpoints; columns are not supported")
    result = _interpolate(args, points, values.ravel(order="F"), x, method)
    return _beyond(args, result, x, points, beyond)


def _extrapolation_kind(beyond: SymbolicValue | None) -> str:
    """Return the extrapolation of a table."""
    return "linear" if beyond == "extrap" else "clip"


def _interpolate(args: SymbolicArguments, points: Numbers, values: Nodes, x: Nodes, method: str) -> Nodes:
    """Interpolate by decisions between the cells."""
    calls = args.calls
    if method == "linear":
        return _interpolate_lines(args, points, values, x)
    steps = {"nearest": (points[1:] + points[:-1]) / 2, "previous": points[1:], "next": points[:-1]}[method]
    builder, result = calls.builder, np.full(x.shape, values[0], dtype=np.int64)
    for limit, value in zip(steps, values[1:], strict=True):
        above = elementwise(builder, "gt" if method == "next" else "ge", x, constants(builder, limit))
        result = elementwise(builder, "select", above, value.reshape(1, 1), result)
    return result


def _interpolate_lines(args: SymbolicArguments, points: Numbers, values: Nodes, x: Nodes) -> Nodes:
    """Interpolate by lines between the points; the first and last are extended."""
    args.calls.context.room(float(points.size) * x.size)
    builder, result = args.calls.builder, x
    for at in range(points.size - 1):
        share = elementwise(
            builder,
            "div",
            elementwise(builder, "sub", x, constants(builder, points[at])),
            constants(builder, points[at + 1] - points[at]),
        )
        low, high = values[at].reshape(1, 1), values[at + 1].reshape(1, 1)
        line = elementwise(
            builder, "add", low, elementwise(builder, "mul", share, elementwise(builder, "sub", high, low))
        )
        result = (
            line
            if at == 0
            else elementwise(
                builder, "select", elementwise(builder, "ge", x, constants(builder, points[at])), line, result
            )
        )
    return result


def _beyond(args: SymbolicArguments, made: Nodes, x: Nodes, points: Numbers, beyond: SymbolicValue | None) -> Nodes:
    if isinstance(beyond, str):
        if beyond != "extrap":
            raise args.refuse(f"unknown extrapolation {beyond!r}")
        return made
    builder = args.calls.builder
    inside = elementwise(builder, "and", elementwise(builder, "ge", x, constants(builder, points[0])),
                  elementwise(builder, "le", x, constants(builder, points[-1])))  # fmt: skip
    outside = constants(builder, float("nan")) if beyond is None else beyond
    if not isinstance(outside, np.ndarray) or outside.size != 1:
        raise args.refuse("the extrapolation value is not a scalar")
    return elementwise(builder, "select", inside, made, outside)


@function("interp2", least=5, most=7)
def interpolate_map(args: SymbolicArguments) -> SymbolicValue:
    """Interpolate a map over constant breakpoints, x along its columns and y along its rows; linear or nearest."""
    xs, ys = (_vector(args, at) for at in (0, 1))
    x, y = args.array(3), args.array(4)
    method, beyond = _options(args, 5)
    if method == "linear" and args.table(2):
        axes = [(ys, args.table(1)), (xs, args.table(0))]
        result = args.calls.context.tables(args.table(2), axes, [y, x], "clip")
        if result is not None:
            return _beyond(args, _beyond(args, result, x, xs, beyond), y, ys, beyond)
    values = args.array(2)
    if values.shape != (ys.size, xs.size):
        raise args.refuse(f"a table of {'x'.join(map(str, values.shape))} for {ys.size} by {xs.size} breakpoints")
    rows = [_interpolate(args, xs, values[row], x, method) for row in range(ys.size)]
    result = _interpolate_arrays(args, ys, rows, y, method)
    result = _beyond(args, result, x, xs, beyond)
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


def _interpolate_arrays(
    args: SymbolicArguments, points: Numbers, rows: Sequence[Nodes], y: Nodes, method: str
) -> Nodes:
    """Interpolate as `_curve` between arrays of the shape of the coordinate."""
    builder, result = args.calls.builder, rows[0]
    for at in range(points.size - 1):
        low, high = rows[at], rows[at + 1]
        if method == "linear":
            away = elementwise(builder, "sub", y, constants(builder, points[at]))
            share = elementwise(builder, "div", away, constants(builder, points[at + 1] - points[at]))
            part, limit = (
                elementwise(
                    builder, "add", low, elementwise(builder, "mul", share, elementwise(builder, "sub", high, low))
                ),
                points[at],
            )
            result = (
                part
                if at == 0
                else elementwise(
                    builder, "select", elementwise(builder, "ge", y, constants(builder, limit)), part, result
                )
            )
        else:
            limit = {"nearest": (points[at] + points[at + 1]) / 2, "previous": points[at + 1]}.get(method, points[at])
            above = elementwise(builder, "gt" if method == "next" else "ge", y, constants(builder, limit))
            result = elementwise(builder, "select", above, high, result)
    return result


@function("polyval", least=2, most=2)
def evaluate_polynomial(args: SymbolicArguments) -> SymbolicValue:
    """Evaluate a polynomial by its coefficients, the highest first."""
    builder, x = args.calls.builder, args.array(1)
    coefficients = [node.reshape(1, 1) for node in args.array(0).ravel(order="F")]
    args.calls.context.room(float(x.size) * len(coefficients))
    result = np.full(x.shape, builder.const(0.0), dtype=np.int64)
    for coefficient in coefficients:
        result = elementwise(builder, "add", elementwise(builder, "mul", result, x), coefficient)
    return result


@function("conv", least=2, most=2)
def convolve(args: SymbolicArguments) -> SymbolicValue:
    """Multiply two polynomials; the product has the orientation of the longer one."""
    builder, a, b = args.calls.builder, args.vector(0).ravel(), args.vector(1).ravel()
    args.calls.context.room(float(a.size) * b.size)
    sums: list[list[Nodes]] = [[] for _ in range(a.size + b.size - 1)]
    for i, one in enumerate(a):
        for j, other in enumerate(b):
            sums[i + j].append(elementwise(builder, "mul", one.reshape(1, 1), other.reshape(1, 1)))
    result = np.concatenate([combine(builder, "add", 0.0, parts) for parts in sums], axis=1)
    longer = args.array(0 if a.size > b.size else 1)
    return result.T if longer.shape[1] == 1 else result


@function("filter", least=3, most=3)
def filter_vector(args: SymbolicArguments) -> SymbolicValue:
    """Filter a vector by a discrete filter with zero initial conditions."""
    builder = args.calls.builder
    b, a, x = (args.vector(at).ravel() for at in range(3))
    args.calls.context.room(float(x.size) * (a.size + b.size))
    result: list[Nodes] = []
    for at in range(x.size):
        terms = [elementwise(builder, "mul", c.reshape(1), x[at - k].reshape(1)) for k, c in enumerate(b) if at >= k]
        sums = reduce_along(
            np.concatenate(terms).reshape(-1, 1), 0, lambda parts: combine(builder, "add", 0.0, parts)
        ).ravel()
        for k in range(1, min(a.size, at + 1)):
            sums = elementwise(builder, "sub", sums, elementwise(builder, "mul", a[k].reshape(1), result[at - k]))
        result.append(elementwise(builder, "div", sums, a[0].reshape(1)))
    return np.concatenate(result).reshape(args.array(2).shape, order="F")
