"""Sample weights: from a channel, and from regions of the data.

The weight of a sample multiplies its loss, so that a robust loss still sees the unweighted residual. Samples of weight
0 are not evaluated at all: the model may be undefined there.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.criteria import Criterion, Region
from kennfeld.domain.dataset import Dataset
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.models.formula import expression
from kennfeld.preprocessing.binding import BoundDataset
from kennfeld.preprocessing.calculated import holds


def sample_weights(criterion: Criterion, dataset: Dataset) -> Float | None:
    """Multiply all weights of each sample, Float[samples]; None if there are none. NaN counts as 0.

    Weights whose channels a dataset does not have are 1: test data need not have them.
    """
    channels = [name for name in (dataset.weight_channel, criterion.weight_channel) if name and name in dataset]
    factors = [np.nan_to_num(dataset[name].values, nan=0.0) for name in channels]
    for region in criterion.regions:
        condition = expression(region.where, Location("where"))
        if all(name in dataset for name in condition.inputs) and (dataset.time is not None or not condition.clocks):
            factors.append(np.where(holds(condition, dataset), region.weight, 1.0))
    return np.asarray(np.prod(factors, axis=0)) if factors else None


def has_weight(criterion: Criterion, bound: BoundDataset) -> Bool:
    """Mark the kept samples with a weight above 0, Bool[kept samples]; samples of weight 0 count as no data."""
    weights = None if criterion.internal else sample_weights(criterion, bound.dataset)
    return np.ones(bound.count, dtype=bool) if weights is None else weights[bound.kept] > 0


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
        # names that no formula text can have
        return cls(criteria, {i: f"\0weight {i}" for i in weighted})

    def extend(self, graph: Graph) -> Graph:
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
    criterion_location: Callable[[int], Location],
    dataset_location: Callable[[Dataset], Location],
    offered: Sequence[str] = (),
) -> list[Finding]:
    """Report problems of sample weights in the training data; `offered` are further channels of the files."""
    findings: list[Finding] = []
    for data in datasets:
        if data.weight_channel:
            location = dataset_location(data).within("weight_channel")
            findings += _channel_findings(data.weight_channel, data, location, offered)
    for i, criterion in enumerate(criteria):
        # a dataset without the target channel is not compared, so that it needs no weights either
        scored = [data for data in datasets if criterion.target.kind != "channel" or criterion.target.name in data]
        for data in scored if criterion.weight_channel else ():
            location = criterion_location(i).within("weight_channel")
            findings += _channel_findings(criterion.weight_channel, data, location, offered)
        for number, region in enumerate(criterion.regions, 1):
            findings += _region_findings(region, scored, criterion_location(i).within(f"region {number}"), offered)
    if any(finding.severity == "error" for finding in findings):
        return findings
    for i, criterion in enumerate(criteria):
        if datasets and not any(_has_weight(criterion, data) for data in datasets):
            message = "no training sample has a weight above 0"
            findings.append(Finding(criterion_location(i), message, "Check its weight channels and regions."))
    return findings


def _has_weight(criterion: Criterion, data: Dataset) -> bool:
    weights = sample_weights(criterion, data)
    return weights is None or bool(np.any(weights[data.counting] > 0))


def _channel_findings(name: str, data: Dataset, location: Location, offered: Sequence[str]) -> Iterator[Finding]:
    if name not in data:
        yield _missing_channel(name, data, location, offered)
        return
    values = data[name].values
    wrong = np.flatnonzero((values < 0) | np.isinf(values))
    if wrong.size:
        message = f"{wrong.size} weights of {name} in dataset {data.name} are below 0 or infinite"
        first = f"the first, {values[wrong[0]]:g}, at sample {wrong[0] + 1}"
        yield Finding(location, f"{message}, {first}", "Correct them.")
        return
    scored = values[data.counting]
    missing = int(np.count_nonzero(np.isnan(scored)))
    if not np.any(scored > 0):
        message = f"no sample of dataset {data.name} has a weight {name} above 0"
        yield Finding(location, message, "Is it the right channel?", severity="warning")
    elif missing:
        share = f"{missing} of {scored.size} samples of dataset {data.name}"
        numbers = "NaN or infinite" if data.had_infinite(name) else "NaN"
        yield Finding(location, f"{name} is {numbers} in {share}; these samples get weight 0", severity="warning")


def _missing_channel(name: str, data: Dataset, location: Location, offered: Sequence[str]) -> Finding:
    remedy = nearest(name, [*data, *offered]) or f"It has {join_names(data)}."
    return Finding(location, f"dataset {data.name} has no channel {name}", remedy)


def _region_findings(
    region: Region, datasets: Sequence[Dataset], location: Location, offered: Sequence[str]
) -> list[Finding]:
    try:
        graph = expression(region.where, location)
    except InputError as error:
        return list(error.findings)
    findings = []
    for data in datasets:
        findings += [_missing_channel(name, data, location, offered) for name in graph.inputs if name not in data]
        if graph.clocks and data.time is None:
            message = f"the condition requires time stamps, but dataset {data.name} has none"
            findings.append(Finding(location, message, "Name the time channel `time`."))
    if not findings and datasets and not any(holds(graph, data).any() for data in datasets):
        findings.append(Finding(location, f"{region.where} is true at no training sample", severity="warning"))
    return findings
