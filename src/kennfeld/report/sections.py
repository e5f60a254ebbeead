"""Sections of a report, as markup and figures."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from kennfeld.base.formatting import count_noun
from kennfeld.base.markup import MISSING, Html, change, decimal, details, element, note, quantity, table
from kennfeld.optimize.fit.result import Result, StartResult
from kennfeld.optimize.quality.quality import CONSTANT
from kennfeld.report import figures
from kennfeld.report.figures import Pictures
from kennfeld.report.missing_section import render_missing
from kennfeld.report.parameter_section import render_parameters
from kennfeld.report.provenance import settings, sources
from kennfeld.report.recording_section import render_recordings
from kennfeld.report.report_data import ReportData, Score
from kennfeld.report.residual_sections import render_fit, render_residuals
from kennfeld.report.rounding_section import render_rounding
from kennfeld.report.summary import by_criterion, observations, pool_scores, verdict
from kennfeld.report.undetermined_section import render_limits, render_undetermined
from kennfeld.report.validation_section import render_validation

MAX_TEXT = 60_000  # characters of a formula or project file

Section = tuple[str, str, Html, Sequence[tuple[str, str]]]  # anchor, title, content, entries of the table of contents


def sections(report: ReportData, pictures: Pictures) -> Iterator[Section]:
    """Return the sections of a report, with their entries in the table of contents."""
    yield "result", "Result", _render_result(report), ()
    if (recordings := render_recordings(report)) is not None:
        yield "recordings", "Recordings", recordings, ()
    if report.result is not None and report.result.rounding is not None:
        yield "rounding", "What is flashed", render_rounding(report.result.rounding), ()
    if report.validation is not None:
        yield "validation", "Cross-validation", render_validation(report.validation), ()
    yield "fit", "Measured and calculated", render_fit(report, pictures), ()
    yield "residuals", "Residuals", render_residuals(report, pictures), ()
    content, entries = render_parameters(report, pictures)
    yield "parameters", "Parameters", content, entries
    if report.result is not None:
        yield "undetermined", "Parameters not determined by the data", render_undetermined(report), ()
        yield "limits", "Active limits", render_limits(report), ()
        if (missing := render_missing(report, pictures)) is not None:
            yield "missing", "What is missing?", *missing
        yield "search", "Search", _render_search(report, report.result, pictures), ()
    findings = [element("li", str(finding), class_=finding.severity) for finding in report.findings]
    messages = element("ul", findings, class_="remarks") if findings else note("The project check found no problems.")
    yield "messages", "Project check", messages, ()
    yield "settings", "Settings and files", _render_settings(report), ()


def _render_result(report: ReportData) -> Html:
    points = [element("li", observation.text, class_=observation.kind) for observation in observations(report)]
    return element(
        "div",
        element("p", verdict(report), class_="verdict"),
        element("div", [_tile(*tile) for tile in _tiles(report)], class_="tiles"),
        _score_table(report),
        element("ul", points, class_="remarks") if points else None,
    )


def _tiles(report: ReportData) -> Iterator[tuple[str, str, str]]:
    """Return label, number and explanation of each tile."""
    result = report.result
    for scores in by_criterion(report.scores):
        name = f"{scores[0].criterion}, " if len(report.problem.criteria) > 1 else ""
        for use in ("training", "test"):
            if part := [score for score in scores if score.use == use]:
                score = pool_scores(part)
                before, after = (quantity(rmse, score.unit, 4) for rmse in score.rmse)
                yield f"{name}RMSE, {use}", after, f"before {before}" if result else f"{score.samples} samples"
                if score.number == 0:
                    before, after = (quantity(largest, score.unit, 4) for largest in score.largest)
                    yield f"{name}largest error, {use}", after, f"before {before}" if result else use
    if result is not None:
        yield "values", str(result.free_values), f"of {count_noun(len(report.changes), 'parameter')}"
        yield "time", f"{decimal(result.seconds.total, 3)} s", f"{result.iterations} iterations"


def _tile(label: str, number: str, below: str) -> Html:
    value, _, unit = number.partition(" ")
    large = element("b", value, [" ", element("small", unit)] if unit else None)
    return element("div", element("span", label, class_="label"), large, element("span", below), class_="tile")


def _score_table(report: ReportData) -> Html:
    head = ["criterion", "dataset", "use", "samples", "unit"]
    head += ["RMSE before", "RMSE after", "change", "R2 before", "R2 after", "max |error| before", "max |error| after"]
    if report.result is None:
        head = [*head[:5], "RMSE", "R2", "max |error|"]
    rows = []
    for score in report.scores:
        row = [score.criterion, score.dataset, score.use, str(score.samples), score.unit or MISSING]
        before, after = score.rmse
        if report.result is None:
            rows.append([*row, decimal(after), _r2(score, 1), decimal(score.largest[1])])
            continue
        row += [decimal(before), decimal(after), change(before, after)]
        rows.append([*row, _r2(score, 0), _r2(score, 1), *map(decimal, score.largest)])
    return table(head, rows, words=3, class_="wide")


def _r2(score: Score, which: int) -> str:
    value, rmse = score.r2[which], score.rmse[which]
    if abs(value) < 1e4:
        return f"{value:.4f}"
    return CONSTANT if np.isnan(value) and np.isfinite(rmse) and score.samples else decimal(value)


def _render_search(report: ReportData, result: Result, pictures: Pictures) -> Html:
    picture = pictures.place(
        figures.convergence(report),
        "Cost over the accepted steps, coloured by stage. Smoothed stages have another cost than the exact model.",
        "cost over the steps",
    )
    rows = [
        ("status", result.status),
        ("message", result.message),
        ("cost before, after", f"{decimal(result.cost_before, 6)}, {decimal(result.cost_after, 6)}"),
        ("iterations, evaluations", f"{result.iterations}, {result.evaluations}"),
        *_certificate_rows(result),
        ("values free, fixed", f"{result.free_values}, {result.fixed_values}"),
        ("time", ", ".join(f"{name} {decimal(value, 3)} s" for name, value in vars(result.seconds).items())),
    ]
    return element("div", picture, table(["", ""], rows, words=2, class_="facts"), _starts(result.starts))


def _certificate_rows(result: Result) -> list[tuple[str, str]]:
    certificate = result.certificate
    if certificate is None:
        return []
    return [
        (
            "gradient",
            f"{decimal(certificate.gradient, 2)}, largest cosine between the errors and the effect of a value",
        ),
        ("decrease still predicted", f"{decimal(certificate.predicted_decrease, 2)} of the cost"),
    ]


def _starts(starts: Sequence[StartResult]) -> Html | None:
    if len(starts) < 2:
        return None
    head = ["start", "status", "message", "cost before", "cost after", "distance", "iterations"]
    rows = [
        [
            *(str(row.start), row.status, row.message),
            *(decimal(row.cost_before, 6), decimal(row.cost_after, 6), decimal(row.distance, 3), str(row.iterations)),
        ]
        for row in starts
    ]
    explanation = "Distances are to the values of the best start, each parameter relative to its magnitude there."
    return element("div", table(head, rows, words=3, class_="where"), note(explanation))


def _render_settings(report: ReportData) -> Html:
    project = report.project
    files = sources(project)
    rows = [[f.role, f.name, _size(f.size), f.changed or MISSING, element("code", f.digest or MISSING)] for f in files]
    function = project.file.folder / project.file.model.file
    return element(
        "div",
        table(["file", "", "size", "changed", "SHA-256"], rows, words=5, class_="wide files"),
        details("Settings", table(["section", "key", "value"], settings(project), words=3), open_=True),
        details(f"Project file {project.path.name}", _read_text(project.path)),
        details(f"Function {function.name}", _read_text(function)) if function.suffix == ".kf" else None,
    )


def _read_text(path: Path) -> Html:
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        text = f"cannot be read: {error.strerror}"
    return element("pre", text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + "\n...")


def _size(count: int) -> str:
    """Format a file size.

    >>> _size(123), _size(123456)
    ('123 B', '123 kB')
    """
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{decimal(count / scale, 3)} {unit}"
    return f"{count} B"
