"""Functions that look something up: tables by interpolation, polynomials."""

from collections.abc import Sequence

import numpy as np

from kennfeld.models.imperative.library.function_registry import SymbolicArguments, function
from kennfeld.models.imperative.library.reduction_functions import combine, reduce_along
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, elementwise
from kennfeld.models.imperative.symbolic_values import SymbolicValue, constants

_METHODS = {"linear": "linear", "*linear": "linear", "nearest": "nearest", "previous": "previous", "next": "next"}


def _axis(given: SymbolicArguments, at: int) -> Numbers:
    """Breakpoints that are fixed and increase."""
    points = given.numbers(at, f"the breakpoints of {given.name}").ravel(order="F")
    if points.size < 2 or not np.all(np.diff(points) > 0):
        raise given.refuse("its breakpoints do not increase")
    return points


def _options(given: SymbolicArguments, begin: int) -> tuple[str, SymbolicValue | None]:
    """The method, and what stands beyond the ends: "extrap", a number, or nothing."""
    rest = list(given.held[begin:])
    method = "linear"
    if rest and isinstance(rest[0], str) and rest[0] != "extrap":
        method = rest[0].casefold()
        rest = rest[1:]
    if method not in _METHODS:
        raise given.refuse(f"the method {method!r} is not supported", "linear, nearest, previous and next are.")
    return _METHODS[method], rest[0] if rest else None


@function("interp1", least=2, most=5)
def curve(given: SymbolicArguments) -> SymbolicValue:
    """A curve at fixed breakpoints; not a number beyond its ends unless it says otherwise."""
    first = 1 if len(given) == 2 or (len(given) > 2 and isinstance(given.held[2], str)) else 2
    x = given.array(first)
    method, beyond = _options(given, first + 1)
    if first == 2 and method == "linear" and given.table(1):
        points = _axis(given, 0)
        made = given.calls.context.tables(given.table(1), [(points, given.table(0))], [x], _kind(beyond))
        if made is not None:
            return _beyond(given, made, x, points, beyond)
    values = given.array(first - 1)
    points = _axis(given, 0) if first == 2 else np.arange(1.0, values.size + 1)
    if values.size != points.size:
        raise given.refuse(f"{values.size} values for {points.size} breakpoints; columns are not supported")
    made = _curve(given, points, values.ravel(order="F"), x, method)
    return _beyond(given, made, x, points, beyond)


def _kind(beyond: SymbolicValue | None) -> str:
    """What a table does beyond its ends."""
    return "linear" if beyond == "extrap" else "clip"


def _curve(given: SymbolicArguments, points: Numbers, values: Nodes, x: Nodes, method: str) -> Nodes:
    """By decisions between the cells."""
    calls = given.calls
    if method == "linear":
        return _lines(given, points, values, x)
    steps = {"nearest": (points[1:] + points[:-1]) / 2, "previous": points[1:], "next": points[:-1]}[method]
    builder, made = calls.builder, np.full(x.shape, values[0], dtype=np.int64)
    for limit, value in zip(steps, values[1:], strict=True):
        above = elementwise(builder, "gt" if method == "next" else "ge", x, constants(builder, limit))
        made = elementwise(builder, "select", above, value.reshape(1, 1), made)
    return made


def _lines(given: SymbolicArguments, points: Numbers, values: Nodes, x: Nodes) -> Nodes:
    """Lines between the points, the first and last ones going on."""
    given.calls.context.room(float(points.size) * x.size)
    builder, made = given.calls.builder, x
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
        made = (
            line
            if at == 0
            else elementwise(
                builder, "select", elementwise(builder, "ge", x, constants(builder, points[at])), line, made
            )
        )
    return made


def _beyond(given: SymbolicArguments, made: Nodes, x: Nodes, points: Numbers, beyond: SymbolicValue | None) -> Nodes:
    if isinstance(beyond, str):
        if beyond != "extrap":
            raise given.refuse(f"{beyond!r} is no way to go beyond the ends")
        return made
    builder = given.calls.builder
    inside = elementwise(builder, "and", elementwise(builder, "ge", x, constants(builder, points[0])),
                  elementwise(builder, "le", x, constants(builder, points[-1])))  # fmt: skip
    outside = constants(builder, float("nan")) if beyond is None else beyond
    if not isinstance(outside, np.ndarray) or outside.size != 1:
        raise given.refuse("what stands beyond the ends is not one number")
    return elementwise(builder, "select", inside, made, outside)


