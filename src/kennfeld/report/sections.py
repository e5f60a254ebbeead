"""Sections of a report, as markup and figures."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from kennfeld.formatting import count_noun
from kennfeld.optimize.quality import CONSTANT
from kennfeld.report import figures
from kennfeld.report.markup import MISSING, Html, details, element, percent, shown, table, with_unit
from kennfeld.report.parameter_section import parameters
from kennfeld.report.pieces import Pictures, note
from kennfeld.report.provenance import settings, sources
from kennfeld.report.report_data import ReportData, Score
from kennfeld.report.residual_sections import fit, residuals
from kennfeld.report.summary import pooled, remarks, verdict
from kennfeld.report.undetermined_section import limits, undetermined

MAX_TEXT = 60_000  # characters of a formula or project file

Section = tuple[str, str, Html, Sequence[tuple[str, str]]]  # anchor, title, content, entries of the table of contents


def sections(report: ReportData, pictures: Pictures) -> Iterator[Section]:
    """Return the sections of a report, with their entries in the table of contents."""
    yield "result", "Result", _result(report), ()
    yield "fit", "Measured and calculated", fit(report, pictures), ()
    yield "residuals", "Residuals", residuals(report, pictures), ()
    content, entries = parameters(report, pictures)
    yield "parameters", "Parameters", content, entries
    if report.result is not None:
        yield "undetermined", "Parameters not determined by the data", undetermined(report), ()
        yield "limits", "Active limits", limits(report), ()
        yield "search", "Search", _search(report, pictures), ()
    yield "messages", "Project check", _messages(report), ()
    yield "settings", "Settings and files", _settings(report), ()


def _result(report: ReportData) -> Html:
    points = [element("li", remark.text, class_=remark.kind) for remark in remarks(report)]
    return element(
        "div",
        element("p", verdict(report), class_="verdict"),
        element("div", [_tile(*tile) for tile in _tiles(report)], class_="tiles"),
        _score_table(report),
        element("ul", points, class_="remarks") if points else None,
    )


def _tiles(report: ReportData) -> Iterator[tuple[str, str, str]]:
    """Return label, number and explanation of each tile."""
    done = report.result is not None
    for number in dict.fromkeys(score.number for score in report.scores):
        scores = [score for score in report.scores if score.number == number]
        name = f"{scores[0].criterion}, " if len(report.problem.criteria) > 1 else ""
        for use in ("training", "test"):
            if part := [score for score in scores if score.use == use]:
                score = pooled(part)
                below = f"before {with_unit(score.rmse[0], score.unit, 4)}" if done else f"{score.samples} samples"
                yield f"{name}RMSE, {use}", with_unit(score.rmse[1], score.unit, 4), below
                if number == 0:
                    below = f"before {with_unit(score.largest[0], score.unit, 4)}" if done else use
                    yield f"{name}largest error, {use}", with_unit(score.largest[1], score.unit, 4), below
    if report.result is not None:
        result = report.result
        yield "values", str(result.free_values), f"of {count_noun(len(report.changes), 'parameter')}"
        yield "time", f"{shown(result.seconds.total, 3)} s", f"{result.iterations} iterations"


def _tile(label: str, number: str, below: str) -> Html:
    value, _, unit = number.partition(" ")
    large = element("b", value, [" ", element("small", unit)] if unit else None)
    return element("div", element("span", label, class_="label"), large, element("span", below), class_="tile")


def _score_table(report: ReportData) -> Html:
    done = report.result is not None
    head = ["criterion", "dataset", "use", "samples", "unit"]
    head += ["RMSE before", "RMSE after", "change", "R2 before", "R2 after", "max |error| before", "max |error| after"]
    if not done:
        head = [*head[:5], "RMSE", "R2", "max |error|"]
    return table(head, [_score_row(score, done=done) for score in report.scores], words=3, class_="wide")


def _score_row(score: Score, *, done: bool) -> list[str]:
    first = [score.criterion, score.dataset, score.use, str(score.samples), score.unit or MISSING]
    if not done:
        return [*first, shown(score.rmse[1]), _r2(score, 1), shown(score.largest[1])]
    before, after = score.rmse
    change = percent(after / before - 1.0) if np.isfinite(before) and before > 0 else MISSING
    return [
        *first,
        *(shown(before), shown(after), change if change.startswith(("-", MISSING)) else f"+{change}"),
        *(_r2(score, 0), _r2(score, 1)),
        *(shown(value) for value in score.largest),
    ]


def _r2(score: Score, which: int) -> str:
    value, rmse = score.r2[which], score.rmse[which]
    if abs(value) < 1e4:
        return f"{value:.4f}"
    return CONSTANT if np.isnan(value) and np.isfinite(rmse) and score.samples else shown(value)


def _search(report: ReportData, pictures: Pictures) -> Html:
    result = report.result
    assert result is not None
    picture = pictures.place(
        figures.convergence(report),
        "Cost over the accepted steps, coloured by stage. Smoothed stages have another cost than the exact model.",
        "cost over the steps",
    )
    rows = [
        ("status", result.status),
        ("message", result.message),
        ("cost before, after", f"{shown(result.cost_before, 6)}, {shown(result.cost_after, 6)}"),
        ("iterations, evaluations", f"{result.iterations}, {result.evaluations}"),
        ("values free, fixed", f"{result.free_values}, {result.fixed_values}"),
        ("time", ", ".join(f"{name} {shown(value, 3)} s" for name, value in vars(result.seconds).items())),
    ]
    return element("div", picture, table(["", ""], rows, words=2, class_="facts"), _starts(report))


def _starts(report: ReportData) -> Html | None:
    starts = report.result.starts if report.result else ()
    if len(starts) < 2:
        return None
    head = ["start", "status", "message", "cost before", "cost after", "distance", "iterations"]
    rows = [
        [
            *(str(row.start), row.status, row.message),
            *(shown(row.cost_before, 6), shown(row.cost_after, 6), shown(row.distance, 3), str(row.iterations)),
        ]
        for row in starts
    ]
    explanation = "Distances are to the values of the best start, each parameter relative to its magnitude there."
    return element("div", table(head, rows, words=3, class_="where"), note(explanation))


def _messages(report: ReportData) -> Html:
    if not report.findings:
        return note("The project check found no problems.")
    return element("ul", [element("li", str(f), class_=f.severity) for f in report.findings], class_="remarks")


def _settings(report: ReportData) -> Html:
    project = report.project
    files = sources(project)
    rows = [[f.role, f.name, _size(f.size), f.changed or MISSING, element("code", f.digest or MISSING)] for f in files]
    function = project.file.folder / project.file.model.file
    return element(
        "div",
        table(["file", "", "size", "changed", "SHA-256"], rows, words=5, class_="wide files"),
        details("Settings", table(["section", "key", "value"], settings(project), words=3), open_=True),
        details(f"Project file {project.path.name}", _text(_read(project.path))),
        details(f"Function {function.name}", _text(_read(function))) if function.suffix == ".kf" else None,
    )


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _text(text: str) -> Html:
    return element("pre", text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + "\n...")


def _size(count: int) -> str:
    """Format a file size.

    >>> _size(123), _size(123456)
    ('123 B', '123 kB')
    """
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{shown(count / scale, 3)} {unit}"
    return f"{count} B"
