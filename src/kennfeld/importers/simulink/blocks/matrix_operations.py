"""Matrix Operations library: assignment, permutation, transpose, cross product, determinant and inverse."""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.formatting import size_text
from kennfeld.importers.simulink.lowering import BlockContext, UnsupportedError, block
from kennfeld.importers.simulink.lowering.parameter_fields import (
    dimension_settings,
    first_index,
    index_options,
    selected_indices,
)
from kennfeld.importers.simulink.reader.dialog_words import begins_with_word
from kennfeld.importers.simulink.signals import Signal, SignalOrBus, apply, period_of
from kennfeld.models.imperative.linear_systems import MAX_EQUATIONS, inverse_matrix, matrix_determinant
from kennfeld.models.imperative.node_arrays import Nodes

_MAX_COMPARISONS = 100_000


@block("Assignment", NumberOfDimensions="1", IndexMode="One-based", Indices="", IndexParamArray="", OutputSizes="",
       OutputInitialize="Initialize using input port <Y0>", IndexOptions="", SampleTime="-1")  # fmt: skip
def assignment(block: BlockContext) -> SignalOrBus:
    """Replace elements of the first input by those of the second; indices may be further inputs."""
    how = block.field_text("OutputInitialize")
    if not begins_with_word(how, "Initialize using input port"):
        raise UnsupportedError(f"OutputInitialize {how!r} is not supported: unassigned elements would be undefined")
    into, values = block.input(0), block.input(1)
    dimensions = block.integer_field("NumberOfDimensions", 1, 2)
    nodes = np.array(into.flat, dtype=np.int64) if dimensions == 1 else into.nodes
    if nodes.ndim != dimensions:
        raise UnsupportedError(f"it assigns along {dimensions} dimensions, but its input has {nodes.ndim}")
    options = index_options(block) or ["Index vector (dialog)"] * dimensions
    index_fields = dimension_settings(block, "Indices", "IndexParamArray")
    port, axes = 2, list[list[int] | Signal]()
    for axis, option in enumerate(options[:dimensions]):
        if option.endswith("(port)"):
            axes.append(_variable_indices(block, block.input(port), option, values, nodes, axis))
            port += 1
        else:
            text = index_fields[axis] if axis < len(index_fields) else ""
            count = _extent(values, axis, nodes.ndim) if option.startswith("Starting") else None
            option = "Select all" if option == "Assign all" else option
            axes.append(selected_indices(block, option, text, nodes.shape[axis], axis, count))
    assigned = _assigned(block, nodes, values, axes)
    if dimensions == 1:
        # elements of a matrix are numbered by columns
        assigned = assigned.reshape(into.shape, order="F")
    return block.signal(assigned, period_of(block.inputs))


def _extent(values: Signal, axis: int, dimensions: int) -> int:
    if values.size == 1 or dimensions == 1:
        return values.size
    return values.nodes.shape[axis] if values.nodes.ndim == 2 else values.size


def _variable_indices(
    block: BlockContext, index: Signal, option: str, values: Signal, nodes: Nodes, axis: int
) -> Signal:
    """Return the indices from a signal, from 0; a starting index covers as many elements as there are values."""
    places = apply("floor", index) - float(first_index(block))
    if option.startswith("Starting"):
        places = places + block.constant(*map(float, range(_extent(values, axis, nodes.ndim))))
    if places.size * nodes.size > _MAX_COMPARISONS:
        raise UnsupportedError(f"{places.size} variable indices into {nodes.size} elements are too many")
    return places


def _assigned(block: BlockContext, nodes: Nodes, values: Signal, axes: Sequence[list[int] | Signal]) -> Nodes:
    counts = tuple(axis.size if isinstance(axis, Signal) else len(axis) for axis in axes)
    new_nodes, assigned = _spread_values(values, counts), nodes.copy()
    for source in np.ndindex(*counts):
        for place, condition in _targets(block, nodes.shape, axes, source):
            # in the order of the values: of several with one index, the last one counts
            new, old = int(new_nodes[source]), int(assigned[place])
            assigned[place] = new if condition is None else block.builder.call("select", condition, new, old)
    return assigned


def _spread_values(values: Signal, counts: tuple[int, ...]) -> Nodes:
    if values.size == 1:
        return np.full(counts, values.flat[0], dtype=np.int64)
    if values.size != int(np.prod(counts)):
        raise UnsupportedError(f"it assigns {values.size} elements to {size_text(counts)} positions")
    return np.array(values.flat, dtype=np.int64).reshape(counts, order="F")


