"""Linked evidence between grid points, samples and nodes."""

import numpy as np

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.session.distributions import thin
from kennfeld.app.session.evidence import Informing
from kennfeld.app.session.selection import both, check_clock, condition, outside, read_selection, stretch_in_other_data
from kennfeld.app.session.session import Session
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError

MAX_STRETCHES = 100  # of one dataset, the longest ones
MAX_POINTS = 2500


def informing(session: Session, given: Given) -> Answer:
    """Return what the value `cell` of the parameter `name` rests on: its samples, their errors, and where they are.

    The errors are those of a `criterion`.

    Arrays: `x`, `y` and `weight` of lookups near the grid point of the dataset with most of its samples; `samples` of
    that dataset that inform it.
    """
    view, name, cell = session.require_view(), given["name"], int(given["cell"])
    parts = view.evidence.informing(name, cell)
    criterion = int(given.get("criterion", 0))
    rows = [_informing(view, part, criterion) for part in parts if part.samples.size]
    if not rows:
        return Answer({"datasets": []})
    most = max(parts, key=lambda part: part.samples.size)
    near = view.evidence.surroundings(view.model.recordings[most.dataset], name, cell)
    drawn = thin(near.samples.size, near.weights, MAX_POINTS)
    coordinates = [*near.coordinates[:2, drawn], *([np.zeros(0)] * 2)][:2]
    arrays = {"x": coordinates[0], "y": coordinates[1], "weight": near.weights[drawn]}
    return Answer({"datasets": rows, "most": most.dataset}, arrays)


def _informing(view: View, part: Informing, criterion: int) -> dict[str, object]:
    recording, stretches = view.model.recordings[part.dataset], part.stretches
    position = recording.position
    longest = sorted(stretches, key=lambda ends: ends[0] - ends[1])[:MAX_STRETCHES]
    now, start = (each.errors[part.dataset][criterion][part.samples] for each in (view.now, view.start))
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
    """Return by table the weight of each value in the samples of a `dataset` that `brush` selects.

    Without a brush, the samples from `begin` to `end`.
    """
    view = session.require_view()
    recording = view.model.recordings[int(given["dataset"])]
    selection = read_selection(given.get("brush") or {key: given[key] for key in ("begin", "end")})
    assert selection is not None
    chosen = view.signals.selected(recording, selection)
    weights = view.evidence.passed(recording, chosen)
    return Answer({"samples": int(chosen.sum())}, {name: weight.ravel() for name, weight in weights.items()})


def conditions(session: Session, given: Given) -> Answer:
    """Return how the project file would say what `brush` selects of a `dataset`.

    `where` keeps only these samples and `outside` leaves them out, each in addition to the condition that the dataset
    has now; `region` is for the weights of a criterion. What cannot be said is empty; `reason` and `regionReason` say
    why.
    """
    problem = session.require_view().model.problem
    number = int(given["dataset"])
    recording = session.require_view().model.recordings[number]
    selection = read_selection(given["brush"])
    assert selection is not None
    try:
        text = condition(selection, recording, problem)
        inside, beyond = (both(_where(session, number), part) for part in (text, outside(text)))
        check_clock(inside, recording)
    except ArgumentError as error:
        return Answer({"where": "", "outside": "", "region": "", "reason": str(error), "regionReason": str(error)})
    reason = stretch_in_other_data(selection, problem)
    region = "" if reason else text
    return Answer({"where": inside, "outside": beyond, "region": region, "reason": "", "regionReason": reason})


def _where(session: Session, number: int) -> str:
    """Return the condition of a dataset in the project file."""
    entry = session.settings["dataset"][number]
    return str(entry.get("where", ""))


def coverage(session: Session, given: Given) -> Answer:
    """Return the evidence for all values of the parameter `name` at once; only training data count.

    Arrays: `error`, the mean error of a `criterion` over the samples that inform each value; `x` and `y`, where samples
    look the table up.
    """
    view, name, criterion = session.require_view(), given["name"], int(given.get("criterion", 0))
    if name not in view.evidence.tables:
        return Answer()
    mean = view.evidence.mean_errors(name, [errors[criterion] for errors in view.now.errors])
    places = view.evidence.places(name, MAX_POINTS)
    return Answer({}, {"error": mean.ravel(), **dict(zip(("x", "y"), places, strict=False))})
