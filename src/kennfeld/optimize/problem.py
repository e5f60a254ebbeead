"""A calibration problem: model, data, parameters and criteria; and its compiled form.

Time constants are never below 0: where a table is one, its values are bounded so.

Without the bound, a fit that presses a time constant towards 0 would have its steps rejected one after the other, for
all values together, and get nowhere.

Breakpoints as values to be fitted: which axes move, and what they keep while they do.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Literal

import numpy as np

from kennfeld.arrays import Float
from kennfeld.constraints import Equality, Limit, Pin, Shape
from kennfeld.criteria import Criterion
from kennfeld.dataset import Dataset
from kennfeld.free_axes import AxisKey, FreeAxis, free_axes
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.models import Model
from kennfeld.optimize.restraint import Restraint
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter
from kennfeld.preprocessing.binding import BoundDataset, bind_inputs
from kennfeld.preprocessing.settling import averaged, averages

__all__ = [
    "Factor",
    "Place",
    "Problem",
    "Smoothness",
    "bound_time_constants",
    "difference",
    "fitted_axes",
    "time_constants",
]

Place = tuple[str, tuple[float, ...]]  # a parameter, and coordinates in it

Factor = float | Literal["auto"]
Smoothness = Mapping[str, Factor | Sequence[Factor]]


def fitted_axes(parameters: ParameterSet, free: Collection[str]) -> dict[AxisKey, FreeAxis]:
    """The axes marked as free on which a free parameter lies."""
    axes = free_axes(parameters)
    return {key: axis for key, axis in axes.items() if any(name in free for name, _ in axis.places)}


@dataclass(frozen=True)
class Problem:
    """Everything a calibration needs, with nothing computed yet.

    `free` are glob patterns of the parameters to fit. `smoothness` gives a factor for a parameter, or one an axis, or
    "auto" in its place. `channels` names the channel of a model input where the names differ. `unknown_shifts` names,
    by dataset, the channels whose shift is to be found. `restraints` are those of tables with
    a chosen smoothness.
    """

    model: Model
    datasets: tuple[Dataset, ...]
    parameters: ParameterSet
    criteria: tuple[Criterion, ...]
    free: tuple[str, ...] = ("*",)
    smoothness: Smoothness = field(default_factory=dict)
    pins: tuple[Pin, ...] = ()
    channels: Mapping[str, str] = field(default_factory=dict)
    constraints: tuple[Shape | Equality, ...] = ()
    limits: tuple[Limit, ...] = ()
    unknown_shifts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    restraints: Mapping[str, Restraint] = field(default_factory=dict)

    @cached_property
    def free_names(self) -> tuple[str, ...]:
        """The parameters that the function looks up and a pattern frees, without the models that it brings along."""
        looked_up = self.model.graph.parameters
        named = (n for n in looked_up if any(fnmatchcase(n, pattern) for pattern in self.free))
        carried = {surrogate.name for surrogate in self.model.surrogates}
        return tuple(n for n in named if n not in carried)

    @property
    def free_size(self) -> int:
        """How many values the free parameters have, locked ones included."""
        return sum(self.parameters[name].size for name in self.free_names)

    @cached_property
    def free_axes(self) -> Mapping[AxisKey, FreeAxis]:
        """The axes whose breakpoints are fitted."""
        return fitted_axes(self.parameters, self.free_names)

    @property
    def idle_axes(self) -> list[AxisKey]:
        """Axes of the function's tables that are marked as free, but on which nothing is fitted."""
        used = self.model.graph.parameters
        return [
            key
            for key, axis in free_axes(self.parameters).items()
            if key not in self.free_axes and any(name in used for name, _ in axis.places)
        ]

    @property
    def held(self) -> list[Place]:
        """The places at which pins and equalities fix what a lookup gives."""
        terms = [term for c in self.constraints if isinstance(c, Equality) for term in c.terms]
        return [(pin.parameter, pin.at) for pin in self.pins] + [(t.parameter, t.at) for t in terms if t.at is not None]

    @cached_property
    def training(self) -> tuple[BoundDataset, ...]:
        """The training data, bound to the model."""
        return tuple(self.bind(data) for data in self.datasets if data.use == "training" and data.weight > 0)

    @cached_property
    def gathered(self) -> tuple[BoundDataset, ...]:
        """The training data as they are compiled: without memory, dropped points stay where they are, not scored."""
        return self.training if self.graph.states else tuple(bound.whole for bound in self.training)

    def bind(self, dataset: Dataset) -> BoundDataset:
        """A dataset as the model reads it."""
        return bind_inputs(dataset, self.graph, self.channels, self.model.step)

    @cached_property
    def graph(self) -> Graph:
        """The model's graph with one more node a criterion, named by `difference`: node minus target node.

        Where steady-state points are averaged over the end of their settling, it is the mean of that.
        """
        b = GraphBuilder.of(self.model.graph)
        names = dict(self.model.graph.names)
        averaging = averages(self.model.graph, self.datasets)
        for i, criterion in enumerate(self.criteria):
            node = names[criterion.node]
            other = self.target_node(criterion)
            found = node if other is None else b.call("sub", node, names[other])
            names[difference(i)] = averaged(b, found) if averaging and not criterion.internal else found
        return b.finish(names, self.model.graph.units, self.model.graph.outputs)

    def target_node(self, criterion: Criterion) -> str | None:
        """The node that a criterion compares with, if it is one."""
        target = criterion.target
        is_channel = target.kind == "channel" or any(target.name in data for data in self.datasets)
        return target.name if target.kind == "node" or (target.kind == "name" and not is_channel) else None

    def target(self, criterion: Criterion, bound: BoundDataset) -> Float:
        """What the difference node shall be at each kept sample; NaN where the sample is not scored."""
        if criterion.target.kind == "number":
            values = np.full(bound.count, criterion.target.value)
        elif self.target_node(criterion) is not None:
            values = np.zeros(bound.count)
        elif criterion.target.name in bound.dataset:
            values = bound.channel(criterion.target.name)
        else:
            values = np.full(bound.count, np.nan)
        counts = bound.scored & ~np.isinf(values)
        return values if counts.all() else np.where(counts, values, np.nan)

    def factors(self, name: str) -> tuple[float, ...]:
        """Smoothness of each axis of a parameter; 0 where it is automatic, until it is chosen."""
        return tuple(0.0 if factor == "auto" else float(factor) for factor in self._smoothness(name))

    def automatic(self, name: str) -> tuple[bool, ...]:
        """Whether the smoothness of each axis of a parameter is to be chosen."""
        return tuple(factor == "auto" for factor in self._smoothness(name))

    @cached_property
    def automatic_names(self) -> tuple[str, ...]:
        """The free parameters with an axis whose smoothness is to be chosen."""
        return tuple(name for name in self.free_names if any(self.automatic(name)))

    def _smoothness(self, name: str) -> Sequence[Factor]:
        given = self.smoothness.get(name, 0.0)
        single = isinstance(given, str) or not isinstance(given, Sequence)
        return (given,) * len(self.parameters[name].axes) if single else given  # type: ignore[return-value]


