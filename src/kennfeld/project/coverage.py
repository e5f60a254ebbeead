"""Where in its tables a function looks up, over the data."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.graph import Graph
from kennfeld.graph.interpolation import position
from kennfeld.graph.lowering import Lowered, dependent, lower
from kennfeld.native import Simulator
from kennfeld.optimize.data.binding import Bound
from kennfeld.parameters import Parameter, ParameterSet

__all__ = ["Block", "Coverage", "touched"]

_BLOCK = 65536  # samples at once, so that memory does not grow with the data


@dataclass(frozen=True)
class Block:
    """Coordinates of one lookup over some samples; `first` is the number of the first of them."""

    name: str
    first: int
    coordinates: tuple[Float, ...]


class Coverage:
    """The lookups of some tables; with `of_data_alone`, only those whose coordinates no parameter can change."""

    def __init__(
        self, graph: Graph, parameters: ParameterSet, names: Collection[str], *, of_data_alone: bool = False
    ) -> None:
        lowered = lower(graph, parameters)
        nodes = lowered.graph.nodes
        self._parameters, self._states = parameters, bool(lowered.graph.states)
        self._lookups = _lookups(lowered, names, of_data_alone)
        places = dict.fromkeys(at for _, places in self._lookups for at in places)
        self._inputs = {at: nodes[at].payload for at in places if nodes[at].op == "input"}
        self._roots = [at for at in places if at not in self._inputs]
        # most axes carry an input as it is, and compiling takes longer than all else here
        self._simulator = Simulator(lowered, self._roots, parameters) if self._roots else None

    def blocks(self, bound: Bound) -> Iterator[Block]:
        """The coordinates of every lookup, block by block."""
        columns = bound.columns
        for first, last in self._ranges(bound):
            held = {name: values[first:last] for name, values in columns.items()}
            found = {at: held[name] for at, name in self._inputs.items()}
            if self._simulator is not None:
                found |= zip(self._roots, self._simulator.over(held, last - first, self._parameters), strict=True)
            for name, places in self._lookups:
                yield Block(name, first, tuple(found[at] for at in places))

    def _ranges(self, bound: Bound) -> Iterator[tuple[int, int]]:
        """Pieces where there are states, else blocks."""
        firsts = bound.starts.tolist() if self._states else range(0, bound.count, _BLOCK)
        yield from pairwise([*firsts, bound.count])


def _lookups(lowered: Lowered, names: Collection[str], of_data_alone: bool) -> list[tuple[str, tuple[int, ...]]]:
    nodes = lowered.graph.nodes
    moving: Collection[int] = ()
    if of_data_alone:
        moving = dependent(lowered.graph, lambda node: node.op == "interpolate")
    found = []
    for node in nodes:
        if node.op == "interpolate" and node.args and node.payload.name in names:
            places = tuple(nodes[at].args[0] for at in node.args)
            if moving == () or not any(at in moving for at in places):
                found.append((node.payload.name, places))
    return found


def touched(
    coverage: Coverage, parameters: Mapping[str, Parameter], bound: Bound, counts: Callable[[Bound], Bool]
) -> dict[str, Bool]:
    """For each table, the values that a sample's lookup gives a weight; `counts` says which samples do."""
    counting = counts(bound)
    seen: dict[str, Bool] = {}
    for block in coverage.blocks(bound):
        table = parameters[block.name]
        mask = seen.setdefault(block.name, np.zeros(table.values.shape, dtype=bool))
        some = counting[block.first : block.first + block.coordinates[0].size]
        _mark(mask, table, [x[some] for x in block.coordinates])
    return seen


def _mark(mask: Bool, table: Parameter, coordinates: list[Float]) -> None:
    sides = []
    known = np.logical_and.reduce([np.isfinite(x) for x in coordinates])
    for x, axis in zip(coordinates, table.index_axes, strict=True):
        place = position(x[known], axis.breakpoints, table.extrapolation)
        last = max(len(axis) - 2, 0)
        cell = np.clip(np.floor(place), 0, last).astype(np.int64)
        sides.append([(cell, place - cell != 1.0), (np.minimum(cell + 1, len(axis) - 1), place != cell)])
    for corner in product(*sides):
        used = np.logical_and.reduce([weighted for _, weighted in corner])
        mask[tuple(cell[used] for cell, _ in corner)] = True
