"""Training data brought into the arrays that a kernel reads, in the order in which it reads them best."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.graph import Graph
from kennfeld.graph.lowering import Lowered
from kennfeld.graph.split import Split
from kennfeld.native import Kernel, Piece, Samples, Simulator
from kennfeld.optimize.binding import Bound
from kennfeld.parameters import ParameterSet

__all__ = ["Source", "gather"]

BLOCK = 65536  # samples computed at once


@dataclass(frozen=True)
class Source:
    """A bound dataset, its targets (made when they are needed: they may be large), and the weight of each."""

    bound: Bound
    targets: Sequence[Callable[[], Float]]
    scores: Float  # Float[outputs]


def gather(
    sources: Sequence[Source], lowered: Lowered, split: Split, kernel: Kernel, parameters: ParameterSet
) -> Samples:
    """The samples of all sources, data-only parts computed.

    Without memory, samples without a target are left out and the others sorted by cell, so that neighbours touch the
    same values.
    """
    total = sum(source.bound.count for source in sources)
    data = np.empty((len(kernel.layout.inputs), total))
    targets = np.empty((len(kernel.outputs), total))
    pieces: list[Piece] = []
    end = 0
    for source in sources:
        here = slice(end, end + source.bound.count)
        rows, wanted = data[:, here], targets[:, here]
        _fill(rows, source.bound, lowered, split, kernel, parameters)
        for row, target in zip(wanted, source.targets, strict=True):
            row[:] = target()
        if kernel.line.states:
            edges = [*source.bound.starts.tolist(), source.bound.count]
            pieces += [Piece(end + a, end + b, source.scores) for a, b in pairwise(edges)]
            end += source.bound.count
        else:
            count = _sort(rows, wanted, _cell_keys(rows, lowered, split, kernel))
            pieces += [Piece(end, end + count, source.scores)] if count else []
            end += count
    return Samples(data[:, :end], targets[:, :end], tuple(pieces))


def _fill(rows: Float, bound: Bound, lowered: Lowered, split: Split, kernel: Kernel, parameters: ParameterSet) -> None:
    inputs = kernel.layout.inputs
    for name, row in inputs.items():
        if name not in split.columns:
            rows[row] = bound.columns[name]
    computed = {name: row for name, row in inputs.items() if name in split.columns}
    if computed:
        _precompute(rows, computed, bound, lowered, split, parameters)


def _precompute(
    rows: Float, computed: Mapping[str, int], bound: Bound, lowered: Lowered, split: Split, parameters: ParameterSet
) -> None:
    """Fill the rows that hold what depends on the data alone; block by block where there is no memory."""
    graph = split.prepared
    prepared = Lowered(graph, lowered.axes, {name: lowered.shapes[name] for name in _tables(graph)})
    simulator = Simulator(prepared, [graph.names[name] for name in computed], parameters)
    names = simulator.inputs
    whole = bool(graph.states)
    length = max(bound.count, 1) if whole else BLOCK
    for first in range(0, bound.count, length):
        last = min(first + length, bound.count)
        block = np.array([bound.columns[name][first:last] for name in names]).reshape(len(names), last - first)
        found = simulator.run(parameters, block, bound.starts.tolist() if whole else [0])
        for row, values in zip(computed.values(), found, strict=True):
            rows[row, first:last] = values


def _tables(graph: Graph) -> set[str]:
    return {node.payload.name for node in graph.nodes if node.op == "interpolate"}


def _cell_keys(rows: Float, lowered: Lowered, split: Split, kernel: Kernel) -> Int | None:
    """A number for each sample that is the same within a cell of the positions that the data determine."""
    keys, cells = None, 1
    for name, at in split.columns.items():
        op, _, payload = lowered.graph.nodes[at]
        if op != "position" or name not in kernel.layout.inputs:
            continue
        count = lowered.axes[payload.number].size + 2
        if cells * count > 2**31:
            break
        cell = np.clip(np.nan_to_num(rows[kernel.layout.inputs[name]]), -1, count - 2).astype(np.int32) + 1
        keys = cell if keys is None else keys * np.int32(count) + cell
        cells *= count
    if keys is not None and cells <= 2**16:
        keys = keys.astype(np.uint16)  # sorted by radix
    return keys


def _sort(rows: Float, targets: Float, keys: Int | None) -> int:
    """Move the samples that have a target to the front, sorted by their key; returns how many."""
    scored = np.asarray(np.isfinite(targets).any(axis=0))
    count = int(scored.sum())
    if keys is None and count == scored.size:
        return count
    order = np.flatnonzero(scored) if keys is None else np.argsort(keys, kind="stable")
    if keys is not None and count < scored.size:
        order = order[scored[order]]
    for row in (*rows, *targets):
        row[:count] = row[order]
    return count
