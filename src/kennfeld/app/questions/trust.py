"""Values that the data of the last run cannot determine, with remedies that the page applies."""

from typing import Any

import numpy as np

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.session.runs import Run
from kennfeld.app.session.session import Session
from kennfeld.base.arrays import Float
from kennfeld.optimize.trust.remedies import Remedy
from kennfeld.optimize.trust.trust import Trust
from kennfeld.project.remedies import KeyChanges, key_changes

MAX_PINNED = 2500  # values whose covariance is computed


def trust(session: Session, given: Given) -> Answer:
    """Return what the data of the last run cannot determine; remedies are changes of keys of the project file."""
    if not session.runs:
        return Answer({"directions": [], "remedies": []})
    last: Run = session.runs[-1]
    known = last.result.trust
    return Answer(
        {
            "directions": [
                {
                    "sentence": direction.sentence,
                    "remedy": direction.remedy,
                    "remedies": [_as_json(each) for each in _applicable(session, last, direction.remedies)],
                    "exact": direction.exact,
                    "deviation": finite(direction.deviation),
                    "parameters": list(direction.parts),
                }
                for direction in known.directions
                if not direction.determined
            ],
            "coupled": [direction.sentence for direction in known.directions if direction.determined],
            "sentence": known.null_space.sentence,
            "advice": known.null_space.advice,
            "dimension": known.null_space.dimension,
            "remedies": [_as_json(each) for each in _applicable(session, last, (known.null_space.remedy,))],
            "holdings": [str(limit) for limit in known.holdings],
            "noise": [{"criterion": name, "value": finite(value)} for name, value in known.noise.items()],
            "remark": known.remark,
            "freedom": finite(known.freedom),
            "values": last.result.free_values,
        }
    )


def _applicable(session: Session, run: Run, remedies: tuple[Remedy, ...]) -> list[KeyChanges]:
    problem, settings = run.problem or session.require_view().model.problem, session.settings
    changes = (key_changes(each, problem, settings, run.result.smoothness) for each in remedies)
    return [each for each in changes if each is not None]


def _as_json(change: KeyChanges) -> dict[str, Any]:
    return {**vars(change), "changes": [[list(path), value] for path, value in change.changes]}


def pinned(session: Session, given: Given) -> Answer:
    """Return the median standard deviation of each table, and what it would be with the grid point `at` pinned.

    `parameter` and `at` are those of a pin at a grid point. There are no rows if nothing determines the value, or if
    the last run has too many values.
    """
    name, at = str(given["parameter"]), tuple(float(place) for place in given["at"])
    trust = session.runs[-1].result.trust if session.runs else Trust()
    sizes = {each: np.size(values) for each, values in trust.deviation.items()}
    if name not in sizes or sum(sizes.values()) > MAX_PINNED:
        return Answer({"rows": []})
    own = session.runs[-1].result.parameters
    table = own[name]
    index = tuple(int(np.abs(a.breakpoints - place).argmin()) for a, place in zip(table.index_axes, at, strict=True))
    after = pinned_deviation(trust, name, index)
    rows = [
        {"name": each, "unit": own[each].unit, "before": _median(trust.deviation[each]), "after": _median(after[each])}
        for each in after
        if each in own
    ]
    return Answer({"rows": rows})


def pinned_deviation(trust: Trust, name: str, index: tuple[int, ...]) -> dict[str, Float]:
    """Return the standard deviation of all values if one of them were known: C - C[:, k] C[k, :] / C[k, k].

    Empty if nothing determines the value.
    """
    covariance = trust.covariance()
    shapes = {each: np.shape(values) for each, values in trust.deviation.items()}
    ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())])
    first = dict(zip(shapes, ends.tolist(), strict=False))
    k = first[name] + int(np.ravel_multi_index(index, shapes[name])) if shapes[name] else first[name]
    if not (np.isfinite(covariance[k, k]) and covariance[k, k] > 0):
        return {}
    variance = np.diag(covariance) - np.nan_to_num(covariance[:, k]) ** 2 / covariance[k, k]
    deviation = np.sqrt(np.maximum(variance, 0.0))
    return {each: deviation[at : at + int(np.prod(shapes[each]))].reshape(shapes[each]) for each, at in first.items()}


def _median(values: Float) -> float | None:
    known = values[np.isfinite(values) & (values > 0)]
    return float(np.median(known)) if known.size else None
