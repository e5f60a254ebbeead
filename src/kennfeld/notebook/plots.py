"""Figures of a result, drawn with matplotlib."""

from collections.abc import Collection, Sequence
from io import BytesIO
from itertools import pairwise
from typing import Any

import numpy as np

from kennfeld.analysis.evaluation import CriterionSeries, Evaluator
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.optional_packages import optional_package
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.parameters import Parameter
from kennfeld.notebook.dataset_display import reduced
from kennfeld.notebook.parameter_display import with_unit
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.tuning.shift_estimation import apply_shifts

_CALL = Location("plot")
MAX_SERIES = 8  # pairs of a criterion and a dataset in one figure
MAX_TABLES = 12
MAX_POINTS = 4000  # of a line; those of more samples are the minima and maxima of groups
MAX_DOTS = 20_000
BINS = 50
WIDTH = 8.0  # inches
BEFORE, AFTER, MEASURED = "#b0b0b0", "#3b8eea", "#303030"


def plot(
    result: Result,
    kind: str,
    problem: Problem | None,
    *,
    criterion: str = "",
    dataset: str = "",
    names: Collection[str] = (),
) -> Any:
    """Return a figure; see `Result.plot`."""
    if kind == "convergence":
        return _convergence(result)
    if kind == "maps":
        return _maps(result, names)
    if kind not in ("strips", "errors"):
        raise ArgumentError(f"kind={kind!r} of a plot must be convergence, strips, errors or maps")
    pairs = _series(result, problem, criterion, dataset)
    return _strips(pairs) if kind == "strips" else _errors(pairs)


def _figure(rows: int, height: float) -> Any:
    """Return an empty figure. It belongs to no window, and notebooks show it once, whatever their backend."""
    with optional_package(_CALL, "notebook"):
        from matplotlib.figure import Figure

    class NotebookFigure(Figure):
        def _repr_png_(self) -> bytes:
            file = BytesIO()
            self.savefig(file, format="png")
            return file.getvalue()

    return NotebookFigure(figsize=(WIDTH, height * rows), layout="constrained")


def _convergence(result: Result) -> Any:
    figure = _figure(1, 3.5)
    axes = figure.subplots()
    stages = dict.fromkeys((line.start, line.stage) for line in result.trace)
    for start, stage in stages:
        # the steps count from 1, and 0 is the start
        lines = [(i, line.cost) for i, line in enumerate(result.trace, 1) if (line.start, line.stage) == (start, stage)]
        if lines[0][0] == 1 and np.isfinite(result.cost_before):
            lines.insert(0, (0, result.cost_before))
        label = f"start {start}: {stage}" if len(result.starts) > 1 else stage
        axes.semilogy(*zip(*lines, strict=True), label=label)
    axes.set(xlabel="iteration", ylabel="cost")
    if stages:
        axes.legend()
    return figure


@dataclass(frozen=True, eq=False)
class _Pair:
    """One criterion on one dataset before and after the calibration."""

    title: str
    before: CriterionSeries
    after: CriterionSeries


def _series(result: Result, problem: Problem | None, criterion: str, dataset: str) -> list[_Pair]:
    """Return the chosen criteria and datasets that have scored samples."""
    if problem is None:
        message = "the data of this result are in another process. Pass problem=project.problem()"
        raise ArgumentError(f"problem=None: {message}")
    if problem.partitions is not None:
        message = "data in partitions are not plotted as a whole. Write a report, which draws all of them"
        raise ArgumentError(f"problem: {message}")
    # shifts that the run estimated, so that errors are those of the run
    problem = apply_shifts(problem, result.shifts) if problem.unknown_shifts else problem
    evaluator = Evaluator(problem)
    pairs = []
    for before, after in zip(evaluator.series(result.start), evaluator.series(result.parameters), strict=True):
        node, name = problem.criteria[after.criterion].node, after.bound.dataset.name
        pairs.append((node, name, _Pair(f"{node}, {name}", before, after)))
    _check("criterion", criterion, {node for node, _, _ in pairs})
    _check("dataset", dataset, {name for _, name, _ in pairs})
    chosen = [pair for node, name, pair in pairs if criterion in ("", node) and dataset in ("", name)]
    return chosen[:MAX_SERIES]


def _check(argument: str, name: str, known: Collection[str]) -> None:
    if name and name not in known:
        remedy = nearest(name, known) or f"There are {join_names(sorted(known))}."
        raise ArgumentError(f"{argument}={name!r} of a plot is unknown. {remedy}")


