"""The error at one sample: its nodes, before and after, and the change of each table that would take it away."""

from collections.abc import Sequence

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.session.evidence import Correction, Obstacle, corrections
from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.session import Session
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.traversal import named_lookups

MAX_WORST = 8
APART = 200  # parts of a dataset; two of the worst samples are not in the same one


@dataclass(frozen=True)
class AskedSplit:
    """The sample of a dataset nearest to a position, moved on by `step` samples, and a criterion."""

    dataset: int
    position: float
    criterion: int = 0
    step: int = 0


@dataclass(frozen=True)
class ValueChange:
    """A value at the start and at the present values."""

    start: float | None
    now: float | None


@dataclass(frozen=True)
class NodeValue:
    """A node with its value at the start and at the present values."""

    name: str
    unit: str
    start: float | None
    now: float | None


@dataclass(frozen=True)
class InputValue:
    """An input with its channel and value."""

    name: str
    channel: str
    unit: str
    value: float | None


@dataclass(frozen=True)
class CorrectionRow:
    """The change of a table that alone would take an error away, to first order.

    Attributes:
        nodes: that look the table up.
        slope: of the error by all values of the table.
        allowed: the part of the change within the bounds.
        obstacle: why the change is not possible.
        share: of the span of the table.
        value: what the lookup returns.
        cell: number of the value with the largest weight.
    """

    parameter: str
    unit: str
    slope: float | None
    change: float | None
    allowed: float | None
    obstacle: Obstacle
    share: float | None
    value: float | None
    cell: int
    nodes: Sequence[str]
    free: bool


@dataclass(frozen=True)
class SplitError:
    """The error of a criterion at a sample, and what makes it up."""

    dataset: int
    criterion: int
    sample: int
    position: float
    node: str
    unit: str
    measured: float | None
    difference: ValueChange
    nodes: Sequence[NodeValue]
    inputs: Sequence[InputValue]
    corrections: Sequence[CorrectionRow]


@dataclass(frozen=True)
class AskedWorst:
    """A dataset and a criterion, and how many samples are wanted."""

    dataset: int
    criterion: int = 0
    count: int = MAX_WORST


@dataclass(frozen=True)
class WorstRow:
    """A sample with a large error; `start` is the one at the start."""

    sample: int
    position: float
    inputs: Sequence[float | None]
    measured: float | None
    error: float | None
    start: float | None


@dataclass(frozen=True)
class WorstSamples:
    """Samples with the largest errors, the worst first, and the error of all samples of that use."""

    samples: Sequence[WorstRow]
    rmse: float | None


def split(session: Session, asked: AskedSplit) -> SplitError:
    """Return the error of a criterion at a sample of a dataset, and what makes it up.

    Each node and input with its value, at the start and at the present values; for each table the change that alone
    would take the error away, to first order.
    """
    view, number = session.require_view(), asked.criterion
    recording = view.model.recordings[asked.dataset]
    later = nearest(recording, asked.position) + asked.step
    sample = min(max(later, 0), recording.count - 1)
    error, before = (float(each.errors[recording.number][number][sample]) for each in (view.now, view.start))
    graph, criterion = view.model.problem.model.graph, view.model.problem.criteria[number]
    names = list(graph.names)
    now = view.model.nodes_at(recording, names, sample, view.now.parameters)
    start = now if view.now is view.start else view.model.nodes_at(recording, names, sample, view.start.parameters)
    value = float(now[names.index(criterion.node)])
    return SplitError(
        dataset=recording.number,
        criterion=number,
        sample=sample,
        position=float(recording.position[sample]),
        node=criterion.node,
        unit=view.model.unit(number),
        measured=finite(value - error),
        difference=ValueChange(finite(before), finite(error)),
        nodes=[
            NodeValue(name, graph.units.get(name, ""), finite(a), finite(b))
            for name, a, b in zip(names, start.tolist(), now.tolist(), strict=True)
        ],
        inputs=_inputs(view, recording, sample),
        corrections=_corrections(view, recording, sample, number, error),
    )


