"""Summary of a project for the start page: its errors, its state, and a picture of its first dataset."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.app.session.distributions import common_bins, histogram
from kennfeld.app.session.session import Session
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass

BINS = 24
POINTS = 400  # of the picture


def summarise_session(session: Session) -> dict[str, Any]:
    """Return the summary of an open project."""
    problems = [finding for finding in session.findings if finding.severity == "error"]
    state = session.runs[-1].result.status if session.runs else "ready"
    summary: dict[str, Any] = {
        "state": count_noun(len(problems), "problem") if problems else state,
        "problem": str(problems[0]) if problems else "",
        "file": session.formula_file,
    }
    view = session.view
    if view is None or not view.model.recordings or not view.now.scores:
        return summary
    return summary | _errors(view) | _facts(session, view) | {"picture": vars(_picture(view))}


def _errors(view: View) -> dict[str, Any]:
    scores = {score.use: score for score in reversed(view.now.scores) if score.samples}  # of the first criterion
    errors = [each[0] for each, use in zip(view.now.errors, view.now.uses, strict=True) if use == "training"]
    edges = common_bins(errors, BINS)
    return {
        "node": view.model.problem.criteria[0].node,
        "unit": view.model.unit(0),
        **{use: float(score.rmse) for use, score in scores.items() if np.isfinite(score.rmse)},
        "histogram": histogram(np.concatenate(errors), edges).tolist() if errors else [],
    }


def _facts(session: Session, view: View) -> dict[str, Any]:
    problem, runs = view.model.problem, session.runs
    without = sum(int(np.count_nonzero(samples == 0)) for samples in view.samples.values())
    return {
        "nodes": len(problem.model.graph.names),
        "datasets": [[each.name, each.use, each.count] for each in view.model.recordings[:6]],
        "parameters": len(problem.free_names),
        "values": problem.free_size,
        "run": f"run {runs[-1].number}, {runs[-1].elapsed:.2f} s" if runs else "",
        "withoutData": without,
    }


@dataclass(frozen=True)
class PictureLines:
    """Measured, present and initial values of the first criterion over the first dataset, thinned out."""

    dataset: str
    timed: bool
    x: Sequence[float | None]
    measured: Sequence[float | None]
    now: Sequence[float | None]
    start: Sequence[float | None]


def _picture(view: View) -> PictureLines:
    recording = view.model.recordings[0]
    chosen = np.unique(np.linspace(0, recording.count - 1, min(POINTS, recording.count)).astype(np.int64))
    measured = view.now.measured(0, 0)[chosen]
    now, start = ((each.measured(0, 0) + each.errors[0][0])[chosen] for each in (view.now, view.start))
    position = recording.position[chosen]
    return PictureLines(recording.name, recording.timed, *map(_plain, (position, measured, now, start)))


def _plain(values: Float) -> list[float | None]:
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values.tolist()]
