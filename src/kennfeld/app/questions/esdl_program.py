"""The ASCET model of a project: its source text, what can be chosen of it, and what stops its import."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.app.answer import Answer, Given
from kennfeld.app.session.esdl_source import EsdlSource
from kennfeld.app.session.session import Session
from kennfeld.ascet.amd.files import ARCHIVE
from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.domain.parameter_set import ParameterSet

if TYPE_CHECKING:  # for ASCET models only
    from kennfeld.importers.ascet.import_report import EsdlReport
    from kennfeld.importers.ascet.outline import ProgramOutline
    from kennfeld.models.model import Model

MAX_CHARACTERS = 2_000_000  # of all source texts of an answer


def program(session: Session, given: Given) -> Answer:
    """Return the source text of the ASCET model, its report, the formula text that it becomes, and what stops it."""
    source = require_program(session)
    head = {
        "file": source.file,
        "chosen": {"class": source.class_name, "methods": list(source.methods), "tasks": list(source.tasks)},
    }
    refused = tuple(
        each for each in session.findings if each.location.path == "[model] file" and each.severity == "error"
    )
    if refused:
        return Answer({**head, **_texts(source, [], refused)})
    try:
        outline = source.outline()
    except InputError as error:
        return Answer({**head, **_texts(source, [source.path], error.findings)})
    head |= _choices(outline)
    try:
        result = source.imported(initial_values(session))
    except InputError as error:
        return Answer({**head, **_texts(source, [source.path], error.findings)})
    report, model = result.report, result.model
    files = list(dict.fromkeys([source.path, *report.sources]))
    return Answer(
        {
            **head,
            **_texts(source, files, report.findings),
            **_of_report(report),
            "lines": [] if model is None else _lines(model, files),
            "places": [] if model is None else _places(model, files),
        }
    )


def require_program(session: Session) -> EsdlSource:
    """Return the ASCET model of the project. Raises `ArgumentError` if the function is something else."""
    source = EsdlSource.of(session.settings, session.path.parent)
    if source is None:
        raise ArgumentError("the function of the project is not an ASCET model")
    return source


def initial_values(session: Session) -> ParameterSet:
    """Return the values that the project starts from; none if it cannot be read."""
    return ParameterSet() if session.view is None or session.stale else session.view.start.parameters


def converted(session: Session) -> tuple[str, "Model", list[str]]:
    """Return the name of the ASCET model, the model, and its formula text; raises `InputError` with what stops it."""
    from kennfeld.importers.ascet.formula_export import formula_lines

    source = require_program(session)
    result = source.imported(initial_values(session))
    if result.model is None:
        raise InputError(result.report.findings)
    return source.file, result.model, [line.text for line in formula_lines(result.model)]


def _choices(outline: "ProgramOutline") -> dict[str, Any]:
    return {
        "classes": [asdict(item) for item in outline.classes],
        "tasks": [
            {"name": task.name, "period": task.period, "methods": list(task.processes)} for task in outline.tasks
        ],
    }


def _of_report(report: "EsdlReport") -> dict[str, Any]:
    return {
        "whole": report.whole,
        "missing": list(report.missing),
        "calls": list(report.methods),
        "startup": list(report.startup),
        "step": report.step,
        "schedule": [asdict(task) for task in report.tasks],
        "inputs": [asdict(each) for each in report.inputs],
        "outputs": [asdict(each) for each in report.outputs],
        "parameters": [asdict(each) for each in report.parameters],
        "states": [asdict(each) for each in report.states],
        "notes": [str(remark) for remark in report.remarks],
    }


def _texts(source: EsdlSource, files: Sequence[Path], findings: Sequence[Finding]) -> dict[str, Any]:
    """Return the texts of files, and findings with the number of the file that each is about."""
    return {"sources": _sources(source, files), "problems": [_problem(finding, files) for finding in findings]}


def _sources(source: EsdlSource, files: Sequence[Path]) -> list[dict[str, str]]:
    from kennfeld.importers.ascet.importing import read_source

    rows, room = [], MAX_CHARACTERS
    for path, label in source.labels(files).items():
        try:
            text = "" if path.suffix.lower() == ARCHIVE else read_source(path)
        except InputError:
            text = ""
        room -= len(text)
        rows.append({"file": label, "text": text if room >= 0 else ""})
    return rows


def _problem(finding: Finding, files: Sequence[Path]) -> dict[str, Any]:
    names = [path.name for path in files]
    number = names.index(finding.location.file) if finding.location.file in names else -1
    return {
        "source": number,
        "line": finding.location.line,
        "message": finding.message,
        "remedy": finding.remedy,
        "text": str(finding),
    }


def _lines(model: "Model", files: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the formula text, each line with the place in the source of the variable that it calculates."""
    from kennfeld.importers.ascet.formula_export import formula_lines

    numbers = _numbers(files)
    rows = []
    for line in formula_lines(model):
        source, number = _place(model.locations, line.node, numbers)
        rows.append({"text": line.text, "node": line.node, "path": f"{source}:{number}" if number else ""})
    return rows


def _places(model: "Model", files: Sequence[Path]) -> list[dict[str, Any]]:
    """Return where nodes and parameters are declared: file and line."""
    numbers = _numbers(files)
    names = [*model.graph.names, *model.graph.parameters]
    places = {name: _place(model.locations, name, numbers) for name in names}
    return [{"name": name, "source": source, "line": line} for name, (source, line) in places.items() if line]


def _numbers(files: Sequence[Path]) -> dict[str, int]:
    """Return the number of each file by its name, of several with one name the first."""
    return {path.name: number for number, path in reversed(list(enumerate(files)))}


def _place(locations: Mapping[str, Location], name: str, numbers: Mapping[str, int]) -> tuple[int, int]:
    location = locations.get(name)
    return (numbers[location.file], location.line) if location is not None and location.file in numbers else (-1, 0)