def nearest(recording: LiveDataset, position: float) -> int:
    """Return the sample of a dataset that is nearest to a position."""
    places = recording.position
    following = min(int(np.searchsorted(places, position)), places.size - 1)
    closer_before = following > 0 and position - places[following - 1] < places[following] - position
    return following - 1 if closer_before else following


def _inputs(view: View, recording: LiveDataset, sample: int) -> list[InputValue]:
    problem, bound = view.model.problem, recording.bound
    at = int(bound.kept[recording.last_simulated(sample)])
    mapped = {name: problem.channels.get(name, name) for name in problem.model.graph.inputs}
    return [
        InputValue(name, channel, bound.dataset[channel].unit, finite(float(bound.inputs[name][at])))
        for name, channel in mapped.items()
        if channel in bound.dataset
    ]


def _corrections(view: View, recording: LiveDataset, sample: int, criterion: int, error: float) -> list[CorrectionRow]:
    """Return the correction of each table, in the order of the function."""
    parameters, problem = view.now.parameters, view.model.problem
    slopes = view.model.slopes_at(recording, sample, parameters)
    own = {name: slope[criterion] for name, slope in slopes.items()}
    nodes = named_lookups(problem.model.graph)
    return [
        _row(
            each,
            parameters[each.parameter],
            own[each.parameter],
            nodes.get(each.parameter, ()),
            free=each.parameter in problem.free_names,
        )
        for each in corrections(error, own, parameters)
    ]


def _row(each: Correction, table: Parameter, slope: Float, nodes: Sequence[str], *, free: bool) -> CorrectionRow:
    span = float(np.ptp(table.values))
    return CorrectionRow(
        parameter=each.parameter,
        unit=table.unit,
        slope=finite(each.slope),
        change=finite(each.change),
        allowed=finite(each.allowed),
        obstacle=each.obstacle,
        share=finite(abs(each.change) / span) if span else None,
        value=finite(float(np.average(table.values, weights=np.abs(slope)))) if each.slope else None,
        cell=int(np.argmax(np.abs(slope))),
        nodes=nodes,
        free=free,
    )


def worst(session: Session, asked: AskedWorst) -> WorstSamples:
    """Return the samples of a dataset with the largest errors of a criterion, far apart from each other."""
    view, number = session.require_view(), asked.criterion
    recording = view.model.recordings[asked.dataset]
    error, start = (each.errors[recording.number][number] for each in (view.now, view.start))
    output = view.now.outputs[recording.number][number]
    samples = worst_samples(error, asked.count)
    rows = [
        WorstRow(
            sample=sample,
            position=float(recording.position[sample]),
            inputs=[each.value for each in _inputs(view, recording, sample)],
            measured=finite(float(output[sample] - error[sample])),  # targets may be nodes
            error=finite(float(error[sample])),
            start=finite(float(start[sample])),
        )
        for sample in samples
    ]
    scores = [each.rmse for each in view.now.scores if each.criterion == number and each.use == recording.use]
    return WorstSamples(rows, finite(scores[0]) if scores else None)


def worst_samples(error: Float, count: int) -> list[int]:
    """Return the samples with the largest absolute errors, one for each of `APART` parts of the data at most.

    >>> worst_samples(np.array([1.0, -3.0, np.nan, 2.0]), 2)
    [1, 3]
    """
    size = np.nan_to_num(np.abs(error), nan=-1.0)
    length = -(-size.size // APART) or 1
    parts = np.pad(size, (0, -size.size % length), constant_values=-1.0).reshape(-1, length)
    peaks = parts.argmax(axis=1) + length * np.arange(len(parts))
    order = peaks[np.argsort(-size[peaks], kind="stable")][:count]
    return [int(sample) for sample in order if size[sample] >= 0]
