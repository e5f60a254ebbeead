"""The pictures of a report as plain data, which the page draws; small whatever the size of the data.

Long data made short enough to draw, without losing what can be seen.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np

from kennfeld.analysis import CellErrors, Residuals
from kennfeld.analysis.evaluation import CriterionSeries
from kennfeld.arrays import Float, Int
from kennfeld.parameters import Axis, Parameter
from kennfeld.report.markup import rounded
from kennfeld.report.report_data import ParameterChange, ReportData

__all__ = ["TraceEnvelope", "histogram", "some"]

ALL_POINTS = 120_000  # of all strips and scatter plots together
TRACE_POINTS = (400, 4000)  # least and most of one trace
DOTS = (200, 3000)
BINS = 50
ALIKE = 1e-12  # relative range of errors up to which they are all the same
OUTLYING = 0.001  # share of errors that may lie beyond the ends of a histogram

Figure = Mapping[str, Any]


class TraceEnvelope:
    """Groups neighbouring samples so that a trace has at most `most` points: the least and the greatest of each group.

    >>> groups = TraceEnvelope(8, most=4)
    >>> groups.trace(np.array([0.0, 5, 1, 2, 3, 3, 9, -1]))
    array([ 0.,  5., -1.,  9.])
    """

    def __init__(self, count: int, most: int) -> None:
        self.whole = count <= most
        size = 1 if self.whole else -(-count // max(most // 2, 1))
        self.firsts = np.arange(0, count, size)

    def trace(self, values: Float) -> Float:
        """The values themselves, or least and greatest of each group in turn; NaN where a group has none."""
        if self.whole:
            return values
        pair: Float = np.stack([np.fmin.reduceat(values, self.firsts), np.fmax.reduceat(values, self.firsts)], axis=1)
        return pair.ravel()

    def places(self, x: Float) -> Float:
        """Where the points of a trace lie: the first sample of each group, twice."""
        return x if self.whole else np.repeat(x[self.firsts], 2)


def some(count: int, most: int, always: Sequence[int] = ()) -> Int:
    """At most so many of `count` samples, drawn at random but the same each time, in order; `always` are among them."""
    if count <= most:
        return np.arange(count)
    drawn = np.random.default_rng(0).choice(count, most, replace=False)
    return np.unique(np.concatenate([drawn, np.asarray(always, dtype=np.int64)]))


def histogram(values: Float, ends: tuple[float, float], bins: int) -> Int:
    """How many values lie in each of the even bins between `ends`; those beyond count in the first and the last."""
    inside = np.clip(values[np.isfinite(values)], *ends)
    return np.histogram(inside, bins, ends)[0].astype(np.int64)


def strip(before: CriterionSeries, after: CriterionSeries, series: int) -> Figure:
    """Measured, model before and after, and the error, over time or over the samples' number; of `series` strips."""
    most = int(np.clip(ALL_POINTS // (5 * max(series, 1)), *TRACE_POINTS))
    groups = TraceEnvelope(after.model.size, most)
    x, title, unit = _along(after)
    traces = {
        "measured": after.measured,
        "before": before.model,
        "after": after.model,
        "errorBefore": before.error,
        "error": after.error,
    }
    return {
        "kind": "strip",
        "samples": after.model.size,
        "whole": groups.whole,
        "time": after.time is not None,
        "x": rounded(groups.places(x), 7),
        "xTitle": title,
        "xUnit": unit,
        "pieces": rounded(x[after.bound.starts[1:]], 7),
        "unit": after.unit,
        **{name: rounded(groups.trace(values)) for name, values in traces.items()},
    }


def _along(series: CriterionSeries) -> tuple[Float, str, str]:
    """What a strip is drawn over: time, the pieces in a row where time starts anew in each, else the number."""
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
    return row, "time, the recordings in a row", "s"


def scatter(before: CriterionSeries, after: CriterionSeries, series: int, worst: Sequence[int]) -> Figure:
    """Model over measurement, before and after; of many samples some, the worst among them."""
    scored = np.flatnonzero(after.scored)
    most = int(np.clip(ALL_POINTS // (6 * max(series, 1)), *DOTS))
    always = np.flatnonzero(np.isin(after.bound.kept[scored], worst)).tolist()
    chosen = scored[some(scored.size, most, always)]
    return {
        "kind": "scatter",
        "samples": scored.size,
        "unit": after.unit,
        "number": after.bound.kept[chosen].tolist(),
        "measured": rounded(after.measured[chosen]),
        "before": rounded(before.model[chosen]),
        "after": rounded(after.model[chosen]),
    }


def histograms(before: CriterionSeries, after: CriterionSeries) -> Figure:
    """The errors before and after, each on its own axis and both on one."""
    old, new = before.error, after.error
    own = {"before": _ends(old), "after": _ends(new)}
    shared = (min(e[0] for e in own.values()), max(e[1] for e in own.values()))
    return {
        "kind": "histograms",
        "unit": after.unit,
        "own": {n: _bins(v, own[n]) for n, v in (("before", old), ("after", new))},
        "equal": {n: _bins(v, shared) for n, v in (("before", old), ("after", new))},
    }


def _ends(error: Float) -> tuple[float, float]:
    """The range of a histogram: all errors, or nearly all where a few lie far out."""
    known = error[np.isfinite(error)]
    if not known.size:
        return -1.0, 1.0
    low, high = np.quantile(known, [OUTLYING, 1.0 - OUTLYING])
    spread = max(high - low, 1e-12 * max(abs(low), abs(high), 1e-300))
    low, high = max(known.min(), low - 0.5 * spread), min(known.max(), high + 0.5 * spread)
    size = max(abs(low), abs(high))
    if high - low > ALIKE * size:
        return float(low), float(high)
    half = 0.5 * (size or 1.0)  # the errors differ by rounding, which has no room for bins
    return float(low) - half, float(high) + half


def _bins(error: Float, ends: tuple[float, float]) -> Figure:
    known = error[np.isfinite(error)]
    beyond = int(np.count_nonzero((known < ends[0]) | (known > ends[1])))
    return {"ends": rounded(ends), "counts": histogram(error, ends, BINS).tolist(), "beyond": beyond}


def autocorrelation(of: Residuals, dataset: str) -> Figure | None:
    """How errors of a recording are correlated with later ones."""
    found = next(row.autocorrelation for row in of.summaries if row.dataset == dataset)
    if found is None:
        return None
    end = max(int(np.argmax(np.abs(found.values) < found.band)) * 4, 50)  # what lies beyond has no memory left
    part = slice(0, min(end, found.values.size) if (np.abs(found.values) < found.band).any() else found.values.size)
    return {
        "kind": "autocorrelation",
        "unit": found.unit,
        "lags": rounded(found.lags[part]),
        "values": rounded(found.values[part], 4),
        "band": rounded(found.band, 4),
    }


def cells(parts: Sequence[CellErrors], table: Parameter, unit: str, inputs: Sequence[str]) -> Figure:
    """The errors by the cells of a table, of training and test data; of a cube, its first two axes."""
    axes = table.index_axes[:2]
    return {
        "kind": "cells",
        "unit": unit,
        "axes": _axes(axes, inputs),
        "uses": {part.use: _flat(part) for part in parts},
    }


def _flat(part: CellErrors) -> Figure:
    further = tuple(range(2, part.samples.ndim))
    count = part.samples.sum(axis=further)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.nansum(part.samples * part.mean, axis=further) / count
        square = np.nansum(part.samples * part.rmse**2, axis=further) / count
    return {"samples": count.tolist(), "mean": rounded(mean, 4), "rmse": rounded(np.sqrt(square), 4)}


def _axes(axes: Sequence[Axis], inputs: Sequence[str]) -> list[Figure]:
    """Axes with what they carry, or what the function looks them up with."""
    named = zip_longest(axes, inputs[: len(axes)], "xyzw"[: len(axes)], fillvalue="")
    return [
        {
            "title": axis.input or given or axis.name or letter,
            "unit": axis.unit,
            "points": rounded(axis.breakpoints, 8),
        }
        for axis, given, letter in named
        if isinstance(axis, Axis)
    ]


def parameter(change: ParameterChange, inputs: Sequence[str]) -> Figure:
    """A table over its `inputs` before and after, with what is known about each of its values, all flat in C order."""
    after = change.after
    extras = {
        "samples": change.samples,
        "informed": change.informed,
        "bySmoothness": change.by_smoothness,
    }
    return {
        "kind": "parameter",
        "name": after.name,
        "unit": after.unit,
        "type": after.kind,
        "axes": _axes(after.index_axes, inputs),
        "before": rounded(change.before.values.ravel(), 8),
        "after": rounded(after.values.ravel(), 8),
        "bound": change.bound.ravel().tolist(),
        "locked": after.locked.ravel().astype(int).tolist(),
        "deviation": None if change.deviation is None else _deviations(change.deviation),
        **{n: None if a is None else np.asarray(a).ravel().astype(int).tolist() for n, a in extras.items()},
    }


def _deviations(deviation: Float) -> list[float | None]:
    """Standard deviations; -1 stands for an endless one, None for one that is not known."""
    flat = deviation.ravel()
    return [-1 if np.isinf(value) else shown for value, shown in zip(flat, rounded(flat), strict=True)]


def convergence(subject: ReportData) -> Figure | None:
    """The cost over the accepted steps, by start and stage."""
    if subject.result is None or not subject.result.trace:
        return None
    return {
        "kind": "convergence",
        "before": rounded(subject.result.cost_before, 7),
        "stages": list(_stages(subject.result.trace)),
    }


def _stages(trace: Sequence[Any]) -> Iterator[dict[str, Any]]:
    """Runs of lines of one stage; steps are counted through each start."""
    stage: dict[str, Any] | None = None
    steps: dict[int, int] = {}
    for line in trace:
        if stage is None or (stage["name"], stage["start"]) != (line.stage, line.start) or line.iteration == 1:
            if stage is not None:
                yield stage
            stage = {"name": line.stage, "start": line.start, "x": [], "cost": [], "rmse": []}
        steps[line.start] = steps.get(line.start, 0) + 1
        stage["x"].append(steps[line.start])
        stage["cost"].append(rounded(line.cost, 7))
        stage["rmse"].append(rounded(line.rmse, 5))
    if stage is not None:
        yield stage
