"""Loops over the rows of tensors, written out."""

from collections.abc import Sequence

from kennfeld.importers.onnx.network import Network, Operator
from kennfeld.importers.onnx.registry import Arguments, Context, operator
from kennfeld.importers.onnx.shapes import join
from kennfeld.importers.onnx.tensors import MAX_NODES, Tensor, UnsupportedOperatorError, rearrange, shape_of

MAX_COMPUTATIONS = 50_000  # passes times operators
_LISTS = ("scan_input_axes", "scan_input_directions", "scan_output_axes", "scan_output_directions")


@operator("Scan")
def scan(c: Context, op: Operator, arguments: Arguments) -> list[Tensor]:
    """Apply a graph to states and one row after the other of some tensors; stack the rows that it returns."""
    body, count = op.get("body"), op.get("num_scan_inputs", 0)
    tensors = [argument for argument in arguments if argument is not None]
    # before version 9, the first dimension of all tensors is that of a batch
    if op.version < 9 or any(any(op.get(name, [])) for name in _LISTS):
        raise UnsupportedOperatorError("batches, other axes and reversed directions are not supported")
    if not isinstance(body, Network) or not 1 <= count <= len(tensors):
        raise UnsupportedOperatorError("it has no graph, or no tensors that it is applied to")
    states, sequences = tensors[: len(tensors) - count], tensors[len(tensors) - count :]
    return _passes(c, body, states, sequences)


def _passes(c: Context, body: Network, states: Sequence[Tensor], sequences: Sequence[Tensor]) -> list[Tensor]:
    lengths = {shape_of(sequence)[0] for sequence in sequences}
    if len(lengths) != 1 or 0 in lengths:
        raise UnsupportedOperatorError("its tensors have no rows, or different numbers of them")
    (length,), stacks, current = lengths, [], list(states)
    if length * len(body.operators) > MAX_COMPUTATIONS:
        raise UnsupportedOperatorError(f"its {length} passes take more than {MAX_COMPUTATIONS} operators")
    for number in range(length):
        rows = [rearrange(lambda array, i=number: array[i], sequence) for sequence in sequences]  # type: ignore[misc]
        results = c.run(body, [*current, *rows])
        # the graph returns the states first, then a row of each stacked tensor
        current, row = results[: len(states)], results[len(states) :]
        stacks.append([rearrange(lambda array: array[None], each) for each in row])
        if len(c.builder.nodes) > MAX_NODES:
            raise UnsupportedOperatorError(f"it requires more than {MAX_NODES} operations per step")
    return [*current, *(join(c, rows, 0) for rows in zip(*stacks, strict=True))]
