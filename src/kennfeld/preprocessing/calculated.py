"""Calculated channels and conditions: formula text over the channels of a dataset."""

from collections.abc import Iterable, Mapping
from graphlib import CycleError, TopologicalSorter

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.frozen_dict import FrozenDict
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.graph.interpreter import evaluate
from kennfeld.graph.lookup_lowering import lower_lookups
from kennfeld.models.formula import expression
from kennfeld.native.simulator import Simulator
from kennfeld.preprocessing.binding import bind_inputs
from kennfeld.preprocessing.recipe import DataSettings
from kennfeld.preprocessing.time_shift import shift_channels


def evaluate_expression(graph: Graph, dataset: Dataset) -> Float:
    """Evaluate the node `value` of a graph over all samples of a dataset, Float[samples]; NaN if an input is NaN.

    Graphs with memory are simulated; their states restart at each piece and after each gap.
    """
    if not graph.is_timed:
        columns = {name: dataset[name].values for name in graph.inputs}
        with np.errstate(all="ignore"):
            values = evaluate(graph, columns, ParameterSet())["value"]
        # a formula of constants alone evaluates to one number
        return np.array(np.broadcast_to(values, dataset.samples))
    bound = bind_inputs(dataset, graph, {})
    lowered = lower_lookups(graph, ParameterSet())
    simulator = Simulator(lowered, [lowered.graph.names["value"]], ParameterSet())
    result = np.full(dataset.samples, np.nan)
    result[bound.kept] = simulator.over(bound.columns, bound.count, ParameterSet(), bound.starts.tolist())[0]
    return result


def holds(condition: Graph, dataset: Dataset) -> Bool:
    """Mark the samples at which a condition is true, Bool[samples]; NaN counts as false."""
    values = evaluate_expression(condition, dataset)
    true: Bool = np.isfinite(values) & (values != 0)
    return true


@dataclass(frozen=True)
class Calculated:
    """The graphs of the calculated channels, each after those it reads; `broken` names those with errors."""

    graphs: Mapping[str, Graph]
    broken: frozenset[str] = frozenset()
    findings: tuple[Finding, ...] = ()

    def needed(self, names: Iterable[str]) -> list[str]:
        """Return the calculated channels that these channels need, including themselves, in order of calculation."""
        wanted: set[str] = set()
        stack = list(names)
        while stack:
            name = stack.pop()
            if name in self.graphs and name not in wanted:
                wanted.add(name)
                stack.extend(self.graphs[name].inputs)
        return [name for name in self.graphs if name in wanted]

    def recorded(self, names: Iterable[str]) -> list[str]:
        """Return the recorded channels that these channels need."""
        channels = list(names)
        inputs = [source for name in self.needed(channels) for source in self.graphs[name].inputs]
        return [n for n in dict.fromkeys([*channels, *inputs]) if n not in self.graphs and n not in self.broken]

    def add_to(self, dataset: Dataset, names: Iterable[str], shift: Mapping[str, float]) -> Dataset:
        """Return the dataset with the calculated channels that `names` need and whose inputs it has, each shifted."""
        for name in self.needed(names):
            graph = self.graphs[name]
            if all(source in dataset for source in graph.inputs):
                dataset = dataset.with_channels(Channel(name, evaluate_expression(graph, dataset)))
                # before the next one is calculated, which may read it
                dataset = shift_channels(dataset, {n: s for n, s in shift.items() if n == name})
        return dataset


def parse_calculated(settings: DataSettings) -> Calculated:
    """Return the calculated channels of a project; those with errors are excluded and reported in its findings."""
    graphs = {}
    findings: list[Finding] = []
    for name, text in settings.calculated.items():
        graph, errors = parse_expression(text, settings.location("calculated", name))
        findings += errors
        if graph is not None:
            graphs[name] = graph
    # a sorter reports one circle at a time: report it, drop its channels and sort the others again
    while True:
        needs = {name: [source for source in graph.inputs if source in graphs] for name, graph in graphs.items()}
        try:
            ordered = {name: graphs[name] for name in TopologicalSorter(needs).static_order()}
        except CycleError as error:
            # graphlib lists each channel before the one that reads it
            loop = error.args[1][::-1]
            message = f"circular definition: {' -> '.join(loop)}"
            findings.append(Finding(settings.location("calculated", loop[0]), message, "Give it another name."))
            graphs = {name: graph for name, graph in graphs.items() if name not in loop}
        else:
            broken = frozenset(settings.calculated.keys() - ordered.keys())
            return Calculated(FrozenDict(ordered), broken, tuple(findings))


def parse_expression(text: str, location: Location) -> tuple[Graph | None, tuple[Finding, ...]]:
    """Return the graph of a formula over channels, or None and the errors."""
    try:
        return expression(text, location), ()
    except InputError as error:
        return None, error.findings
