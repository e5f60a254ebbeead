"""Figures of a report as plain data that the page draws, reduced to a bounded number of points."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.analysis.cell_errors import CellErrors
from kennfeld.analysis.residuals import Residuals
from kennfeld.base.markup import Html, element, round_digits
from kennfeld.domain.axis import AXIS_LETTERS, Axis
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.fit.result import TraceLine
from kennfeld.report.drawings import Drawing, Histogram
from kennfeld.report.report_data import ParameterChange, ReportData
from kennfeld.report.strip_details import coded_details

if TYPE_CHECKING:
    from kennfeld.analysis.missing.picture import TermPicture
    from kennfeld.analysis.missing.proposal import TermProposal

MOST_PIECES = 500  # beginnings of recordings that a strip marks

POSITIONS = ("row", "column", *AXIS_LETTERS[2:])  # in a value block

Figure = Mapping[str, Any]


class Pictures:
    """The figures of a page by number; each has a placeholder in which the page draws it."""

    def __init__(self) -> None:
        self.data: list[Figure] = []

    def place(self, figure: Figure | None, caption: str, label: str) -> Html | None:
        """Return the placeholder of a figure, with a caption and a label for screen readers."""
        if figure is None:
            return None
        plot = element("div", class_="plot", data_figure=str(len(self.data)), role="img", aria_label=label)
        self.data.append(figure)
        return element("figure", plot, element("figcaption", caption) if caption else None, class_=figure["kind"])


def strip(drawing: Drawing) -> Figure:
    """Return measured and calculated signal and the error over time or sample number, some pieces marked."""
    # of many pieces every nth beginning is marked, n rounded up
    x, title, unit, pieces = drawing.points.stamps.along()
    groups, detail = drawing.plan.groups, drawing.points.detail
    details = {}
    if detail is not None and drawing.plan.detail is not None:
        details = {"detail": coded_details(detail.stamps, detail.traces, drawing.plan.detail)}
    return {
        "kind": "strip",
        "dataset": drawing.dataset,
        "samples": groups.count,
        "whole": groups.whole,
        "time": drawing.plan.timed,
        "x": round_digits(x, 7),
        "xTitle": title,
        "xUnit": unit,
        "pieces": round_digits(pieces[:: -(-max(pieces.size, 1) // MOST_PIECES)], 7),
        "unit": drawing.plan.unit,
        **{name: round_digits(trace.points(groups)) for name, trace in drawing.points.traces.items()},
        **details,
    }


def signals(drawings: Sequence[Drawing]) -> Mapping[str, Figure]:
    """Return the further signals of each dataset, by its name."""
    drawn = {drawing.dataset: drawing.signals for drawing in drawings}
    return {name: each.figure() for name, each in drawn.items() if each is not None}


def scatter(drawing: Drawing) -> Figure:
    """Return model over measurement, before and after, at a selection of the samples that includes the worst."""
    dots = drawing.points.dots
    return {
        "kind": "scatter",
        "samples": drawing.plan.samples,
        "unit": drawing.plan.unit,
        "number": dots["number"].astype(np.int64).tolist(),
        **{name: round_digits(dots[name]) for name in ("measured", "before", "after")},
    }


def histograms(drawing: Drawing) -> Figure:
    """Return histograms of the errors before and after, on axes of their own and on a common one."""
    return {
        "kind": "histograms",
        "unit": drawing.plan.unit,
        **{
            axes: {name: _bins(each) for name, each in own.items()}
            for axes, own in (("own", drawing.points.own), ("equal", drawing.points.equal))
        },
    }


def _bins(counted: Histogram) -> Figure:
    return {"ends": round_digits(counted.ends), "counts": counted.counts.tolist(), "beyond": counted.beyond}


def autocorrelation(of: Residuals, dataset: str) -> Figure | None:
    """Return the autocorrelation of the errors of a recording, up to four times the lag where it vanishes."""
    memory = next(row.autocorrelation for row in of.summaries if row.dataset == dataset)
    if memory is None:
        return None
    inside = np.abs(memory.values) < memory.band
    end = max(int(np.argmax(inside)) * 4, 50) if inside.any() else memory.values.size
    return {
        "kind": "autocorrelation",
        "unit": memory.unit,
        "lags": round_digits(memory.lags[:end]),
        "values": round_digits(memory.values[:end], 4),
        "band": round_digits(memory.band, 4),
    }


def cells(parts: Sequence[CellErrors], table: Parameter, unit: str, inputs: Sequence[str]) -> Figure:
    """Return the errors by cell of a table, for training and test data; of a cube, over its first two axes."""
    return {
        "kind": "cells",
        "unit": unit,
        "axes": _axes(table.index_axes[:2], inputs),
        "uses": {part.use: _cells_of_plane(part) for part in parts},
    }


def _cells_of_plane(part: CellErrors) -> Figure:
    further = tuple(range(2, part.samples.ndim))
    count = part.samples.sum(axis=further)
    with np.errstate(invalid="ignore", divide="ignore"):
        # pooled over the further axes by the number of samples; the mean of an empty cell is NaN
        mean = np.nansum(part.samples * part.mean, axis=further) / count
        square = np.nansum(part.samples * part.rmse**2, axis=further) / count
    return {"samples": count.tolist(), "mean": round_digits(mean, 4), "rmse": round_digits(np.sqrt(square), 4)}


def _axes(axes: Sequence[Axis], inputs: Sequence[str], letters: Sequence[str] = AXIS_LETTERS) -> list[Figure]:
    """Return axes with the name of their input, or of the coordinate with which the function looks them up."""
    return [
        {
            "title": axis.input or coordinate or axis.name or letter,
            "unit": axis.unit,
            "points": round_digits(axis.breakpoints, 8),
        }
        for axis, coordinate, letter in zip(axes, [*inputs, *repeat("", len(axes))], letters, strict=False)
    ]


def parameter(change: ParameterChange, inputs: Sequence[str]) -> Figure:
    """Return a table over its `inputs` before and after, with the uncertainty of its values, flat in C order."""
    after, deviation = change.after, change.deviation
    if deviation is not None:
        # JSON has no infinity, which means a value that is not determined
        deviation = np.where(np.isinf(deviation), -1.0, deviation).ravel()  # an unknown one is None
    counts = {"samples": change.samples, "informed": change.informed, "bySmoothness": change.by_smoothness}
    return {
        "kind": "parameter",
        "name": after.name,
        "unit": after.unit,
        "type": after.kind,
        "axes": _axes(after.index_axes, inputs, POSITIONS if after.kind == "block" else AXIS_LETTERS),
        "before": round_digits(change.before.values.ravel(), 8),
        "after": round_digits(after.values.ravel(), 8),
        "bound": change.bound.ravel().tolist(),
        "locked": after.locked.ravel().astype(int).tolist(),
        "deviation": None if deviation is None else round_digits(deviation),
        **{name: None if a is None else np.asarray(a).ravel().astype(int).tolist() for name, a in counts.items()},
    }


def term(proposal: "TermProposal", picture: "TermPicture") -> Figure | None:
    """Return a fitted term over its channel or channels, and the errors without and with it; None for a delay."""
    own, parameter = proposal.term, proposal.parameter
    if parameter is None:
        return None
    offset = own.kind == "offset"
    return {
        "kind": "term",
        "form": own.kind,
        "node": own.node,
        "parameter": parameter.name,
        "input": "recording" if offset else own.channel,
        "inputUnit": picture.input_unit,
        "second": own.second,
        "secondUnit": picture.second_unit,
        # recordings count from 1, as the parameter will; the last one stands for others
        "points": [number + 1 for number in own.breakpoints[:-1]] if offset else list(own.breakpoints),
        "secondPoints": list(own.second_breakpoints),
        "now": round_digits(parameter.values.ravel()[: -1 if offset else None], 6),
        # JSON has no infinity, which means a value that is not determined
        "deviation": round_digits(picture.deviation[: -1 if offset else None]),
        "valueUnit": picture.value_unit,
        "neutral": 1.0 if own.kind == "multiply" else 0.0,
        "fitted": True,
        "criterion": picture.criterion,
        "unit": picture.unit,
        "counts": picture.counts.tolist(),
        **{name: round_digits(getattr(picture, name)) for name in ("edges", "before", "after", "x", "error")},
    }


def convergence(report: ReportData) -> Figure | None:
    """Return the cost over the accepted steps, by start and stage."""
    if report.result is None or not report.result.trace:
        return None
    return {
        "kind": "convergence",
        "before": round_digits(report.result.cost_before, 7),
        "stages": _stages(report.result.trace),
    }


def _stages(trace: Sequence[TraceLine]) -> Sequence[Figure]:
    """Group consecutive lines of one stage; steps are numbered through each start."""
    stages: list[dict[str, Any]] = [{}]
    steps: Counter[int] = Counter()
    for line in trace:
        # a stage that follows one of the same name begins at iteration 1
        if line.iteration == 1 or (stages[-1].get("name"), stages[-1].get("start")) != (line.stage, line.start):
            stages.append({"name": line.stage, "start": line.start, "x": [], "cost": [], "rmse": []})
        steps[line.start] += 1
        stages[-1]["x"].append(steps[line.start])
        stages[-1]["cost"].append(round_digits(line.cost, 7))
        stages[-1]["rmse"].append(round_digits(line.rmse, 5))
    return stages[1:]
