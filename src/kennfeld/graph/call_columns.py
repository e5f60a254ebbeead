"""Calls outside of the graph as columns: their results at the samples, and slopes of these, as inputs of the graph.

A function that is called for all samples at once, or that runs through a whole trajectory, cannot be called from within
a step. Before each evaluation of the graph its results y and their slopes are therefore computed at all samples, for
the current values, and the graph reads them:

    y(x) = y0 + dy/dx (x - x0)

with the arguments x, and columns y0, dy/dx and x0. For the current values x is equal to x0, so that results and
derivatives with respect to parameters are exact. A trajectory depends on the values of parameters themselves, which
take the place of x.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.external_function import ExternalFunction, is_sequential
from kennfeld.graph.lookup_lowering import Free, TableRef, is_atom
from kennfeld.graph.node import Graph, Node, extract
from kennfeld.graph.traversal import dependents, rewrite


class TableValue(NamedTuple):
    """A value of a table, at a place in its array of values."""

    table: str
    place: tuple[int, ...]


def table_values(parameter: Parameter) -> list[TableValue]:
    """Return all values of a parameter.

    >>> from kennfeld.domain.parameters import Curve
    >>> table_values(Curve("C", [0, 1], [1, 2]))
    [TableValue(table='C', place=(0,)), TableValue(table='C', place=(1,))]
    """
    return [TableValue(parameter.name, place) for place in np.ndindex(parameter.values.shape)]


def unlocked_values(parameter: Parameter) -> list[TableValue]:
    """Return the values of a parameter that are not locked."""
    locked = np.broadcast_to(parameter.locked, parameter.values.shape)
    return [value for value in table_values(parameter) if not locked[value.place]]


@dataclass(frozen=True)
class BatchCall:
    """A call of a function for all samples at once.

    Attributes:
        function: the function.
        arguments: names of the nodes that compute its arguments.
        moving: numbers of the arguments that depend on free parameters.
        results: names of the columns of its outputs.
        points: names of the columns of the moving arguments.
        slopes: names of the columns of the slopes, by output and moving argument.
    """

    function: ExternalFunction
    arguments: tuple[str, ...]
    moving: tuple[int, ...]
    results: tuple[str, ...]
    points: tuple[str, ...]
    slopes: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Trajectories:
    """Results of functions that keep memory, as functions of values of tables.

    Attributes:
        names: names of the nodes of the original graph that hold the results.
        values: the free values on which they depend.
        results: names of the columns of the results, less what the slopes add.
        slopes: names of the columns of the slopes, by result and value.
    """

    names: tuple[str, ...]
    values: tuple[TableValue, ...]
    results: tuple[str, ...]
    slopes: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class CalledColumns:
    """A graph that reads the results of calls as columns.

    Attributes:
        graph: the graph; columns are inputs.
        batches: calls for all samples at once, in the order in which they can be made.
        trajectories: results of functions that keep memory; None without such a function.
        origin: the original graph, with the names of arguments and of trajectories.
    """

    graph: Graph
    batches: tuple[BatchCall, ...]
    trajectories: Trajectories | None
    origin: Graph

    @property
    def inputs(self) -> Iterator[str]:
        """Names of the columns."""
        for call in self.batches:
            yield from (*call.results, *call.points, *(name for row in call.slopes for name in row))
        if self.trajectories is not None:
            yield from (*self.trajectories.results, *(name for row in self.trajectories.slopes for name in row))


def read_batches(graph: Graph, free: Free = ()) -> CalledColumns:
    """Let a lowered graph read the results of calls as columns where these can be made for all samples at once.

    Calls whose results lead back to their arguments through states are left.

    Args:
        graph: the graph.
        free: parameters and axes whose values are fitted; columns have slopes along arguments that depend on them.
    """
    return _read(graph, free, None)


def read_calls(graph: Graph, free: Free, values: Iterable[TableValue]) -> CalledColumns:
    """Let a lowered graph read the results of calls as columns, also those of functions that keep memory.

    Args:
        graph: the graph.
        free: parameters and axes whose values are fitted.
        values: the free values of tables, along which results of functions that keep memory have slopes.
    """
    results = [at for at, node in enumerate(graph.nodes) if is_sequential(node)]
    return _read(graph, free, _trajectories(graph, results, list(values)) if results else None)


def called_in_loops(graph: Graph) -> list[str]:
    """Return the functions for all samples at once that are called sample by sample, as results lead to arguments."""
    calls = dict.fromkeys((n.payload.function, n.args) for n in graph.nodes if n.op == "external")
    return list(dict.fromkeys(call[0].name for call in calls if call[0].batched and _leads_back(graph, *call)))


def _read(graph: Graph, free: Free, trajectories: Trajectories | None) -> CalledColumns:
    calls = dict.fromkeys((n.payload.function, n.args) for n in graph.nodes if n.op == "external")
    batched = [call for call in calls if call[0].batched and not _leads_back(graph, *call)]
    if not batched and trajectories is None:
        return CalledColumns(graph, (), None, graph)
    moving = dependents(graph, lambda node: is_atom(node, free))
    batches = tuple(_batch(number, *call, moving) for number, call in enumerate(batched))
    names = {
        name: at
        for call, (_, args) in zip(batches, batched, strict=True)
        for name, at in zip(call.arguments, args, strict=True)
    }
    results = [at for at, node in enumerate(graph.nodes) if is_sequential(node)]
    if trajectories is not None:
        # named, so that reducing the graph to its names keeps them
        names |= dict(zip(trajectories.names, results, strict=True)) | _inputs_of(graph, results)
    origin = replace(graph, names={**graph.names, **names})
    written = _Rewriting(graph, dict(zip(batched, batches, strict=True)), trajectories, results)
    return CalledColumns(rewrite(origin, written.resolve), batches, trajectories, origin)


def _inputs_of(graph: Graph, results: Sequence[int]) -> dict[str, int]:
    """Return names that keep the inputs of trajectories in the graph whose calls are columns."""
    needed = extract(graph.nodes, graph.states, {str(at): at for at in results}, {}, ())
    names = {node.payload for node in needed.nodes if node.op == "input"}
    return {f"\0input.{n.payload}": at for at, n in enumerate(graph.nodes) if n.op == "input" and n.payload in names}


def _leads_back(graph: Graph, function: ExternalFunction, args: Sequence[int]) -> bool:
    results = dependents(graph, lambda node: _is_call(node, function, args))
    return not results.isdisjoint(args)


def _is_call(node: Node, function: ExternalFunction, args: Sequence[int]) -> bool:
    return node.op == "external" and node.payload.function == function and node.args == args


def _batch(number: int, function: ExternalFunction, args: Sequence[int], moving: Collection[int]) -> BatchCall:
    # names that no channel can have
    head = f"\0call{number}"
    own = tuple(at for at, node in enumerate(args) if node in moving)
    return BatchCall(
        function,
        tuple(f"{head}.argument{j}" for j in range(function.inputs)),
        own,
        tuple(f"{head}.y{i}" for i in range(function.outputs)),
        tuple(f"{head}.x{j}" for j in own),
        tuple(tuple(f"{head}.dy{i}/dx{j}" for j in own) for i in range(function.outputs)),
    )


def _trajectories(graph: Graph, results: Sequence[int], values: Sequence[TableValue]) -> Trajectories:
    tables = {value.table for value in values}
    # slopes along values that reach no call would be columns of zeros
    reaching = {name for name in tables if not _reached(graph, name).isdisjoint(results)}
    own = tuple(value for value in values if value.table in reaching)
    head = "\0trajectory"
    numbers = range(len(results))
    return Trajectories(
        tuple(f"{head}.result{i}" for i in numbers),
        own,
        tuple(f"{head}.y{i}" for i in numbers),
        tuple(tuple(f"{head}.dy{i}/dp{j}" for j in range(len(own))) for i in numbers),
    )


def _reached(graph: Graph, table: str) -> set[int]:
    return dependents(graph, lambda node: is_atom(node, (table,)))


class _Rewriting:
    """Replaces the calls of a graph by sums over their columns."""

    def __init__(
        self,
        graph: Graph,
        batches: dict[tuple[ExternalFunction, tuple[int, ...]], BatchCall],
        trajectories: Trajectories | None,
        results: Sequence[int],
    ) -> None:
        self.graph, self.batches, self.trajectories = graph, batches, trajectories
        self.numbers = {} if trajectories is None else {at: number for number, at in enumerate(results)}
        self.tables = {n.payload.name: n.payload for n in graph.nodes if n.op == "interpolate"}

    def resolve(self, b: GraphBuilder, at: int, args: tuple[int, ...]) -> int:
        """Return the node that replaces one of the graph."""
        node = self.graph.nodes[at]
        if node.op != "external":
            return b.rebuild(node, args)
        if at in self.numbers:
            return self._result(b, self.numbers[at])
        call = self.batches.get((node.payload.function, node.args))
        return b.rebuild(node, args) if call is None else self._output(b, call, node.payload.number, args)

    def _output(self, b: GraphBuilder, call: BatchCall, number: int, args: Sequence[int]) -> int:
        total = b.input(call.results[number])
        for argument, point, slope in zip(call.moving, call.points, call.slopes[number], strict=True):
            # 0 at the current values; its derivative is that of the argument
            distance = b.call("sub", args[argument], b.input(point))
            total = b.call("add", total, b.call("mul", b.input(slope), distance))
        return total

    def _result(self, b: GraphBuilder, number: int) -> int:
        assert self.trajectories is not None
        total = b.input(self.trajectories.results[number])
        for value, slope in zip(self.trajectories.values, self.trajectories.slopes[number], strict=True):
            # the column of the result lacks the sum over the slopes, which makes it whole at the current values
            total = b.call("add", total, b.call("mul", b.input(slope), self._value(b, value)))
        return total

    def _value(self, b: GraphBuilder, value: TableValue) -> int:
        reference = self.tables[value.table]
        # at whole positions an interpolation is the value itself, unless it is smoothed
        exact = TableRef(reference.name, reference.axes, (False,) * len(reference.axes))
        return b.node("interpolate", tuple(b.const(float(i)) for i in value.place), exact)
