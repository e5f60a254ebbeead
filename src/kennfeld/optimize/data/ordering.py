"""The order in which samples without memory are visited: near ones together, so that they touch the same values.

Samples are sorted within blocks: large enough to hold several of every cell of a usual table, so small that sorting
takes next to no memory.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.graph.interpreter import Interpreter
from kennfeld.graph.lowering import Lowered, dependent
from kennfeld.graph.node import extract
from kennfeld.parameters import ParameterSet

__all__ = ["Cells", "scored_in_order"]

BLOCK = 2**17  # samples
AT_ONCE = 2**13  # samples whose cells are looked for at once, in a cache
FINEST = 2**40  # cells told apart


class Cells:
    """Numbers samples by the cells of all tables whose coordinates the inputs determine."""

    def __init__(self, lowered: Lowered) -> None:
        self._counts = _searched(lowered)
        self._graph = extract(lowered.graph.nodes, (), {str(at): at for at in self._counts}, {}, ())
        self._inputs = {node.payload for node in self._graph.nodes if node.op == "input"}
        self._interpreter = Interpreter(lowered, ParameterSet())

    def numbers(self, columns: Mapping[str, Float], first: int, last: int) -> Int:
        """A number for each sample of a range that is the same within a cell."""
        found = np.zeros(last - first, dtype=np.int64)
        for at in range(first, last, AT_ONCE):
            here = slice(at, min(at + AT_ONCE, last))
            self._number(found[at - first : here.stop - first], {name: columns[name][here] for name in self._inputs})
        return found

    def _number(self, found: Int, columns: Mapping[str, Float]) -> None:
        with np.errstate(all="ignore"):
            places = self._interpreter.run(self._graph.nodes, (), columns)
        cells = 1
        for at, count in self._counts.items():
            cells *= count
            if cells > FINEST:
                break
            cell = np.clip(np.floor(np.nan_to_num(places[self._graph.names[str(at)]])), -1, count - 2)
            found *= count
            found += cell.astype(np.int64) + 1


def _searched(lowered: Lowered) -> dict[int, int]:
    """The positions at which tables are looked up and that no table determines, with the number of their cells."""
    nodes = lowered.graph.nodes
    moving = dependent(lowered.graph, lambda node: node.op == "interpolate")
    return {
        at: lowered.axes[axis.number].size + 2
        for node in nodes
        if node.op == "interpolate"
        for at, axis, smoothed in zip(node.args, node.payload.axes, node.payload.smoothed, strict=True)
        if not smoothed and at not in moving
    }


def scored_in_order(columns: Mapping[str, Float], targets: Sequence[Float], cells: Cells) -> Iterator[Int]:
    """The samples that have a target, block by block, those of a block sorted by cell."""
    count = targets[0].size
    for first in range(0, count, BLOCK):
        last = min(first + BLOCK, count)
        numbers = cells.numbers(columns, first, last)
        numbers *= BLOCK
        numbers += np.arange(last - first)
        numbers = numbers[_scored(targets, first, last)]
        numbers.sort()
        numbers &= BLOCK - 1
        numbers += first
        yield numbers


def _scored(targets: Sequence[Float], first: int, last: int) -> Bool:
    """Which samples of a range have a target."""
    scored = np.zeros(last - first, dtype=bool)
    for target in targets:
        scored |= np.isfinite(target[first:last])
    return scored
