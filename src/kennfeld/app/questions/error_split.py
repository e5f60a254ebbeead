"""The error at one sample: its nodes, before and after, and the change of each table that would take it away."""

from typing import Any

import numpy as np

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.session.evidence import Correction, corrections
from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.session import Session
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.traversal import named_lookups

MAX_WORST = 8
APART = 200  # parts of a dataset; two of the worst samples are not in the same one


def split(session: Session, given: Given) -> Answer:
    """Return the error of a `criterion` at the sample of a `dataset` at `position`, and what makes it up.

    Each node and input with its value, at the start and at the present values; for each table the change that alone
    would take the error away, to first order. `step` samples later, if it is given.
    """
    view, number = session.require_view(), int(given.get("criterion", 0))
    recording = view.model.recordings[int(given["dataset"])]
    later = nearest(recording, float(given["position"])) + int(given.get("step", 0))
    sample = min(max(later, 0), recording.count - 1)
    error, before = (float(each.errors[recording.number][number][sample]) for each in (view.now, view.start))
    graph, criterion = view.model.problem.model.graph, view.model.problem.criteria[number]
    names = list(graph.names)
    now = view.model.nodes_at(recording, names, sample, view.now.parameters)
    start = now if view.now is view.start else view.model.nodes_at(recording, names, sample, view.start.parameters)
    value = float(now[names.index(criterion.node)])
    return Answer(
        {
            "dataset": recording.number,
            "criterion": number,
            "sample": sample,
            "position": float(recording.position[sample]),
            "node": criterion.node,
            "unit": view.model.unit(number),
            "measured": finite(value - error),
            "difference": {"start": finite(before), "now": finite(error)},
            "nodes": [
                {"name": name, "unit": graph.units.get(name, ""), "start": finite(a), "now": finite(b)}
                for name, a, b in zip(names, start.tolist(), now.tolist(), strict=True)
            ],
            "inputs": _inputs(view, recording, sample),
            "corrections": _corrections(view, recording, sample, number, error),
        }
    )


def nearest(recording: LiveDataset, position: float) -> int:
    """Return the sample of a dataset that is nearest to a position."""
    places = recording.position
    following = min(int(np.searchsorted(places, position)), places.size - 1)
    closer_before = following > 0 and position - places[following - 1] < places[following] - position
    return following - 1 if closer_before else following


def _inputs(view: View, recording: LiveDataset, sample: int) -> list[dict[str, Any]]:
    problem, bound = view.model.problem, recording.bound
    at = int(bound.kept[recording.last_simulated(sample)])
    mapped = {name: problem.channels.get(name, name) for name in problem.model.graph.inputs}
    return [
        {
            "name": name,
            "channel": channel,
            "unit": bound.dataset[channel].unit,
            "value": finite(float(bound.inputs[name][at])),
        }
        for name, channel in mapped.items()
        if channel in bound.dataset
    ]


def _corrections(
    view: View, recording: LiveDataset, sample: int, criterion: int, error: float
) -> list[dict[str, object]]:
    """Return the correction of each table, in the order of the function."""
    parameters, problem = view.now.parameters, view.model.problem
    slopes = view.model.slopes_at(recording, sample, parameters)
    own = {name: slope[criterion] for name, slope in slopes.items()}
    nodes = named_lookups(problem.model.graph)
    return [
        _row(each, parameters[each.parameter], own[each.parameter])
        | {"nodes": list(nodes.get(each.parameter, ())), "free": each.parameter in problem.free_names}
        for each in corrections(error, own, parameters)
    ]


def _row(each: Correction, table: Parameter, slope: Float) -> dict[str, object]:
    span = float(np.ptp(table.values))
    return {
        "parameter": each.parameter,
        "unit": table.unit,
        "slope": finite(each.slope),
        "change": finite(each.change),
        "allowed": finite(each.allowed),
        "obstacle": each.obstacle,
        "share": finite(abs(each.change) / span) if span else None,
        "value": finite(float(np.average(table.values, weights=np.abs(slope)))) if each.slope else None,
        "cell": int(np.argmax(np.abs(slope))),
    }


def worst(session: Session, given: Given) -> Answer:
    """Return the samples of a `dataset` with the largest errors of a `criterion`, far apart from each other."""
    view, number = session.require_view(), int(given.get("criterion", 0))
    recording = view.model.recordings[int(given["dataset"])]
    error, start = (each.errors[recording.number][number] for each in (view.now, view.start))
    output = view.now.outputs[recording.number][number]
    samples = worst_samples(error, int(given.get("count", MAX_WORST)))
    rows = [
        {
            "sample": sample,
            "position": float(recording.position[sample]),
            "inputs": [each["value"] for each in _inputs(view, recording, sample)],
            "measured": finite(float(output[sample] - error[sample])),  # targets may be nodes
            "error": finite(float(error[sample])),
            "start": finite(float(start[sample])),
        }
        for sample in samples
    ]
    scores = [each.rmse for each in view.now.scores if each.criterion == number and each.use == recording.use]
    return Answer({"samples": rows, "rmse": finite(scores[0]) if scores else None})


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
