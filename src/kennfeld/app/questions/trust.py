"""What the data of the last run cannot determine, with remedies that the page applies."""

from typing import Any

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.session.session import Run, Session
from kennfeld.optimize.trust.remedies import Remedy
from kennfeld.project.remedies import KeyChanges, key_changes


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
            ],
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
    settings = session.settings
    changes = (key_changes(each, run.problem, settings, run.result.smoothness) for each in remedies)
    return [each for each in changes if each is not None]


def _as_json(change: KeyChanges) -> dict[str, Any]:
    return {**vars(change), "changes": [[list(path), value] for path, value in change.changes]}
