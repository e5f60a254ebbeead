"""What data determine: grid points without data, and changes of two tables that the error hardly notices."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from scripts.pictures import demos
from scripts.pictures.drawing import AFTER, COLOURS, EDGE, LIMIT, MEASURED, draw_dots, new_figure, panels, save

import kennfeld as kf
from kennfeld.analysis.evaluation import Evaluator
from kennfeld.base.arrays import Float

Change = Callable[[float, float], kf.ParameterSet]
Places = Sequence[tuple[float, float]]
LEVELS = (5.0, 10.0, 20.0, 40.0, 80.0)  # Nm
ALONG = (45.0, 36.0, 31.0, 28.0, 12.0)  # Nm, where on the right a line has its label


def make() -> None:
    """Draw all pictures of this group."""
    draw_coverage()
    draw_null_directions()


def draw_coverage() -> None:
    """Draw the operating points of a drive over the map of the exhaust demo, and the uncertainty of its values."""
    result = demos.result("exhaust")
    data = demos.project("exhaust").problem().datasets[0]
    table, trust = result.parameters["MapSettled"], result.trust
    x, y = (axis.breakpoints for axis in table.axes)
    samples, deviation = trust.samples["MapSettled"], trust.deviation["MapSettled"]
    figure = new_figure(3.3)
    left, right = figure.subplots(1, 2, sharey=True)
    draw_dots(left, data["Speed"].values[::30], data["Injection"].values[::30], 1.4, MEASURED)
    colours = {"cmap": COLOURS.resampled(24), "norm": LogNorm(0.4, 45.0), "edgecolor": "white", "linewidth": 0.4}
    shown = right.pcolormesh(_edges(x), _edges(y), deviation.T, **colours)
    figure.colorbar(shown, ax=right, label="standard deviation [degC]", ticks=(0.5, 1, 2, 5, 10, 20, 40), format="%g")
    for axes in (left, right):
        _hatch(axes, x, y, samples)
        axes.set(xlabel="Speed [rpm]", xlim=_edges(x)[[0, -1]], ylim=_edges(y)[[0, -1]])
        axes.grid(visible=False)
    left.set(ylabel="Injection [mg/stk]", title="Operating points of a drive of 44 min")
    right.set_title("Uncertainty of MapSettled")
    hatched = Patch(
        facecolor="none", edgecolor=MEASURED, hatch="////", linewidth=0, label="grid point without training data"
    )
    figure.legend(handles=[hatched], loc="outside lower center")
    save(figure, "coverage")


def draw_null_directions() -> None:
    """Draw the error over common changes of two tables: a valley along which it does not rise."""
    parameters, evaluator = demos.result("torque").parameters, Evaluator(demos.project("torque").problem())
    figure, (left, right) = panels(2, 3.5)
    scales, offsets = np.geomspace(0.5, 2.0, 41), np.linspace(-60.0, 60.0, 41)
    errors = _errors(evaluator, lambda a, b: _scaled(parameters, a, b), scales)
    _draw_lines(left, scales, errors["bench"], AFTER, LEVELS)
    left.axhline(1.0, color=LIMIT)
    left.text(1.97, 1.02, "pin = 1", ha="right", va="bottom", color=LIMIT)
    left.set(title="One table times a, the other times 1/a:\nno effect on the fit")
    left.set(xlabel="MapOptTorque times", ylabel="CurveEtaDeltaSpark times")
    errors = _errors(evaluator, lambda a, b: _raised(parameters, a, b), offsets)
    sides = [(sign * (c - x / 2), sign * (c + x / 2)) for x, c in zip(LEVELS, ALONG, strict=True) for sign in (1, -1)]
    _draw_lines(right, offsets, errors["bench"], AFTER, LEVELS, sides)
    _draw_lines(right, offsets, errors["motored"], LIMIT, LEVELS[1:2])
    right.text(52, -12, "motored:\n10 Nm", ha="right", va="top", color=LIMIT)
    right.set(title="Both tables raised by the same torque:\nalmost no effect on the points under load")
    right.set(xlabel="MapOptTorque raised by [Nm]", ylabel="MapDragTorque raised by [Nm]")
    for axes, fit in ((left, 1.0), (right, 0.0)):
        axes.plot(fit, fit, "D", color=MEASURED, markersize=5)
    handles = [
        Line2D([], [], color=AFTER, label="equal RMSE, points under load"),
        Line2D([], [], color=LIMIT, label="what settles it: a pin, motored points"),
        Line2D([], [], color=MEASURED, marker="D", linestyle="", label="result"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3)
    save(figure, "null-directions")


def _errors(evaluator: Evaluator, change: Change, steps: Float) -> dict[str, Float]:
    """Return the RMSE on each dataset over two changes of the parameters, the first along the columns."""
    rows = [[_rmse(evaluator, change(a, b)) for a in steps] for b in steps]
    return {name: np.array([[errors[name] for errors in row] for row in rows]) for name in rows[0][0]}


def _rmse(evaluator: Evaluator, parameters: kf.ParameterSet) -> dict[str, float]:
    errors = {series.bound.dataset.name: series.error[series.scored] for series in evaluator.series(parameters)}
    return {name: float(np.sqrt(np.mean(values**2))) for name, values in errors.items()}


def _draw_lines(
    axes: Axes,
    steps: Float,
    errors: Float,
    colour: str,
    levels: Sequence[float],
    labels: Places | bool = False,
) -> None:
    """Draw lines of equal error, with labels at these places, or where there is room."""
    lines = axes.contour(steps, steps, errors, levels, colors=colour, linewidths=1.1)
    if len(levels) > 1:
        axes.clabel(lines, fmt="%g Nm", fontsize=7.5, manual=labels)


def _scaled(parameters: kf.ParameterSet, torque: float, efficiency: float) -> kf.ParameterSet:
    first, second = parameters["MapOptTorque"], parameters["CurveEtaDeltaSpark"].with_bounds()
    return parameters.with_parameters(
        first.with_bounds().with_values(first.values * torque), second.with_values(second.values * efficiency)
    )


def _raised(parameters: kf.ParameterSet, torque: float, drag: float) -> kf.ParameterSet:
    first, second = (parameters[name].with_bounds() for name in ("MapOptTorque", "MapDragTorque"))
    return parameters.with_parameters(
        first.with_values(first.values + torque), second.with_values(second.values + drag)
    )


def _edges(points: Float) -> Float:
    """Return the edges of the cells around breakpoints."""
    middles = (points[1:] + points[:-1]) / 2
    return np.array([2 * points[0] - middles[0], *middles, 2 * points[-1] - middles[-1]])


def _hatch(axes: Axes, x: Float, y: Float, samples: Float) -> None:
    """Hatch the cells of grid points that no sample uses, and draw the edges of all."""
    across, up = _edges(x), _edges(y)
    corners = [
        [(across[i], up[j]), (across[i + 1], up[j]), (across[i + 1], up[j + 1]), (across[i], up[j + 1])]
        for i, j in np.argwhere(samples == 0)
    ]
    path = Path.make_compound_path(*(Path([*each, each[0]], closed=True) for each in corners))
    axes.add_patch(PathPatch(path, facecolor="none", edgecolor=MEASURED, hatch="////", linewidth=0.0))
    axes.vlines(across, up[0], up[-1], color=EDGE, linewidth=0.4, zorder=0)
    axes.hlines(up, across[0], across[-1], color=EDGE, linewidth=0.4, zorder=0)
