"""The state that every page shows."""

from dataclasses import replace
from typing import Any

import numpy as np

from kennfeld.app.answer import finite
from kennfeld.app.questions.pictures import thumbnail
from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.session import Session
from kennfeld.app.session.view import View
from kennfeld.base.errors import Finding, Location
from kennfeld.files.file_format import Role
from kennfeld.files.formats import endings_of
from kennfeld.graph import Graph
from kennfeld.models.function_files import importer_of_function, split_reference
from kennfeld.models.importer_registry import importer_of

MAX_PIECES = 200  # of a dataset whose begins are drawn


def overview(session: Session) -> dict[str, Any]:
    """Return what all pages show of a session."""
    project, job, view = session.project, session.job, session.view
    return {
        "project": {"name": project.name if project else session.path.parent.name, "path": str(session.path)},
        "revision": session.revision,
        "textRevision": session.text_revision,
        "unsaved": session.history.titles_since(session.saved),
        "undo": session.history.undoable,
        "redo": session.history.redoable,
        "findings": [_finding(finding) for finding in session.findings],
        "code": [{"file": each.file, "digest": each.digest, "text": each.text} for each in session.undecided],
        "job": {
            "state": job.state,
            "message": job.message,
            "seconds": round(job.seconds, 2),
            "run": len(session.runs),
            "iterations": len(job.trace),
        },
        "training": {
            "state": session.training.state,
            "file": session.training.file,
            "seconds": round(session.training.seconds, 1),
            "lines": session.training.lines[-12:],
        },
        "runs": [{"number": run.number, "status": run.result.status} for run in session.runs],
        "seconds": session.seconds,
        "changedOnDisk": session.changed_on_disk,
        "recoverable": session.recoverable,
        "function": _function(session),
        **(_of_function(session) if view is None else _of_view(session, view)),
    }


def _function(session: Session) -> dict[str, Any]:
    """Return the file of the function, and the screen that shows it."""
    model = session.settings.get("model")
    file = str(model.get("file", "")) if isinstance(model, dict) else ""
    importer = importer_of(split_reference(file)[0])
    return {"file": file, "screen": "formula" if importer is None else importer.screen}


def _of_function(session: Session) -> dict[str, Any]:
    """Return what is known of a project that cannot be evaluated yet."""
    if session.function is None:
        return {}
    graph = session.function.graph
    return {"nodes": _nodes(graph), "inputs": list(graph.inputs)}


def _nodes(graph: Graph) -> list[dict[str, str]]:
    return [{"name": name, "unit": graph.units.get(name, "")} for name in graph.names]


def _of_view(session: Session, view: View) -> dict[str, Any]:
    problem = view.model.problem
    graph = problem.model.graph
    return {
        "scores": _scores(session, view),
        "parameters": [_parameter(session, view, name) for name in graph.parameters],
        "freeValues": problem.free_size,
        "datasets": [_dataset(recording) for recording in view.model.recordings],
        "nodes": _nodes(graph),
        "criteria": [
            {"node": c.node, "target": str(c.target), "unit": view.model.unit(i)}
            for i, c in enumerate(problem.criteria)
        ],
        "inputs": [problem.channels.get(name, name) for name in graph.inputs],
        "excerpt": session.excerpt,
    }


def _dataset(recording: LiveDataset) -> dict[str, Any]:
    position = recording.position
    return {
        "name": recording.name,
        "use": recording.use,
        "samples": recording.count,
        "timed": recording.timed,
        "begin": float(position[0]) if position.size else 0.0,
        "end": float(position[-1]) if position.size else 1.0,
        "pieces": [float(position[start]) for start in recording.starts.tolist()[1:MAX_PIECES]],
        "channels": [{"name": c.name, "unit": c.unit} for c in recording.bound.dataset.channels],
    }


def _finding(finding: Finding) -> dict[str, Any]:
    location = finding.location
    return {
        "severity": finding.severity,
        "text": str(finding),
        "message": str(replace(finding, location=Location())),
        "file": location.file,
        "line": location.line,
        "column": location.column,
        "path": location.path,
        "screen": _screen_of(location),
    }


RECORDINGS = endings_of(Role.RECORDING)
FUNCTIONS = (*endings_of(Role.FUNCTION), *endings_of(Role.PROGRAM))
SCREENS = {
    "dataset": "data",
    "channels": "data",
    "calculated": "data",
    "units": "data",
    "model": "function",
    "surrogates": "function",
    "functions": "function",
    "criterion": "optimization",
    "limit": "optimization",
    "equality": "optimization",
    "step": "optimization",
    "optimizer": "optimization",
    "cluster": "optimization",
    "report": "results",
}


def _screen_of(location: Location) -> str:
    """Return the screen on which a problem is solved."""
    if location.file.lower().endswith(FUNCTIONS) or importer_of_function(location.file) is not None:
        return "function"
    if location.file.lower().endswith(RECORDINGS) and not location.path:
        return "data"
    section = location.path.strip("[").partition("]")[0].partition(".")[0]
    return SCREENS.get(section, "parameters")


def _scores(session: Session, view: View) -> list[dict[str, Any]]:
    problem, last = view.model.problem, session.last
    return [
        {
            "criterion": problem.criteria[score.criterion].node,
            "use": score.use,
            "unit": view.model.unit(score.criterion),
            "samples": score.samples,
            "rmse": finite(score.rmse),
            "before": finite(view.start.scores[i].rmse),
            "last": finite(last[i].rmse) if last else None,
            "mean": finite(score.mean),
            "largest": finite(score.largest),
        }
        for i, score in enumerate(view.now.scores)
    ]


def _parameter(session: Session, view: View, name: str) -> dict[str, Any]:
    table, initial = view.now.parameters[name], session.reference(name)
    samples = view.samples.get(name)
    return {
        "name": name,
        "kind": table.kind,
        "unit": table.unit,
        "description": table.description,
        "shape": list(table.values.shape),
        "free": name in view.model.problem.free_names,
        "changed": int(np.count_nonzero(table.values != initial.values)),
        "atBound": int(np.count_nonzero(table.at_bound)),
        "withoutData": 0 if samples is None else int(np.count_nonzero(samples == 0)),
        "thumbnail": thumbnail(table.values),
    }
