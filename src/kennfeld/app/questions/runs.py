"""Calibration runs: start and stop, their progress, and what their results say."""

from collections.abc import Mapping, Sequence
from typing import Any, cast, get_args

import numpy as np

from kennfeld.analysis.cross_validation import Kind
from kennfeld.analysis.extrapolation import Extrapolation, find_extrapolation
from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.questions.parameters import describe_axes
from kennfeld.app.questions.pictures import thumbnail
from kennfeld.app.session.edited_values import moved_breakpoints, with_edits
from kennfeld.app.session.live_model import Evaluation
from kennfeld.app.session.run_job import Validation
from kennfeld.app.session.runs import Run
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.fit.result import Result, TraceLine
from kennfeld.optimize.quality.recording_quality import of_several_files, recordings_table

MAX_CHANGES = 400  # grid points of a table that are listed
MAX_RECORDINGS = 500  # rows that are listed


def run(session: Session, given: Given) -> Answer:
    """Start a calibration from the present values.

    `resume` continues an interrupted run from its checkpoints; `workers` is the number of processes for several starts;
    `folds` with the kind `parts` cross-validates instead.
    """
    folds, workers = given.get("folds"), given.get("workers")
    validation = None if folds is None else _validation(int(folds), str(given.get("parts") or "auto"))
    if workers is not None and int(workers) < 1:
        raise ArgumentError(f"the number of processes must be >= 1, got {int(workers)}")
    session.run(resume=bool(given.get("resume")), workers=workers and int(workers), validation=validation)
    return Answer()


def _validation(folds: int, kind: str) -> Validation:
    if folds < 2:
        raise ArgumentError(f"the number of folds must be >= 2, got {folds}")
    if kind not in get_args(Kind):
        raise ArgumentError(f"unknown kind of folds {kind!r}")
    return Validation(folds, cast("Kind", kind))


def stop(session: Session, given: Given) -> Answer:
    """Stop the running calibration and keep its best values."""
    session.stop()
    return Answer()


def progress(session: Session, given: Given) -> Answer:
    """Return the trace of the running or last calibration by start, and the tables of the best step so far."""
    view, job = session.require_view(), session.job
    lines: dict[int, list[TraceLine]] = {}
    for line in job.trace:
        lines.setdefault(line.start, []).append(line)
    arrays = {}
    for number, own in lines.items():
        arrays[f"rmse {number}"] = np.array([line.rmse for line in own])
        arrays[f"cost {number}"] = np.array([line.cost for line in own])
    starts = [_start(session, number, own) for number, own in sorted(lines.items())]
    names = view.model.problem.free_names
    shown = {name: job.preview.get(name, view.now.parameters[name].values) for name in names}
    pictures = [_picture(view, name, values) for name, values in shown.items()]
    steps = _steps(session)
    return Answer({"starts": starts, "tables": pictures, "steps": steps}, arrays)


def _steps(session: Session) -> list[dict[str, Any]]:
    """Return a row for each step of the sequence, with the last accepted step of the search in it."""
    job = session.job
    names = [] if session.project is None else [step.name for step in session.project.options.steps]
    titles = [name or f"step {number}" for number, name in enumerate(names, 1)]
    lines = {title: [line for line in job.trace if line.stage.startswith(f"{title}: ")] for title in titles}
    latest = job.trace[-1].stage.partition(": ")[0] if job.trace else ""
    running = job.state in ("running", "stopping")
    return [
        {
            "name": title,
            "state": "running" if running and title == latest else "done" if lines[title] else "waiting",
            "iterations": len(lines[title]),
            "cost": finite(lines[title][-1].cost) if lines[title] else None,
            "rmse": finite(lines[title][-1].rmse) if lines[title] else None,
        }
        for title in titles
    ]


def outcome(session: Session, given: Given) -> Answer:
    """Return what the command line says at the end of a run, and the last cross-validation.

    `resumable` is a sentence on an interrupted run that can be resumed.
    """
    idle = session.job.state not in ("running", "stopping")
    last = session.runs[-1].result if session.runs else None
    return Answer(
        {
            "resumable": session.resumable if idle else "",
            "result": None if last is None else _outcome(session, last),
            "validation": None if session.validation is None else _folds(session.validation),
        }
    )