def difference(criterion: int) -> str:
    """The node that a criterion scores; a name that no formula text can have."""
    return f"\0{criterion}"


def time_constants(graph: Graph) -> list[int]:
    """The nodes T of `if(T < 0, nan, share)`, which is how a lag says that its time constant is invalid."""
    nodes = graph.nodes
    found: dict[int, None] = {}
    for op, args, _ in nodes:
        if op == "select" and nodes[args[0]].op == "lt" and nodes[args[1]].op == "const":
            left, right = nodes[args[0]].args
            if nodes[right].op == "const" and nodes[right].payload == 0.0 and np.isnan(nodes[args[1]].payload):
                found[left] = None
    return list(found)


def bound_time_constants(problem: Problem) -> Problem:
    """The problem with a lower bound of 0 for free parameters that are time constants and nothing else.

    Locked values, and parameters that may only be negative, stay as they are.
    """
    graph = problem.model.graph
    lags = set(time_constants(graph))
    elsewhere = {n.payload for at, n in enumerate(graph.nodes) if n.op == "lookup" and at not in lags}
    names = {graph.nodes[at].payload for at in lags if graph.nodes[at].op == "lookup"} - elsewhere
    found = [_from_zero(problem.parameters[n]) for n in problem.free_names if n in names and n in problem.parameters]
    changed = [parameter for parameter in found if parameter is not None]
    return replace(problem, parameters=problem.parameters.with_parameters(*changed)) if changed else problem


def _from_zero(parameter: Parameter) -> Parameter | None:
    """The parameter with its lower bounds at least 0; None where they are already, or cannot be."""
    lower, upper = (np.broadcast_to(side, parameter.values.shape) for side in (parameter.lower, parameter.upper))
    raised = np.where(parameter.locked, lower, np.maximum(lower, 0.0))
    if np.array_equal(raised, lower) or np.any(raised > upper):
        return None
    return parameter.with_bounds(raised, upper)
