"""The function of a project that an importer reads: what a page shows of it, and its parts."""

from typing import Any

from kennfeld.app.answer import Answer, Given
from kennfeld.app.session.function_source import ImportSource
from kennfeld.app.session.session import Session
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.files.file_format import call
from kennfeld.models.import_view import problem_views
from kennfeld.models.importer import FormulaLine
from kennfeld.models.model import Model
from kennfeld.models.model_export import formula_lines, is_formula


def require_import(session: Session) -> ImportSource:
    """Return the function of the project. Raises `ArgumentError` if it is formula text."""
    initial = None if session.view is None or session.stale else session.view.start.parameters
    source = ImportSource.of(session.settings, session.path, initial)
    if source is None:
        raise ArgumentError("the function of the project is not in a file of another tool")
    return source


def imported(session: Session, given: Given) -> Answer:
    """Return the function of the project as its importer shows it: the source, its formula text, what stops it."""
    source = require_import(session)
    if not source.importer.view:
        raise ArgumentError(f"{source.importer.label} has no screen of its own")
    head = _head(source)
    refused = [f for f in session.findings if f.location.path == "[model] file" and f.severity == "error"]
    if refused:
        return Answer({**head, "sources": [], "problems": problem_views(refused)})
    try:
        return Answer({**head, **call(source.importer.view, source.request, session.path.parent)})
    except InputError as error:
        return Answer({**head, "sources": [], "problems": problem_views(error.findings)})


def _head(source: ImportSource) -> dict[str, Any]:
    """Return what the project says of the import."""
    model = source.project.model
    return {
        "file": model.file,
        "subsystem": model.subsystem,
        "bind": dict(model.bind),
        "files": list(model.parameters),
        "chosen": {"class": model.class_name, "methods": list(model.methods), "tasks": list(model.task)},
    }


def parts(session: Session, given: Given) -> Answer:
    """Return the parts of the file that can be imported by themselves, largest first."""
    source = require_import(session)
    if not source.importer.parts:
        raise ArgumentError(f"{source.importer.label} has no parts")
    return Answer({"parts": call(source.importer.parts, source.request, session.path.parent)})


def converted(session: Session) -> tuple[str, Model, list[FormulaLine]]:
    """Return the file of the function, its model, and its formula text; raises `InputError` with what stops it."""
    source = require_import(session)
    model = source.importer.model(source.request)
    if not is_formula(model.graph):
        raise ArgumentError(f"{source.project.model.file} cannot be written as formula text")
    return source.request.path.name, model, formula_lines(source.importer, model)