def by_file(session: Session, given: Given) -> Answer:
    """Return the errors of the last run by file, the worst first; `several` tells if a dataset has several files."""
    last = session.runs[-1].result if session.runs else None
    recordings = () if last is None else last.recordings
    table = recordings_table(recordings)
    return Answer(
        {
            "run": session.runs[-1].number if session.runs else None,
            "rows": table[: 1 + MAX_RECORDINGS],
            "more": max(len(table) - 1 - MAX_RECORDINGS, 0),
            "several": bool(of_several_files(recordings)),
        }
    )


def _outcome(session: Session, last: Result) -> dict[str, Any]:
    return {
        "run": session.runs[-1].number,
        "status": last.status,
        "message": last.message,
        "quality": last.table(),
        "distances": [[row.start, finite(row.distance)] for row in last.starts],
        "warnings": list(map(str, last.warnings)),
        "shifts": [
            {"dataset": name, "channel": channel, "shift": shift}
            for name, channels in last.shifts.items()
            for channel, shift in channels.items()
        ],
        "smoothness": [{"parameter": name, "factors": dict(axes)} for name, axes in last.smoothness.items()],
        "breakpoints": [
            {"axis": name, "before": old.tolist(), "after": new.tolist()} for name, (old, new) in last.moved.items()
        ],
        "extrapolations": [str(row) for row in _extrapolation(session, session.runs[-1]) if row.worst is not None],
        "free": last.free_values,
        "fixed": last.fixed_values,
        "iterations": last.iterations,
        "evaluations": last.evaluations,
        "seconds": {name: finite(value) for name, value in vars(last.seconds).items()},
        "resumed": list(last.resumed),
    }


def _extrapolation(session: Session, run: Run) -> Sequence[Extrapolation]:
    if run.extrapolation is not None:
        return run.extrapolation
    from kennfeld.optimize.tuning.shift_estimation import apply_shifts

    problem = apply_shifts(run.problem or session.require_view().model.problem, run.result.shifts)
    return find_extrapolation(problem, run.result.parameters)


def _folds(validation: CrossValidation) -> dict[str, Any]:
    return {"table": validation.table(), "summary": [*validation.summary(), *validation.conclusions()]}


def _start(session: Session, number: int, lines: Sequence[TraceLine]) -> dict[str, Any]:
    """Return a row of the table of starts; the end of a start is known from the result only."""
    ended = session.job.state not in ("running", "stopping")
    own = ended and session.runs and session.runs[-1].problem is session.job.problem
    rows = {row.start: row for row in session.runs[-1].result.starts} if own else {}
    row, last = rows.get(number), lines[-1]
    return {
        "start": number,
        "state": row.status if row is not None else session.job.state if ended else "running",
        "stage": last.stage,
        "iterations": len(lines) if row is None else row.iterations,
        "before": finite(lines[0].cost if row is None else row.cost_before),
        "cost": finite(last.cost if row is None else row.cost_after),
        "rmse": finite(last.rmse),
        "seconds": round(last.seconds, 2),
    }


def _picture(view: View, name: str, values: Float) -> dict[str, Any]:
    table = view.start.parameters[name]
    return {
        "name": name,
        "unit": table.unit,
        "ends": [[float(a.breakpoints[0]), float(a.breakpoints[-1])] for a in table.axes],
        "values": thumbnail(np.asarray(values), 24),
        "start": thumbnail(table.values, 24) if len(table.axes) == 1 else [],
    }


