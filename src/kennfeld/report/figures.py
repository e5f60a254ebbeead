"""Figures of a report as plain data that the page draws, reduced to a bounded number of points."""

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import repeat
from typing import Any

import numpy as np

from kennfeld.analysis.cell_errors import CellErrors
from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.analysis.residuals import Residuals
from kennfeld.arrays import Float, Int
from kennfeld.optimize.result import TraceLine
from kennfeld.parameters import AXIS_LETTERS, Axis, Parameter
from kennfeld.report.markup import Html, element, round_digits
from kennfeld.report.report_data import ParameterChange, ReportData

TOTAL_POINTS = 120_000  # of all time plots and scatter plots together
TRACE_POINTS = (400, 4000)  # minimum and maximum of one trace
SCATTER_POINTS = (200, 3000)
BINS = 50
EQUAL_TOLERANCE = 1e-12  # relative range of errors up to which they count as equal
OUTLIER_SHARE = 0.001  # of errors that may lie beyond the ends of a histogram

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


class TraceEnvelope:
    """Reduces traces to at most `most` points: the minimum and the maximum of each group of consecutive samples.

    >>> groups = TraceEnvelope(8, most=4)
    >>> groups.trace(np.array([0.0, 5, 1, 2, 3, 3, 9, -1]))
    array([ 0.,  5., -1.,  9.])
    """

    def __init__(self, count: int, most: int) -> None:
        self.whole = count <= most
        size = 1 if self.whole else -(-count // max(most // 2, 1))
        self.firsts = np.arange(0, count, size)

    def trace(self, values: Float) -> Float:
        """Return minimum and maximum of each group in turn, NaN for a group without numbers; or the values."""
        if self.whole:
            return values
        pair: Float = np.stack([np.fmin.reduceat(values, self.firsts), np.fmax.reduceat(values, self.firsts)], axis=1)
        return pair.ravel()

    def places(self, x: Float) -> Float:
        """Return the coordinates of the points of a trace: the first sample of each group, twice."""
        return x if self.whole else np.repeat(x[self.firsts], 2)


def sample_indices(count: int, most: int, always: Sequence[int] = ()) -> Int:
    """Draw at most `most` of `count` sample numbers, in order and reproducibly, and add those in `always`."""
    if count <= most:
        return np.arange(count)
    drawn = np.random.default_rng(0).choice(count, most, replace=False)
    return np.unique(np.concatenate([drawn, np.asarray(always, dtype=np.int64)]))


def histogram(values: Float, ends: tuple[float, float], bins: int) -> Int:
    """Count the values in bins of equal width between `ends`; those beyond count in the first and the last bin."""
    inside = np.clip(values[np.isfinite(values)], *ends)
    return np.histogram(inside, bins, ends)[0].astype(np.int64)


def strip(before: CriterionSeries, after: CriterionSeries, series: int) -> Figure:
    """Return measured and calculated signal and the error over time or sample number, for one of `series` plots."""
    most = int(np.clip(TOTAL_POINTS // (5 * max(series, 1)), *TRACE_POINTS))
    groups = TraceEnvelope(after.model.size, most)
    x, title, unit = _along(after)
    traces = {"measured": after.measured, "before": before.model, "after": after.model}
    traces |= {"errorBefore": before.error, "error": after.error}
    return {
        "kind": "strip",
        "samples": after.model.size,
        "whole": groups.whole,
        "time": after.time is not None,
        "x": round_digits(groups.places(x), 7),
        "xTitle": title,
        "xUnit": unit,
        "pieces": round_digits(x[after.bound.starts[1:]], 7),
        "unit": after.unit,
        **{name: round_digits(groups.trace(values)) for name, values in traces.items()},
    }


def _along(series: CriterionSeries) -> tuple[Float, str, str]:
    """Return the x axis of a time plot: time, with pieces in a row if it restarts in each, else the sample number."""
    time, starts = series.time, series.bound.starts
    if time is None:
        return series.bound.kept.astype(np.float64), "sample", ""
    later = time[starts[1:]] > time[starts[1:] - 1]
    if later.all():
        return time, "time", "s"
    row, ends = time.copy(), [*starts[1:].tolist(), time.size]
    end = 0.0
    for first, last in zip(starts.tolist(), ends, strict=True):
        step = float(time[first + 1] - time[first]) if last - first > 1 else 0.0
        row[first:last] += end - time[first]
        end = float(row[last - 1]) + step
    return row, "time, recordings in a row", "s"


def scatter(before: CriterionSeries, after: CriterionSeries, series: int, worst: Sequence[int]) -> Figure:
    """Return model over measurement, before and after, at a selection of the samples that includes the `worst`."""
    scored = np.flatnonzero(after.scored)
    most = int(np.clip(TOTAL_POINTS // (6 * max(series, 1)), *SCATTER_POINTS))
    always = np.flatnonzero(np.isin(after.bound.kept[scored], worst)).tolist()
    chosen = scored[sample_indices(scored.size, most, always)]
    return {
        "kind": "scatter",
        "samples": scored.size,
        "unit": after.unit,
        "number": after.bound.kept[chosen].tolist(),
        "measured": round_digits(after.measured[chosen]),
        "before": round_digits(before.model[chosen]),
        "after": round_digits(after.model[chosen]),
    }


def histograms(before: CriterionSeries, after: CriterionSeries) -> Figure:
    """Return histograms of the errors before and after, on axes of their own and on a common one."""
    errors = {"before": before.error, "after": after.error}
    ends = {name: _ends(error) for name, error in errors.items()}
    shared = (min(low for low, _ in ends.values()), max(high for _, high in ends.values()))
    return {
        "kind": "histograms",
        "unit": after.unit,
        "own": {name: _bins(error, ends[name]) for name, error in errors.items()},
        "equal": {name: _bins(error, shared) for name, error in errors.items()},
    }


def _ends(error: Float) -> tuple[float, float]:
    """Return the range of a histogram: that of all errors, or of nearly all if there are outliers."""
    known = error[np.isfinite(error)]
    if not known.size:
        return -1.0, 1.0
    low, high = np.quantile(known, [OUTLIER_SHARE, 1.0 - OUTLIER_SHARE])
    spread = max(high - low, 1e-12 * max(abs(low), abs(high), 1e-300))
    low, high = max(known.min(), low - 0.5 * spread), min(known.max(), high + 0.5 * spread)
    size = max(abs(low), abs(high))
    if high - low > EQUAL_TOLERANCE * size:
        return float(low), float(high)
    half = 0.5 * (size or 1.0)  # the errors differ by rounding only, too little for bins
    return float(low) - half, float(high) + half


def _bins(error: Float, ends: tuple[float, float]) -> Figure:
    known = error[np.isfinite(error)]
    beyond = int(np.count_nonzero((known < ends[0]) | (known > ends[1])))
    return {"ends": round_digits(ends), "counts": histogram(error, ends, BINS).tolist(), "beyond": beyond}


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
        mean = np.nansum(part.samples * part.mean, axis=further) / count
        square = np.nansum(part.samples * part.rmse**2, axis=further) / count
    return {"samples": count.tolist(), "mean": round_digits(mean, 4), "rmse": round_digits(np.sqrt(square), 4)}


def _axes(axes: Sequence[Axis], inputs: Sequence[str]) -> list[Figure]:
    """Return axes with the name of their input, or of the coordinate with which the function looks them up."""
    return [
        {
            "title": axis.input or coordinate or axis.name or letter,
            "unit": axis.unit,
            "points": round_digits(axis.breakpoints, 8),
        }
        for axis, coordinate, letter in zip(axes, [*inputs, *repeat("", len(axes))], AXIS_LETTERS, strict=False)
    ]


def parameter(change: ParameterChange, inputs: Sequence[str]) -> Figure:
    """Return a table over its `inputs` before and after, with the uncertainty of its values, flat in C order."""
    after, deviation = change.after, change.deviation
    if deviation is not None:
        deviation = np.where(np.isinf(deviation), -1.0, deviation).ravel()  # an unknown one is None
    counts = {"samples": change.samples, "informed": change.informed, "bySmoothness": change.by_smoothness}
    return {
        "kind": "parameter",
        "name": after.name,
        "unit": after.unit,
        "type": after.kind,
        "axes": _axes(after.index_axes, inputs),
        "before": round_digits(change.before.values.ravel(), 8),
        "after": round_digits(after.values.ravel(), 8),
        "bound": change.bound.ravel().tolist(),
        "locked": after.locked.ravel().astype(int).tolist(),
        "deviation": None if deviation is None else round_digits(deviation),
        **{name: None if a is None else np.asarray(a).ravel().astype(int).tolist() for name, a in counts.items()},
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
        if line.iteration == 1 or (stages[-1].get("name"), stages[-1].get("start")) != (line.stage, line.start):
            stages.append({"name": line.stage, "start": line.start, "x": [], "cost": [], "rmse": []})
        steps[line.start] += 1
        stages[-1]["x"].append(steps[line.start])
        stages[-1]["cost"].append(round_digits(line.cost, 7))
        stages[-1]["rmse"].append(round_digits(line.rmse, 5))
    return stages[1:]
