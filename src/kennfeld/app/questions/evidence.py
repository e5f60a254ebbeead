"""Linked evidence between grid points, samples and nodes."""

import numpy as np

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.session.distributions import thin
from kennfeld.app.session.evidence import Informing
from kennfeld.app.session.session import Session, View
from kennfeld.arrays import Float

MAX_STRETCHES = 100  # of one dataset, the longest ones
MAX_POINTS = 2500


def informing(session: Session, given: Given) -> Answer:
    """Return what the value `cell` of the parameter `name` rests on: its samples, their errors, and where they are.

    Arrays: `x`, `y` and `weight` of lookups near the grid point of the dataset with most of its samples; `samples` of
    that dataset that inform it.
    """
    view, name, cell = session.require_view(), given["name"], int(given["cell"])
    parts = view.evidence.informing(name, cell)
    rows = [_informing(view, part) for part in parts if part.samples.size]
    if not rows:
        return Answer({"datasets": []})
    most = max(parts, key=lambda part: part.samples.size)
    near = view.evidence.surroundings(view.model.recordings[most.dataset], name, cell)
    drawn = thin(near.samples.size, near.weights, MAX_POINTS)
    coordinates = [*near.coordinates[:2, drawn], *([np.zeros(0)] * 2)][:2]
    arrays = {"x": coordinates[0], "y": coordinates[1], "weight": near.weights[drawn]}
    return Answer({"datasets": rows, "most": most.dataset}, arrays)


def _informing(view: View, part: Informing) -> dict[str, object]:
    recording, stretches = view.model.recordings[part.dataset], part.stretches
    position = recording.position
    longest = sorted(stretches, key=lambda ends: ends[0] - ends[1])[:MAX_STRETCHES]
    now, start = (each.errors[part.dataset][0][part.samples] for each in (view.now, view.start))
    return {
        "number": part.dataset,
        "dataset": recording.name,
        "samples": int(part.samples.size),
        "count": len(stretches),
        "stretches": [[float(position[first]), float(position[last])] for first, last in longest],
        "meanBefore": finite(_mean(start)),
        "meanNow": finite(_mean(now)),
    }


def _mean(values: Float) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def passed(session: Session, given: Given) -> Answer:
    """Return by table the weight of each value in the samples of a `dataset` from `begin` to `end`."""
    view = session.require_view()
    recording = view.model.recordings[int(given["dataset"])]
    chosen = (recording.position >= float(given["begin"])) & (recording.position <= float(given["end"]))
    weights = view.evidence.passed(recording, chosen)
    return Answer({"samples": int(chosen.sum())}, {name: weight.ravel() for name, weight in weights.items()})