@function("interp2", least=5, most=7)
def surface(given: SymbolicArguments) -> SymbolicValue:
    """A map at fixed breakpoints, x along its columns and y along its rows; linear, or nearest."""
    xs, ys = (_vector(given, at) for at in (0, 1))
    x, y = given.array(3), given.array(4)
    method, beyond = _options(given, 5)
    if method == "linear" and given.table(2):
        axes = [(ys, given.table(1)), (xs, given.table(0))]
        made = given.calls.context.tables(given.table(2), axes, [y, x], "clip")
        if made is not None:
            return _beyond(given, _beyond(given, made, x, xs, beyond), y, ys, beyond)
    values = given.array(2)
    if values.shape != (ys.size, xs.size):
        raise given.refuse(f"a table of {'x'.join(map(str, values.shape))} for {ys.size} by {xs.size} breakpoints")
    rows = [_curve(given, xs, values[row], x, method) for row in range(ys.size)]
    made = _between(given, ys, rows, y, method)
    made = _beyond(given, made, x, xs, beyond)
    return _beyond(given, made, y, ys, beyond)


def _vector(given: SymbolicArguments, at: int) -> Numbers:
    """Breakpoints as a vector, also where they were given as a grid."""
    array = given.array(at)
    if 1 in array.shape:
        return _axis(given, at)
    numbers = given.numbers(at)
    points = numbers[0] if at == 0 else numbers[:, 0]
    if not np.all(np.diff(points) > 0):
        raise given.refuse("its breakpoints do not increase")
    return np.asarray(points)


def _between(given: SymbolicArguments, points: Numbers, rows: Sequence[Nodes], y: Nodes, method: str) -> Nodes:
    """As `_curve`, between values that are arrays of the shape of the coordinate."""
    builder, made = given.calls.builder, rows[0]
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
            made = (
                part
                if at == 0
                else elementwise(
                    builder, "select", elementwise(builder, "ge", y, constants(builder, limit)), part, made
                )
            )
        else:
            limit = {"nearest": (points[at] + points[at + 1]) / 2, "previous": points[at + 1]}.get(method, points[at])
            above = elementwise(builder, "gt" if method == "next" else "ge", y, constants(builder, limit))
            made = elementwise(builder, "select", above, high, made)
    return made


@function("polyval", least=2, most=2)
def polynomial(given: SymbolicArguments) -> SymbolicValue:
    """A polynomial by its coefficients, the highest first."""
    builder, x = given.calls.builder, given.array(1)
    coefficients = [node.reshape(1, 1) for node in given.array(0).ravel(order="F")]
    given.calls.context.room(float(x.size) * len(coefficients))
    made = np.full(x.shape, builder.const(0.0), dtype=np.int64)
    for coefficient in coefficients:
        made = elementwise(builder, "add", elementwise(builder, "mul", made, x), coefficient)
    return made


@function("conv", least=2, most=2)
def convolution(given: SymbolicArguments) -> SymbolicValue:
    """The product of two polynomials, which lies as the longer of them does."""
    builder, a, b = given.calls.builder, given.vector(0).ravel(), given.vector(1).ravel()
    given.calls.context.room(float(a.size) * b.size)
    sums: list[list[Nodes]] = [[] for _ in range(a.size + b.size - 1)]
    for i, one in enumerate(a):
        for j, other in enumerate(b):
            sums[i + j].append(elementwise(builder, "mul", one.reshape(1, 1), other.reshape(1, 1)))
    made = np.concatenate([combine(builder, "add", 0.0, parts) for parts in sums], axis=1)
    longer = given.array(0 if a.size > b.size else 1)
    return made.T if longer.shape[1] == 1 else made


@function("filter", least=3, most=3)
def filtered(given: SymbolicArguments) -> SymbolicValue:
    """A vector through a discrete filter that starts at rest."""
    builder = given.calls.builder
    b, a, x = (given.vector(at).ravel() for at in range(3))
    given.calls.context.room(float(x.size) * (a.size + b.size))
    made: list[Nodes] = []
    for at in range(x.size):
        terms = [elementwise(builder, "mul", c.reshape(1), x[at - k].reshape(1)) for k, c in enumerate(b) if at >= k]
        sums = reduce_along(
            np.concatenate(terms).reshape(-1, 1), 0, lambda parts: combine(builder, "add", 0.0, parts)
        ).ravel()
        for k in range(1, min(a.size, at + 1)):
            sums = elementwise(builder, "sub", sums, elementwise(builder, "mul", a[k].reshape(1), made[at - k]))
        made.append(elementwise(builder, "div", sums, a[0].reshape(1)))
    return np.concatenate(made).reshape(given.array(2).shape, order="F")
