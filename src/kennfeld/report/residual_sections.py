"""Report sections of measured and calculated signals, and of the residuals."""

from collections.abc import Sequence

from kennfeld.analysis.residuals import Fit, Residuals
from kennfeld.base.formatting import count_noun
from kennfeld.base.markup import Child, Html, decimal, details, element, full_decimal, note, percent, quantity, table
from kennfeld.report import figures
from kennfeld.report.drawings import Drawing
from kennfeld.report.figures import Pictures
from kennfeld.report.report_data import ReportData

OPEN_PARTS = 4  # datasets that are unfolded initially


def render_fit(report: ReportData, pictures: Pictures) -> Html:
    """Return a time plot, a scatter plot and a histogram for each criterion and dataset."""
    parts = []
    for i, (fit, drawing) in enumerate(zip(report.fits, report.drawings, strict=True)):
        of = report.numbered[fit.number]
        data = fit.data.dataset
        summary = [element("b", data.name), f" {of.criterion} against {of.target}, {_samples(fit)}, {data.use}"]
        content = _pictures(drawing, of, data.name, pictures)
        parts.append(details(summary, content, open_=i < OPEN_PARTS, class_="part"))
    return element("div", parts or note("No sample is scored."))


def _samples(fit: Fit) -> str:
    scored, kept = fit.samples, fit.data.count
    dropped = fit.data.samples - kept
    counts = count_noun(scored, "sample") + (f" scored of {kept}" if kept != scored else "")
    return counts + (f", {dropped} skipped because an input is missing" if dropped else "")


def _pictures(drawing: Drawing, of: Residuals, name: str, pictures: Pictures) -> list[Html | None]:
    strip, scatter = figures.strip(drawing), figures.scatter(drawing)
    drawn = "" if strip["whole"] else f" {strip['samples']} samples are drawn as an envelope of minima and maxima."
    zoom = "Drag to zoom, double-click to reset; arrow keys move and zoom. Click a name to hide or show it."
    dots = len(scatter["number"])
    some = f" {dots} of {scatter['samples']} samples, including the worst." if dots < scatter["samples"] else ""
    return [
        pictures.place(strip, zoom + drawn, f"measured and calculated {of.criterion} on {name}"),
        element(
            "div",
            pictures.place(scatter, f"Calculated over measured.{some}", f"calculated over measured, {name}"),
            pictures.place(figures.histograms(drawing), "Distribution of the errors.", f"errors on {name}"),
            class_="row two",
        ),
    ]


def render_residuals(report: ReportData, pictures: Pictures) -> Html:
    """Return the errors by dataset, time and cell, and the worst samples."""
    return element("div", [_of_criterion(report, of, pictures) for of in report.residuals])


def _of_criterion(report: ReportData, of: Residuals, pictures: Pictures) -> Html:
    several = len(report.problem.criteria) > 1
    memories = [
        pictures.place(
            figures.autocorrelation(of, row.dataset),
            f"{row.dataset}: autocorrelation of the error. White noise stays within the grey band; "
            f"{row.samples} samples count as {decimal(row.autocorrelation.independent, 3)} independent ones.",
            f"autocorrelation of the errors on {row.dataset}",
        )
        for row in of.summaries
        if row.autocorrelation is not None
    ]
    maps = [
        pictures.place(
            figures.cells([c for c in of.cells if c.parameter == name], report.parameters[name], of.unit, inputs),
            f"Mean error by cell of {name}; hover over a cell for its RMSE and number of samples.",
            f"errors by cell of {name}",
        )
        for name, inputs in {c.parameter: report.inputs(c.parameter) for c in of.cells}.items()
    ]
    return element(
        "div",
        element("h3", f"{of.criterion} against {of.target}") if several else None,
        element("h4", "By dataset"),
        _summary_table(of),
        note(_explain_scaling(of)),
        [element("h4", "In time"), element("div", memories, class_="row two")] if memories else None,
        _by_cell(maps) if maps else None,
        element("h4", "The worst samples"),
        note("Of consecutive samples with errors of one sign, only the worst is listed.") if memories else None,
        _worst_table(of),
    )


def _by_cell(maps: Sequence[Html | None]) -> list[Child]:
    first, rest = (element("div", part, class_="row two") for part in (maps[:6], maps[6:]))
    more = details(f"{len(maps) - 6} more tables", rest) if len(maps) > 6 else None
    return [element("h4", "By cell of a table"), first, more]


def _explain_scaling(of: Residuals) -> str:
    s = quantity(of.deviation, of.unit)
    if of.scaling == "studentized":
        divisor = f"s sqrt(1 - h), where s = {s} is their standard deviation over the training data and h the leverage "
        divisor += "of the sample"
    else:
        divisor = f"{s}, their root mean square over the training data"
    scaled = f"Scaled errors are {of.scaling}: divided by {divisor}."
    return f"Errors are model minus measurement. {scaled} Of normal errors, 0.27 % are beyond 3."


def _summary_table(of: Residuals) -> Html:
    head = ["dataset", "use", "samples", "mean error", "std deviation", "RMSE", "median |error|", "95 % below"]
    head += ["max |error|", "median relative", "scaled beyond 3"]
    rows = [
        [
            *(row.dataset, row.use, str(row.samples)),
            # a mean that is rounding noise would look like a finding
            decimal(0.0 if abs(row.mean) < 1e-4 * row.rmse else row.mean),
            *(decimal(x) for x in (row.deviation, row.rmse, row.median, row.percentile_95, row.largest)),
            *(percent(row.relative), percent(row.beyond)),
        ]
        for row in of.summaries
    ]
    return table(head, rows, words=2, class_="wide")


def _worst_table(of: Residuals) -> Html:
    timed = any(w.time is not None for w in of.worst)
    inputs = list(dict.fromkeys(name for w in of.worst for name in w.inputs))
    head = ["dataset", "use", "sample", *(["recording", "time [s]"] if timed else [])]
    head += ["measured", "calculated", "error", "relative", "scaled", *inputs]
    rows = [
        [
            *(w.dataset, w.use, str(w.sample), *((str(w.piece + 1), full_decimal(w.time)) if timed else ())),
            *(full_decimal(w.measured), decimal(w.model, 5), decimal(w.error)),
            *(percent(w.relative), decimal(w.scaled, 3)),
            *(full_decimal(w.inputs[name]) for name in inputs),
        ]
        for w in of.worst
    ]
    return table(head, rows, words=2, class_="wide")
