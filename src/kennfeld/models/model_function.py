"""`ModelFunction`: a function read from a file, as a model of its own or as a function that formula text calls."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import partial
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

from kennfeld.base.errors import ArgumentError, Finding
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.integration import DEFAULT_SOLVER, apply_solver, has_marks, is_continuous
from kennfeld.models.model import Model

Deferred = Callable[[], int]
Write = Callable[[GraphBuilder, Sequence[Any]], Sequence[int]]


class FunctionInput(NamedTuple):
    """An input.

    Attributes:
        name: its name.
        unit: its unit.
        default: value of an argument that is not given; None if it is required.
        later: True if only later samples use its value, so that it may depend on the outputs; `ModelFunction.write`
            then also takes a callable that returns its node, and is called when all nodes exist.
    """

    name: str
    unit: str = ""
    default: float | None = None
    later: bool = False


class FunctionOutput(NamedTuple):
    """An output."""

    name: str
    unit: str = ""


class FunctionSummary(NamedTuple):
    """A function of a file as its source declares it.

    Attributes:
        name: its name.
        arguments: its arguments.
        results: its results.
        problem: why it cannot be read; empty if its declaration does not tell.
    """

    name: str
    arguments: tuple[str, ...]
    results: tuple[str, ...]
    problem: str = ""


@dataclass(frozen=True)
class ModelFunction:
    """A function with named inputs and outputs, and perhaps parameters and states.

    Attributes:
        name: name by which formula text calls it.
        inputs: the arguments, in order; those with a default last.
        outputs: at least one. Formula text calls output `y` of function `f` as `f.y(...)`, a single one as `f(...)`.
        write: `write(builder, arguments)` adds the nodes of one step to a graph, and returns those of the outputs.
        memory: True if these nodes have states.
        values: parameters that the nodes look up, with the values of the source.
        source: path of the source.
        step: the function's own step in s, if it has one.
        remarks: what runs differently from the source, such as inexact derivatives.
        states: names of what it keeps between steps, if the source names it.
    """

    name: str
    inputs: tuple[FunctionInput, ...]
    outputs: tuple[FunctionOutput, ...]
    write: Write
    memory: bool = False
    values: ParameterSet = field(default_factory=ParameterSet)
    source: str = ""
    step: float | None = None
    remarks: tuple[Finding, ...] = ()
    states: tuple[str, ...] = ()

    @property
    def calls(self) -> Mapping[str, int]:
        """The names by which formula text calls the outputs, with their numbers."""
        names = {f"{self.name}.{output.name}": number for number, output in enumerate(self.outputs)}
        return FrozenDict(names | ({self.name: 0} if len(self.outputs) == 1 else {}))


def as_model(function: ModelFunction, solver: str = DEFAULT_SOLVER) -> Model:
    """Write a function as a model of its own: its inputs are channels, its outputs nodes.

    Args:
        function: the function.
        solver: solver of its continuous states, if it has any; a name in `graph.integration.SOLVERS`.

    >>> double = ModelFunction("double", (FunctionInput("x", "Nm"),), (FunctionOutput("y", "Nm"),), _twice)
    >>> model = as_model(double)
    >>> model.graph.inputs, model.graph.outputs, dict(model.graph.units)
    (('x',), ('y',), {'x': 'Nm', 'y': 'Nm'})
    """
    builder = GraphBuilder()
    results = function.write(builder, [builder.input(each.name) for each in function.inputs])
    names = {output.name: node for output, node in zip(function.outputs, results, strict=True)}
    equations = builder.finish(names, {}, tuple(names))
    continuous = is_continuous(equations)
    graph = apply_solver(equations, solver) if has_marks(equations) else equations
    stated = {x.name: x.unit for x in function.inputs} | {y.name: y.unit for y in function.outputs}
    known = {*graph.inputs, *graph.names}
    units = {name: unit for name, unit in stated.items() if unit and name in known}
    return Model(
        graph=replace(graph, units=FrozenDict(units)),
        equations=replace(equations, units=FrozenDict(units)) if continuous else None,
        solver=solver if continuous else "",
        stepped=continuous,
        name=function.name,
        step=function.step,
        declared=graph.parameters,
        source=function.source,
        values=function.values,
        remarks=function.remarks,
    )


def as_function(model: Model, name: str) -> ModelFunction:
    """Return a model without memory as a function that formula text calls; its parameters keep their names.

    Raises:
        ArgumentError: the model has memory.

    >>> double = as_model(ModelFunction("double", (FunctionInput("x"),), (FunctionOutput("y"),), _twice))
    >>> as_function(double, "g").inputs[0].name, dict(as_function(double, "g").calls)
    ('x', {'g.y': 0, 'g': 0})
    """
    graph = model.graph
    if graph.states:
        raise ArgumentError(f"{name}: model {model.name} has memory, so that formula text cannot call it")
    inputs = tuple(FunctionInput(channel, graph.units.get(channel, "")) for channel in graph.inputs)
    outputs = tuple(FunctionOutput(output, graph.units.get(output, "")) for output in graph.outputs)
    write = partial(_write_graph, graph)
    return ModelFunction(name, inputs, outputs, write, values=model.carried, remarks=model.remarks)


def _write_graph(graph: Graph, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
    known = dict(zip(graph.inputs, arguments, strict=True))
    numbers: list[int] = []
    # nodes are in the order of their dependencies
    for node in graph.nodes:
        if node.op == "input" and node.payload in known:
            numbers.append(known[node.payload])
        else:
            numbers.append(builder.rebuild(node, tuple(numbers[at] for at in node.args)))
    return [numbers[graph.names[output]] for output in graph.outputs]


def share_calls(write: Write) -> Write:
    """Return a function that adds the nodes of equal calls once to a builder, so that they share their states."""
    # weak keys: a builder is gone once its graph is finished
    written: WeakKeyDictionary[GraphBuilder, dict[tuple[Any, ...], Sequence[int]]] = WeakKeyDictionary()

    def share(builder: GraphBuilder, arguments: Sequence[int | Deferred]) -> Sequence[int]:
        calls = written.setdefault(builder, {})
        # an argument that is evaluated later has a key, equal for equal expressions
        key = tuple(getattr(argument, "key", argument) for argument in arguments)
        if key not in calls:
            calls[key] = write(builder, arguments)
        return calls[key]

    return share


def _twice(builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
    return [builder.call("mul", builder.const(2.0), arguments[0])]