def _targets(
    block: BlockContext, shape: tuple[int, ...], axes: Sequence[list[int] | Signal], source: tuple[int, ...]
) -> list[tuple[tuple[int, ...], int | None]]:
    """Return the elements that one value may be assigned to, each with its condition (None if unconditional)."""
    targets: list[tuple[tuple[int, ...], int | None]] = [((), None)]
    for at, size, places in zip(source, shape, axes, strict=False):
        along: list[tuple[int, int | None]] = []
        if isinstance(places, Signal):
            call, index = block.builder.call, places.flat[at]
            # an index that is only known at run time is compared with each element
            along += [(k, call("eq", index, block.builder.const(float(k)))) for k in range(size)]
        else:
            along.append((places[at], None))
        targets = [
            ((*head, k), block.compiler.gates.conjunction(was, now)) for head, was in targets for k, now in along
        ]
    return targets


@block("Squeeze", "PermuteDimensions", Order="[2,1]", SampleTime="-1")
def permute(block: BlockContext) -> SignalOrBus:
    """Permute the dimensions of the input, or remove those of size 1."""
    x = block.input()
    if block.flat.type == "Squeeze":
        return x  # arrays have at most two dimensions, which are kept
    order = block.numeric_array("Order").ravel().tolist()
    if order in ([1.0], [1.0, 2.0]):
        return x
    if order != [2.0, 1.0]:
        text = block.field_text("Order")[:40]
        raise UnsupportedError(f"its Order {text} is not supported: arrays have at most two dimensions")
    return block.signal(x.matrix.T, x.period)


@block("Convert 1-D to 2-D", linked=True, M="1", N="1")
def as_two_dimensional(block: BlockContext) -> SignalOrBus:
    """Reshape a vector to a matrix of M rows and N columns."""
    x, shape = block.input(), (block.integer_field("M", 1), block.integer_field("N", 1))
    if shape[0] * shape[1] != x.size:
        raise UnsupportedError(f"{x.size} elements cannot be reshaped to {shape[0]} x {shape[1]}")
    return block.signal(x.flat, x.period, shape)


@block("Transpose", linked=True)
def transpose(block: BlockContext) -> SignalOrBus:
    """Transpose the input; a vector becomes a row."""
    return block.signal(block.input().matrix.T, block.input().period)


@block(
    "Cross Product", "3x3 Cross Product", "matrix_library/Cross Product", "vrlib/Utilities/Cross Product", linked=True
)
def cross_product(block: BlockContext) -> SignalOrBus:
    """Compute the cross product of two vectors of three elements."""
    a, b = block.input(0), block.input(1)
    if a.size != 3 or b.size != 3:
        raise UnsupportedError(f"its inputs must have 3 elements each, got {a.size} and {b.size}")
    p, q, call = a.flat, b.flat, block.builder.call
    # c_k = a_i b_j - a_j b_i for (i, j, k) in cyclic order
    nodes = [call("sub", call("mul", p[i], q[j]), call("mul", p[j], q[i])) for i, j in ((1, 2), (2, 0), (0, 1))]
    return block.signal(nodes, period_of((a, b)), a.shape)


@block("Determinant of 3x3 Matrix", linked=True)
def determinant(block: BlockContext) -> SignalOrBus:
    """Compute the determinant of a matrix."""
    x = block.input()
    return block.signal([matrix_determinant(block.builder, _square(x.matrix))], x.period)


@block("Invert  3x3 Matrix", "Invert 3x3 Matrix", linked=True)
def inverse(block: BlockContext) -> SignalOrBus:
    """Invert a matrix."""
    x = block.input()
    return block.signal(inverse_of(block, x.matrix), x.period)


def _square(matrix: Nodes) -> Nodes:
    rows, columns = matrix.shape
    if rows != columns or rows > MAX_EQUATIONS:
        limit = f"only square matrices up to {MAX_EQUATIONS} x {MAX_EQUATIONS} are supported"
        raise UnsupportedError(f"it inverts a matrix of size {rows} x {columns}; {limit}")
    return matrix


def inverse_of(block: BlockContext, matrix: Nodes) -> Nodes:
    """Invert a matrix, Int[rows, rows]; infinite or NaN if it is singular."""
    return inverse_matrix(block.builder, _square(matrix))
