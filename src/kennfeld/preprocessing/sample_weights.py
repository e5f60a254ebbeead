"""Sample weights: from a channel, and from regions of the data.

The weight of a sample multiplies its loss, so that a robust loss still sees the unweighted residual. Samples of weight
0 are not evaluated at all: the model may be undefined there.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.criteria import Criterion, Region
from kennfeld.dataset import Dataset
from kennfeld.errors import Finding, InputError
from kennfeld.formatting import join_names, nearest
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.models.formula import expression
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.calculated import evaluate_expression, uses_clock


def sample_weights(criterion: Criterion, dataset: Dataset) -> Float | None:
    """Return the product of all weights of each sample, Float[samples]; None if there are none. NaN counts as 0."""
    factors = [
        np.nan_to_num(dataset[name].values, nan=0.0)
        for name in (dataset.weight_channel, criterion.weight_channel)
        if name
    ]
    factors += [np.where(_holds(region, dataset), region.weight, 1.0) for region in criterion.regions]
    return np.asarray(np.prod(factors, axis=0)) if factors else None


def _holds(region: Region, dataset: Dataset) -> Bool:
    """Return the samples at which a region's condition is true; false if one of its channels is missing."""
    values = evaluate_expression(expression(region.where, "where"), dataset)
    holds: Bool = np.isfinite(values) & (values != 0)
    return holds


@dataclass(frozen=True)
class SampleWeights:
    """The criteria with sample weights, by number, and the graph input that holds the weights of each."""

    criteria: Sequence[Criterion]
    inputs: Mapping[int, str] = field(default_factory=dict)

    @classmethod
    def of(cls, criteria: Sequence[Criterion], bounds: Sequence[BoundDataset]) -> "SampleWeights":
        """Return the weighting of the criteria over these data."""
        everywhere = any(bound.dataset.weight_channel for bound in bounds)
        weighted = [
            i for i, c in enumerate(criteria) if not c.internal and (everywhere or c.weight_channel or c.regions)
        ]
        return cls(criteria, {i: f"\0weight {i}" for i in weighted})

    def extended(self, graph: Graph) -> Graph:
        """Return the graph with the inputs as further nodes of the same names."""
        if not self.inputs:
            return graph
        b = GraphBuilder.of(graph)
        inputs = {name: b.input(name) for name in self.inputs.values()}
        return b.finish({**graph.names, **inputs}, graph.units, graph.outputs)

    def columns(self, bound: BoundDataset) -> dict[str, Float]:
        """Return the weights of the kept samples by input."""
        return {name: self._weights(i, bound) for i, name in self.inputs.items()}

    def _weights(self, number: int, bound: BoundDataset) -> Float:
        weights = sample_weights(self.criteria[number], bound.dataset)
        return np.ones(bound.count) if weights is None else weights[bound.kept]

    def target(self, number: int, bound: BoundDataset, target: Callable[[], Float]) -> Float:
        """Return the target of a criterion, NaN if the weight is 0."""
        values = target()
        return np.where(self._weights(number, bound) > 0, values, np.nan) if number in self.inputs else values


def weight_findings(
    criteria: Sequence[Criterion],
    datasets: Sequence[Dataset],
    criterion_place: Callable[[int], str],
    dataset_place: Callable[[Dataset], str],
    offered: Sequence[str] = (),
) -> list[Finding]:
    """Report problems of sample weights in the training data; `offered` are further channels of the files."""
    findings = []
    for data in datasets:
        if data.weight_channel:
            findings += _channel(data.weight_channel, data, f"{dataset_place(data)} weight_channel", offered)
    for i, criterion in enumerate(criteria):
        scored = [data for data in datasets if criterion.target.kind != "channel" or criterion.target.name in data]
        for data in scored if criterion.weight_channel else ():
            findings += _channel(criterion.weight_channel, data, f"{criterion_place(i)} weight_channel", offered)
        for number, region in enumerate(criterion.regions, 1):
            findings += _region(region, scored, f"{criterion_place(i)} region {number}", offered)
    if any(finding.severity == "error" for finding in findings):
        return findings
    for i, criterion in enumerate(criteria):
        if datasets and not any(_counts(criterion, data) for data in datasets):
            message = "no training sample has a weight above 0"
            findings.append(Finding(criterion_place(i), message, "Check its weight channels and regions."))
    return findings


def _counts(criterion: Criterion, data: Dataset) -> bool:
    """Return whether a dataset has samples of weight for a criterion."""
    weights = sample_weights(criterion, data)
    return weights is None or bool(np.any(weights[... if data.scored is None else data.scored] > 0))


def _channel(name: str, data: Dataset, place: str, offered: Sequence[str]) -> list[Finding]:
    if name not in data:
        remedy = nearest(name, [*data, *offered]) or f"It has {join_names(data)}."
        return [Finding(place, f"dataset {data.name} has no channel {name}", remedy)]
    values = data[name].values
    wrong = np.flatnonzero((values < 0) | np.isinf(values))
    if wrong.size:
        message = f"{wrong.size} weights of {name} in dataset {data.name} are below 0 or infinite"
        return [
            Finding(place, f"{message}, the first, {values[wrong[0]]:g}, at sample {wrong[0] + 1}", "Correct them.")
        ]
    counted = np.ones(data.samples, dtype=bool) if data.scored is None else data.scored
    missing = int(np.count_nonzero(np.isnan(values[counted])))
    if missing == np.count_nonzero(counted) or not np.any(values[counted] > 0):
        message = f"no sample of dataset {data.name} has a weight {name} above 0"
        return [Finding(place, message, "Is it the right channel?", severity="warning")]
    if missing:
        of = np.count_nonzero(counted)
        message = f"{name} is NaN in {missing} of {of} samples of dataset {data.name}; these samples get weight 0"
        return [Finding(place, message, severity="warning")]
    return []


def _region(region: Region, datasets: Sequence[Dataset], place: str, offered: Sequence[str]) -> list[Finding]:
    try:
        graph = expression(region.where, place)
    except InputError as error:
        return list(error.findings)
    findings = []
    for data in datasets:
        for name in (name for name in graph.inputs if name not in data):
            remedy = nearest(name, [*data, *offered]) or f"It has {join_names(data)}."
            findings.append(Finding(place, f"dataset {data.name} has no channel {name}", remedy))
        if uses_clock(graph) and data.time is None:
            message = f"the condition requires time stamps, but dataset {data.name} has none"
            findings.append(Finding(place, message, "Name the time channel `time`."))
    if not findings and datasets and not any(_holds(region, data).any() for data in datasets):
        findings.append(Finding(place, f"{region.where} is true at no training sample", severity="warning"))
    return findings