def _strips(pairs: Sequence[_Pair]) -> Any:
    figure = _figure(len(pairs), 3.2)
    grid = figure.subplots(2 * len(pairs), 1, squeeze=False, height_ratios=[3, 1] * len(pairs))[:, 0]
    for number, pair in enumerate(pairs):
        above, below = grid[2 * number], grid[2 * number + 1]
        below.sharex(above)
        series = pair.after
        x = np.arange(series.model.size, dtype=np.float64) if series.time is None else series.time
        for label, values, colour in (
            ("before", pair.before.model, BEFORE),
            ("measured", series.measured, MEASURED),
            ("after", series.model, AFTER),
        ):
            above.plot(*_broken(x, values, series), color=colour, label=label, linewidth=0.9)
        below.plot(*_broken(x, series.error, series), color=AFTER, linewidth=0.9)
        below.axhline(0.0, color=MEASURED, linewidth=0.6)
        above.set(title=pair.title, ylabel=with_unit("value", series.unit))
        below.set(xlabel="sample" if series.time is None else "time [s]", ylabel="error")
        above.legend(loc="upper right")
    return figure


def _broken(x: Float, y: Float, series: CriterionSeries) -> tuple[Float, Float]:
    """Return a line that is interrupted between the pieces of a recording, with a bounded number of points."""
    starts = series.bound.starts[1:]
    # matplotlib interrupts a line at NaN
    x, y = np.insert(x, starts, np.nan), np.insert(y, starts, np.nan)
    numbers, values = reduced(y, MAX_POINTS)
    return x[numbers.astype(np.int64)], values


def _errors(pairs: Sequence[_Pair]) -> Any:
    figure = _figure(len(pairs), 3.4)
    grid = figure.subplots(len(pairs), 2, squeeze=False)
    for (left, right), pair in zip(grid, pairs, strict=True):
        scored, unit = np.flatnonzero(pair.after.scored), pair.after.unit
        scored = scored[:: -(-scored.size // MAX_DOTS)]
        measured = pair.after.measured[scored]
        ends = [float(measured.min()), float(measured.max())]
        for label, series, colour in (("before", pair.before, BEFORE), ("after", pair.after, AFTER)):
            left.plot(measured, series.model[scored], ".", color=colour, label=label, markersize=2)
            known = series.error[np.isfinite(series.error)]
            right.hist(known, BINS, color=colour, label=label, alpha=0.7)
        left.plot(ends, ends, color=MEASURED, linewidth=0.8)
        left.set(title=pair.title, xlabel=with_unit("measured", unit), ylabel=with_unit("model", unit))
        right.set(title="errors", xlabel=with_unit("model - measured", unit), ylabel="samples")
        left.legend()
        right.legend()
    return figure


def _maps(result: Result, names: Collection[str]) -> Any:
    tables = {name: table for name, table in result.parameters.items() if table.axes}
    for name in names:
        _check("names", name, tables)
    chosen = list(names or _fitted(result, tables) or tables)[:MAX_TABLES]
    if not chosen:
        raise ArgumentError("kind='maps' of a plot requires a curve or a map; the result has scalars only")
    rows = -(-len(chosen) // 2)
    figure = _figure(rows, 3.2)
    grid = figure.subplots(rows, min(len(chosen), 2), squeeze=False).ravel()
    for axes, name in zip(grid, chosen, strict=False):
        draw = _draw_curve if len(tables[name].axes) == 1 else _draw_map
        draw(figure, axes, result.start[name], tables[name])
    # an odd number of tables leaves one place empty
    for axes in grid[len(chosen) :]:
        axes.set_visible(False)
    return figure


def _fitted(result: Result, names: Collection[str]) -> list[str]:
    return [name for name in names if result.parameters[name] != result.start[name]]


def _labels(table: Parameter) -> list[str]:
    pairs = zip(table.axes, AXIS_LETTERS, strict=False)
    return [with_unit(axis.input or axis.name or letter, axis.unit) for axis, letter in pairs]


def _draw_curve(figure: Any, axes: Any, before: Parameter, after: Parameter) -> None:
    for label, table, colour in (("before", before, BEFORE), ("after", after, AFTER)):
        axes.plot(table.axes[0].breakpoints, table.values, "o-", color=colour, label=label, markersize=3)
    axes.set(title=after.name, xlabel=_labels(after)[0], ylabel=with_unit("value", after.unit))
    axes.legend()


def _draw_map(figure: Any, axes: Any, before: Parameter, after: Parameter) -> None:
    """Draw a map as colours; of a cube, the plane at the first breakpoints of the further axes."""
    plane = after.values.reshape(*after.values.shape[:2], -1)[:, :, 0]
    x, y = (_edges(axis.breakpoints) for axis in after.axes[:2])
    colours = axes.pcolormesh(x, y, plane.T, cmap="viridis")
    figure.colorbar(colours, ax=axes, label=after.unit)
    titles = _labels(after)
    at = [f"{t} = {axis.breakpoints[0]:g}" for t, axis in zip(titles[2:], after.axes[2:], strict=True)]
    axes.set(title=", ".join([after.name, *at]), xlabel=titles[0], ylabel=titles[1])


def _edges(points: Float) -> Float:
    """Return the ends of the cells around breakpoints."""
    if points.size == 1:
        return np.array([points[0] - 0.5, points[0] + 0.5])
    middles = [0.5 * (a + b) for a, b in pairwise(points.tolist())]
    return np.array([points[0], *middles, points[-1]])
