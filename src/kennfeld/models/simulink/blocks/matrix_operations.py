"""Elements of arrays set, and arrays of two dimensions turned, multiplied and inverted."""

from collections.abc import Sequence

import numpy as np

from kennfeld.models.imperative.node_arrays import Nodes, reduce_nodes
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.parameter_fields import listed, selected_indices
from kennfeld.models.simulink.lowering.registry import block
from kennfeld.models.simulink.signals import Signal, SignalOrBus, fastest_sample_time, scalar

__all__ = ["as_matrix", "inverse_of"]

_MOST_COMPARISONS = 100_000
_LARGEST_INVERSE = 3


@block("Assignment", NumberOfDimensions="1", IndexMode="One-based", Indices="", IndexParamArray="", OutputSizes="",
       OutputInitialize="Initialize using input port <Y0>", IndexOptions="", SampleTime="-1")  # fmt: skip
def assignment(site: BlockContext) -> SignalOrBus:
    """The first input with some of its elements replaced by those of the second; places may be inputs of their own."""
    how = site.text("OutputInitialize")
    if not how.startswith("Initialize using input port"):
        raise UnsupportedError(f"OutputInitialize is {how!r}: elements that are not assigned would have no value")
    into, values = site.input(0), site.input(1)
    dimensions = site.whole("NumberOfDimensions", 1, 2)
    nodes = np.array(into.flat, dtype=np.int64) if dimensions == 1 else into.nodes
    if nodes.ndim != dimensions:
        raise UnsupportedError(f"it assigns to {dimensions} dimensions of a signal that has {nodes.ndim}")
    options = listed(site, "IndexOptions", "IndexOptionArray") or ["Index vector (dialog)"] * dimensions
    given = listed(site, "Indices", "IndexParamArray")
    port, axes = 2, list[list[tuple[int, int]] | Signal]()
    for axis, option in enumerate(options[:dimensions]):
        if option.endswith("(port)"):
            axes.append(_running(site, site.input(port), option, values, nodes, axis, len(axes)))
            port += 1
        else:
            text = given[axis] if axis < len(given) else ""
            axes.append(_fixed(site, option, text, nodes, axis, values))
    made = _assigned(site, nodes, values, axes)
    period = fastest_sample_time([one.period for one in site.inputs])
    return Signal(made.reshape(into.shape, order="F") if dimensions == 1 else made, period)


def _extent(values: Signal, axis: int, dimensions: int) -> int:
    """How many elements the values have along a dimension."""
    if values.size == 1 or dimensions == 1:
        return values.size
    return values.nodes.shape[axis] if values.nodes.ndim == 2 else values.size


def _fixed(
    site: BlockContext, option: str, text: str, nodes: Nodes, axis: int, values: Signal
) -> list[tuple[int, int]] | Signal:
    """The places along a dimension with those of the values, both counted from 0."""
    option = "Select all" if option == "Assign all" else option
    count = _extent(values, axis, nodes.ndim) if option.startswith("Starting") else None
    return [
        (at, place) for at, place in enumerate(selected_indices(site, option, text, nodes.shape[axis], axis, count))
    ]


def _running(
    site: BlockContext, index: Signal, option: str, values: Signal, nodes: Nodes, axis: int, before: int
) -> Signal:
    """The places that a signal gives, counted from 0; of a starting index, as many as there are values."""
    first = 0.0 if site.text("IndexMode").startswith("Zero") else 1.0
    places = site.call("sub", site.call("floor", index), site.constant(first))
    if option.startswith("Starting") and nodes.ndim == 1:
        places = site.call("add", places, site.constant(*map(float, range(values.size))))
    elif option.startswith("Starting"):
        count = _extent(values, axis, nodes.ndim)
        places = site.call("add", places, site.constant(*map(float, range(count))))
    if places.size * nodes.size > _MOST_COMPARISONS:
        raise UnsupportedError(f"{places.size} places that change among {nodes.size} elements are too many")
    return places


def _assigned(
    site: BlockContext, nodes: Nodes, values: Signal, axes: Sequence[list[tuple[int, int]] | Signal]
) -> Nodes:
    counts = [axis.size if isinstance(axis, Signal) else len(axis) for axis in axes]
    given = _shaped(values, tuple(counts))
    made = nodes.copy()
    for source in np.ndindex(*counts):
        for place, condition in _targets(site, nodes.shape, axes, source):
            new, old = int(given[source]), int(made[place])
            made[place] = new if condition is None else site.builder.call("select", condition, new, old)
    return made


def _shaped(values: Signal, counts: tuple[int, ...]) -> Nodes:
    if values.size == 1:
        return np.full(counts, values.flat[0], dtype=np.int64)
    if values.size != int(np.prod(counts)):
        raise UnsupportedError(f"it assigns {values.size} elements to {' x '.join(map(str, counts))} places")
    return np.array(values.flat, dtype=np.int64).reshape(counts, order="F")


