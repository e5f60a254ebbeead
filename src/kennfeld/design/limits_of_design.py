"""The region of a design from `[design]`, the data and the axes of the function."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Findings, Location
from kennfeld.base.formatting import join_names
from kennfeld.design.region import BenchRegion, BoundaryCurve, DataEnvelope, RegionCondition, contradictions
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph import Graph
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.calculated import parse_expression
from kennfeld.project.design_table import DesignEntry

MOST_HULL_POINTS = 20_000  # samples of which an envelope is made


def region_of(
    entry: DesignEntry, location: Location, data: Mapping[str, Float] | None = None, inputs: Sequence[str] = ()
) -> BenchRegion:
    """Return the region of a design.

    Args:
        entry: ranges and limits.
        location: of `[design]`.
        data: channels of measured points, Float[points]; None if there are none.
        inputs: the channels that the function reads, in the order of a point; by default those with a range.

    Raises:
        InputError: a channel has no range, a formula cannot be read, or ends contradict each other.
    """
    findings = Findings(contradictions(entry.ranges, location))
    ranges: dict[str, tuple[float, float]] = {}
    for name in dict.fromkeys([*inputs, *entry.ranges]):
        if name in entry.ranges:
            ranges[name] = entry.ranges[name]
        elif data is not None and name in data and np.isfinite(data[name]).any():
            ranges[name] = float(np.nanmin(data[name])), float(np.nanmax(data[name]))
        else:
            remedy = f"Write ranges = {{ {name} = [lower, upper] }} in [design]."
            findings.error(location.within("ranges"), f"{name} has no range and no data", remedy)
    if not ranges and not findings.has_errors:
        remedy = "Write ranges = { speed = [800, 6000] } in [design]."
        findings.error(location.within("ranges"), "no channel has a range", remedy)
    limits: list[RegionCondition | BoundaryCurve | DataEnvelope] = []
    for key, texts in (("where", entry.where), ("forbidden", entry.forbidden)):
        for text in texts:
            graph, errors = parse_expression(text, location.within(key))
            findings.add(*errors)
            if graph is not None and _knows(graph.inputs, ranges, location.within(key), findings):
                limits.append(RegionCondition(text, graph, key == "forbidden"))
    for curve in entry.curves:
        if _knows((curve.channel, curve.over), ranges, location.within("curves"), findings):
            at, values = np.array(curve.at), np.array(curve.limits)
            limits.append(BoundaryCurve(curve.channel, curve.over, at, values, curve.side == "min"))
    for key, channels in (("slew", list(entry.slew)), ("hard", list(entry.hard))):
        _knows(channels, ranges, location.within(key), findings)
    if data is not None and (not entry.ranges if entry.envelope is None else entry.envelope):
        limits.append(_envelope(data, list(ranges)))
    findings.finish()
    return BenchRegion(ranges, limits)


def _knows(names: Sequence[str], ranges: Mapping[str, object], location: Location, findings: Findings) -> bool:
    unknown = [name for name in names if name not in ranges]
    if unknown:
        remedy = f"The channels of a point are {join_names(list(ranges))}; write a range for others."
        findings.error(location, f"unknown channel {join_names(unknown)}", remedy)
    return not unknown


def _envelope(data: Mapping[str, Float], names: Sequence[str]) -> DataEnvelope:
    columns = {name: data[name] for name in names if name in data}
    count = len(next(iter(columns.values())))
    # the extreme samples of each channel, and others evenly between
    picked = np.unique(
        np.concatenate(
            [
                np.linspace(0, count - 1, min(count, MOST_HULL_POINTS)).astype(np.int64),
                *([int(np.nanargmin(v)), int(np.nanargmax(v))] for v in columns.values()),
            ]
        ).astype(np.int64)
    )
    return DataEnvelope({name: values[picked] for name, values in columns.items()})


def measured_inputs(datasets: Sequence[Dataset], channels: Sequence[str]) -> dict[str, Float] | None:
    """Return channels over the samples of all datasets that have all of them; None if there are none."""
    own = [data for data in datasets if all(name in data for name in channels) and data.samples]
    if not own or not channels:
        return None
    stacked = {name: np.concatenate([data[name].values for data in own]) for name in channels}
    known = np.isfinite(np.column_stack(list(stacked.values()))).all(axis=1)
    return {name: values[known] for name, values in stacked.items()} if known.any() else None


def beyond_axes(problem: Problem, columns: Mapping[str, Float], slack: float = 0.0) -> Bool:
    """Mark the points at which an input lies beyond the axes of a table, given channels, Float[points].

    `slack` is the share of an axis by which it may do so.
    """
    beyond = np.zeros(len(next(iter(columns.values()))), dtype=bool)
    for name, (low, high) in axis_ranges(problem.model.graph, problem.parameters).items():
        values = columns[problem.channels.get(name, name)]
        margin = slack * (high - low)
        beyond |= (values < low - margin) | (values > high + margin)
    return beyond


def axis_ranges(graph: Graph, parameters: ParameterSet) -> dict[str, tuple[float, float]]:
    """Return for inputs that are looked up in tables the narrowest range of their axes."""
    ranges: dict[str, tuple[float, float]] = {}
    for node in graph.nodes:
        if node.op != "lookup" or node.payload not in parameters or parameters[node.payload].kind == "rbf":
            continue
        for at, axis in zip(node.args, parameters[node.payload].index_axes, strict=False):
            if graph.nodes[at].op == "input":
                name, points = graph.nodes[at].payload, axis.breakpoints
                low, high = ranges.get(name, (-np.inf, np.inf))
                ranges[name] = max(low, float(points[0])), min(high, float(points[-1]))
    return ranges
