"""Training data as a kernel reads them: each column where it is, the rest computed, and the order of visits."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kennfeld.arrays import Float
from kennfeld.graph import Graph
from kennfeld.graph.lowering import Lowered
from kennfeld.graph.split import Split
from kennfeld.native import Kernel, Piece, Samples, Simulator
from kennfeld.native.rows import Order
from kennfeld.optimize.data.binding import Bound
from kennfeld.optimize.data.ordering import Cells, scored_in_order
from kennfeld.parameters import ParameterSet

__all__ = ["Source", "gather"]

Columns = Mapping[str, Float]


@dataclass(frozen=True)
class Source:
    """A bound dataset, what gives its targets, and the weight of each."""

    bound: Bound
    targets: Sequence[Callable[[], Float]]
    scores: Float  # Float[outputs]


def gather(
    sources: Sequence[Source], lowered: Lowered, split: Split, kernel: Kernel, parameters: ParameterSet
) -> Samples:
    """The samples of all sources, data-only parts computed.

    Without memory, samples without a target are left out and the others visited by cell, so that neighbours touch the
    same values.
    """
    prepare = _preparation(lowered, split, kernel, parameters)
    columns = [source.bound.columns | prepare(source.bound) for source in sources]
    targets = [[target() for target in source.targets] for source in sources]
    if kernel.line.states:
        pieces, order = _in_time(sources), None
    else:
        pieces, order = _by_cell(sources, columns, targets, Cells(Lowered(split.graph, lowered.axes, lowered.shapes)))
    rows = [[held[name] for held in columns] for name in kernel.layout.inputs]
    return Samples(rows, zip(*targets, strict=True), pieces, order)


def _preparation(
    lowered: Lowered, split: Split, kernel: Kernel, parameters: ParameterSet
) -> Callable[[Bound], dict[str, Float]]:
    """What computes the columns that depend on the data alone."""
    graph = split.prepared
    names = [name for name in kernel.layout.inputs if name in split.columns]
    if not names:
        return lambda _: {}
    prepared = Lowered(graph, lowered.axes, {name: lowered.shapes[name] for name in _tables(graph)})
    simulator = Simulator(prepared, [graph.names[name] for name in names], parameters)

    def prepare(bound: Bound) -> dict[str, Float]:
        starts = bound.starts.tolist() if graph.states else [0]
        return dict(zip(names, simulator.over(bound.columns, bound.count, parameters, starts), strict=True))

    return prepare


def _tables(graph: Graph) -> set[str]:
    return {node.payload.name for node in graph.nodes if node.op in ("interpolate", "expansion")}


def _in_time(sources: Sequence[Source]) -> list[Piece]:
    """The pieces of all sources, one after the other."""
    pieces, end = [], 0
    for source in sources:
        edges = [*source.bound.starts.tolist(), source.bound.count]
        pieces += [Piece(end + a, end + b, source.scores) for a, b in pairwise(edges)]
        end += source.bound.count
    return pieces


def _by_cell(
    sources: Sequence[Source], columns: Sequence[Columns], targets: Sequence[Sequence[Float]], cells: Cells
) -> tuple[list[Piece], Order | None]:
    """A piece a source, and the order of visits; None where that is how the samples come."""
    total = sum(source.bound.count for source in sources)
    order = np.empty(total, dtype=np.uint32)
    pieces, before, end = [], 0, 0
    for source, held, wanted in zip(sources, columns, targets, strict=True):
        first = end
        for block in scored_in_order(held, wanted, cells):
            order[end : end + block.size] = before + block
            end += block.size
        pieces += [Piece(first, end, source.scores)] if end > first else []
        before += source.bound.count
    straight = end == total and bool(np.all(order[1:] > order[:-1]))
    return pieces, None if straight else order[:end]