def _targets(
    site: BlockContext, shape: tuple[int, ...], axes: Sequence[list[tuple[int, int]] | Signal], source: tuple[int, ...]
) -> list[tuple[tuple[int, ...], int | None]]:
    """The elements that one value may go to, each with the condition under which it does; None for always."""
    found: list[tuple[tuple[int, ...], int | None]] = [((), None)]
    for axis, at in enumerate(source):
        places = axes[axis]
        along: list[tuple[int, int | None]]
        if isinstance(places, Signal):
            along = [
                (k, site.builder.call("eq", places.flat[at], site.builder.const(float(k)))) for k in range(shape[axis])
            ]
        else:
            along = [(places[at][1], None)]
        found = [((*head, k), site.compiler.gates.both(was, now)) for head, was in found for k, now in along]
    return found


@block("Squeeze", "PermuteDimensions", Order="[2,1]", SampleTime="-1")
def permuted(site: BlockContext) -> SignalOrBus:
    """The input with its dimensions in another order, or without those of a single element."""
    x = site.input()
    if site.atom.kind == "Squeeze":
        return x  # arrays have at most two dimensions here, and those are never taken away
    order = site.numbers("Order").ravel().tolist()
    if order in ([1.0], [1.0, 2.0]):
        return x
    if order != [2.0, 1.0]:
        raise UnsupportedError(f"its Order is {site.text('Order')[:40]}, and arrays have at most two dimensions here")
    return Signal(as_matrix(x).T, x.period)


@block("Convert 1-D to 2-D", linked=True, M="1", N="1")
def as_two_dimensional(site: BlockContext) -> SignalOrBus:
    """The elements of a vector as a matrix of M rows and N columns."""
    x, shape = site.input(), (site.whole("M", 1), site.whole("N", 1))
    if shape[0] * shape[1] != x.size:
        raise UnsupportedError(f"{x.size} elements do not fit {shape[0]} x {shape[1]}")
    return Signal(np.array(x.flat, dtype=np.int64).reshape(shape, order="F"), x.period)


@block("Transpose", linked=True)
def transposed(site: BlockContext) -> SignalOrBus:
    """Rows and columns exchanged; a vector becomes a row."""
    x = site.input()
    return Signal(as_matrix(x).T, x.period)


def as_matrix(x: Signal) -> Nodes:
    """A signal as a matrix; a vector as a column."""
    return x.nodes.reshape(-1, 1) if x.nodes.ndim == 1 else x.nodes


@block("Cross Product", "3x3 Cross Product", linked=True)
def cross_product(site: BlockContext) -> SignalOrBus:
    """The cross product of two vectors of three elements."""
    a, b = site.input(0), site.input(1)
    if a.size != 3 or b.size != 3:
        raise UnsupportedError(f"its inputs have {a.size} and {b.size} elements, not 3")
    p, q, call = a.flat, b.flat, site.builder.call
    made = [call("sub", call("mul", p[i], q[j]), call("mul", p[j], q[i])) for i, j in ((1, 2), (2, 0), (0, 1))]
    return Signal(np.array(made, dtype=np.int64).reshape(a.shape), fastest_sample_time([a.period, b.period]))


@block("Determinant of 3x3 Matrix", linked=True)
def determinant(site: BlockContext) -> SignalOrBus:
    """The determinant of a matrix."""
    x = site.input()
    return scalar(determinant_of(site, _square(as_matrix(x))), x.period)


@block("Invert  3x3 Matrix", "Invert 3x3 Matrix", linked=True)
def inverse(site: BlockContext) -> SignalOrBus:
    """The inverse of a matrix."""
    x = site.input()
    return Signal(inverse_of(site, as_matrix(x)), x.period)


def _square(matrix: Nodes) -> Nodes:
    rows, columns = matrix.shape
    if rows != columns or rows > _LARGEST_INVERSE:
        raise UnsupportedError(
            f"it inverts a matrix of {rows} x {columns}; only square ones up to {_LARGEST_INVERSE} x"
            f" {_LARGEST_INVERSE} can be",
        )
    return matrix


def determinant_of(site: BlockContext, matrix: Nodes) -> int:
    """The determinant of a small matrix, along its first row."""
    if matrix.shape == (1, 1):
        return int(matrix[0, 0])
    terms = [
        site.builder.call("mul", int(matrix[0, at]), _cofactor(site, matrix, 0, at)) for at in range(matrix.shape[1])
    ]
    return reduce_nodes(site.builder, "add", terms)


def _cofactor(site: BlockContext, matrix: Nodes, row: int, column: int) -> int:
    minor = determinant_of(site, np.delete(np.delete(matrix, row, axis=0), column, axis=1))
    return minor if (row + column) % 2 == 0 else site.builder.call("neg", minor)


def inverse_of(site: BlockContext, matrix: Nodes) -> Nodes:
    """The inverse of a matrix of up to three rows, by its cofactors; infinite or NaN where it has none."""
    whole = determinant_of(site, _square(matrix))
    if matrix.shape == (1, 1):
        return np.array([[site.builder.call("div", site.builder.const(1.0), whole)]], dtype=np.int64)
    made = np.empty_like(matrix)
    for row, column in np.ndindex(*matrix.shape):
        made[column, row] = site.builder.call("div", _cofactor(site, matrix, row, column), whole)
    return made
