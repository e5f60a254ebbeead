"""Contents of the app's screen of an ASCET model: its source text, choices, and what stops its import."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kennfeld.ascet.amd.files import ARCHIVE
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.importers.ascet.import_report import EsdlReport
from kennfeld.importers.ascet.importing import import_requested, read_source
from kennfeld.importers.ascet.outline import ProgramOutline, read_outline
from kennfeld.models.formula import to_lines
from kennfeld.models.import_view import file_numbers, problem_views, report_view
from kennfeld.models.importer import ImportRequest
from kennfeld.models.model import Model

MAX_CHARACTERS = 2_000_000  # of all source texts of an answer


def view(request: ImportRequest, folder: Path) -> dict[str, Any]:
    """Return the source text, the report on the import, the formula text that it becomes, and what stops it."""
    choices: dict[str, Any] = {}
    try:
        choices = _choices(read_outline(request.path))
        result = import_requested(request)
    except InputError as error:
        return choices | _texts(folder, [request.path], error.findings)
    report, model = result.report, result.model
    files = list(dict.fromkeys([request.path, *report.files]))
    return {
        **choices,
        **_texts(folder, files, report.findings),
        **_of_report(report),
        "lines": [] if model is None else _lines(model, files),
        "places": [] if model is None else _places(model, files),
    }


def _choices(outline: ProgramOutline) -> dict[str, Any]:
    return {
        "classes": [asdict(item) for item in outline.classes],
        "tasks": [
            {"name": task.name, "period": task.period, "methods": list(task.processes)} for task in outline.tasks
        ],
    }


def _of_report(report: EsdlReport) -> dict[str, Any]:
    return report_view(report) | {
        "missing": list(report.missing),
        "calls": list(report.methods),
        "startup": list(report.startup),
        "schedule": [asdict(task) for task in report.tasks],
        "states": [asdict(each) for each in report.states],
        "notes": [str(remark) for remark in report.remarks],
    }


def _texts(folder: Path, files: Sequence[Path], findings: Sequence[Finding]) -> dict[str, Any]:
    """Return the texts of files, and findings with the number of the file that each is about."""
    return {"sources": _sources(folder, files), "problems": problem_views(findings, files)}


def _sources(folder: Path, files: Sequence[Path]) -> list[dict[str, str]]:
    rows, room = [], MAX_CHARACTERS
    for path, label in _labels(folder, files).items():
        try:
            text = "" if path.suffix.lower() == ARCHIVE else read_source(path)
        except InputError:
            text = ""
        # the page shows what fits; names of the others stay, so that places keep their numbers
        room -= len(text)
        rows.append({"file": label, "text": text if room >= 0 else ""})
    return rows


def _labels(folder: Path, files: Iterable[Path]) -> dict[Path, str]:
    """Return the names of files as the page shows them: relative to the folder of the project."""
    root, names = folder.resolve(), {}
    for path in files:
        full = path.resolve()
        names[path] = full.relative_to(root).as_posix() if full.is_relative_to(root) else full.as_posix()
    return names


def _lines(model: Model, files: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the formula text, each line with the place in the source of the variable that it calculates."""
    numbers, rows = file_numbers(files), []
    for line in to_lines(model.graph, model.step):
        source, number = _place(model.locations, line.node, numbers)
        rows.append({"text": line.text, "node": line.node, "path": f"{source}:{number}" if number else ""})
    return rows


def _places(model: Model, files: Sequence[Path]) -> list[dict[str, Any]]:
    """Return where nodes and parameters are declared: file and line."""
    numbers = file_numbers(files)
    names = [*model.graph.names, *model.graph.parameters]
    places = {name: _place(model.locations, name, numbers) for name in names}
    return [{"name": name, "source": source, "line": line} for name, (source, line) in places.items() if line]


def _place(locations: Mapping[str, Location], name: str, numbers: Mapping[str, int]) -> tuple[int, int]:
    location = locations.get(name)
    return (numbers[location.file], location.line) if location is not None and location.file in numbers else (-1, 0)