def compare(session: Session, given: Given) -> Answer:
    """Return the differences of two sets of values, `first` and `second`: "start", "now" or the number of a run."""
    view = session.require_view()
    first, second = (_evaluate(session, given[key]) for key in ("first", "second"))
    names = view.model.problem.model.graph.parameters
    rows = [_change(first.parameters[name], second.parameters[name]) for name in names]
    return Answer(
        {
            "changes": sorted(rows, key=lambda row: -row["relative"]),
            "scores": [
                {
                    "use": b.use,
                    "unit": view.model.unit(b.criterion),
                    "criterion": view.model.problem.criteria[b.criterion].node,
                    "first": finite(a.rmse),
                    "second": finite(b.rmse),
                    "largest": finite(b.largest),
                }
                for a, b in zip(first.scores, second.scores, strict=True)
                if b.samples
            ],
        }
    )


def _evaluate(session: Session, which: object) -> Evaluation:
    """Return the model with the values of the start, of now, or of a run."""
    view = session.require_view()
    if which == "start":
        return view.start
    return view.now if which == "now" else view.model.evaluate(_values_of_run(session, which))


def _values_of_run(session: Session, number: object, *, moved: bool = True) -> ParameterSet:
    """Return the parameters with the values of a run; without `moved`, interpolated to the initial breakpoints."""
    view = session.require_view()
    wanted = session.runs[int(str(number)) - 1].result.parameters
    tables = {name: wanted[name] for name in view.model.problem.free_names if name in wanted}
    values = {name: table.values for name, table in tables.items()}
    own, _ = with_edits(view.start.parameters, values | (moved_breakpoints(wanted) if moved else {}), tables)
    return own


def _change(a: Parameter, b: Parameter) -> dict[str, Any]:
    difference = b.values - a.values
    size = np.abs(difference)
    scale = max(float(np.abs(a.values).max(initial=0.0)), float(np.abs(b.values).max(initial=0.0))) or 1.0
    order = np.argsort(-size, axis=None)[:MAX_CHANGES]
    order = order[size.ravel()[order] > 0]
    return {
        "name": b.name,
        "kind": b.kind,
        "unit": b.unit,
        "description": b.description,
        "largest": float(size.max(initial=0.0)),
        "mean": float(size.mean()),
        "relative": float(size.max(initial=0.0)) / scale,
        "atBound": int(np.count_nonzero(b.at_bound)),
        "axes": describe_axes(b),
        "first": a.values.ravel().tolist(),
        "second": b.values.ravel().tolist(),
        "biggest": order.tolist(),
        "bound": np.flatnonzero(b.at_bound).tolist(),
    }


def accept(session: Session, given: Given) -> Answer:
    """Take the values of run `run` for the given `cells` by parameter (None: all), and those of the start elsewhere."""
    session.do(SetTables(str(given["title"]), _chosen(session, given)))
    return Answer()


def choice(session: Session, given: Given) -> Answer:
    """Return the errors that `accept` would lead to."""
    view, initial = session.require_view(), session.require_view().start.parameters
    tables = {name: values for name, values in _chosen(session, given).items() if values is not None}
    scores = view.model.evaluate(with_edits(initial, tables, {})[0]).scores
    rows = [{"use": s.use, "criterion": s.criterion, "rmse": finite(s.rmse)} for s in scores if s.samples]
    return Answer({"scores": rows, "unit": view.model.unit(0)})


def _chosen(session: Session, given: Given) -> dict[str, Float | None]:
    """Return the tables with the chosen values; None for tables that keep their start.

    Breakpoints that the run has moved are taken with all its values. Otherwise the tables keep theirs.
    """
    cells: Mapping[str, Sequence[int] | None] = given["cells"]
    names, start = session.require_view().model.problem.free_names, session.require_view().start.parameters
    whole = all(name in cells and cells[name] is None for name in names)
    wanted = _values_of_run(session, given["run"], moved=whole)
    tables = session.values_of(wanted if whole else start, ())
    for name in names:
        if name not in cells:
            tables[name] = None
            continue
        values, chosen = start[name].values.ravel().copy(), cells[name]
        part = slice(None) if chosen is None else np.array(chosen, dtype=np.int64)
        values[part] = wanted[name].values.ravel()[part]
        tables[name] = values.reshape(start[name].values.shape)
    return tables
