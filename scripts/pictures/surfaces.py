"""The torque of the torque demo as a surface, before and after the calibration, over the measured points."""

from typing import Any

import numpy as np
from scripts.pictures import demos
from scripts.pictures.drawing import COLOURS, EDGE, ERROR, GRID, MEASURED, QUIET, new_figure, save

import kennfeld as kf
from kennfeld.base.arrays import Float

NEAR = 3.0  # degrees from the best ignition within which less than 0.3 % of the torque is lost
BEST = "torque = MapOptTorque(Speed, Rel_Airmass) - MapDragTorque(Speed, Rel_Airmass)"
DISTANCE = "distance = MapOptIgnition(Speed, Rel_Airmass) - Ignition"
VIEW = {"elev": 20, "azim": -128}


def make() -> None:
    """Draw the picture of README and of the first page, with every second point near the best ignition."""
    result, bench = demos.result("torque"), demos.project("torque").problem().datasets[0]
    near = np.flatnonzero(np.abs(values(DISTANCE, "distance", bench, result.parameters)) < NEAR)[::2]
    points = [bench[name].values[near] for name in ("Speed", "Rel_Airmass", "Torque")]
    figure = new_figure(3.8)
    row = next(row for row in result.quality if row.dataset == "bench")
    before, after = (figure.add_subplot(1, 2, i, projection="3d") for i in (1, 2))
    _draw(before, result.start, points, f"Initial maps: RMSE {row.rmse_before:.1f} Nm", stride=2)
    _draw(after, result.parameters, points, f"Calibrated maps: RMSE {row.rmse_after:.2f} Nm", stride=1)
    _draw_legend(figure)
    save(figure, "torque-before-after")


def values(formula: str, node: str, data: kf.Dataset, parameters: kf.ParameterSet) -> Float:
    """Return a node of a formula over a dataset."""
    result: Float = kf.simulate(formula, data, parameters)[node].values
    return result


def _draw(axes: Any, parameters: kf.ParameterSet, points: list[Float], title: str, *, stride: int) -> None:
    """Draw the torque at the best ignition over the grid of the map, or each `stride`-th line of it, and the points."""
    x, y = (axis.breakpoints for axis in parameters["MapOptTorque"].axes)
    grid = np.meshgrid(x, y, indexing="ij")
    heights = _torque(parameters, *(part.ravel() for part in grid)).reshape(grid[0].shape)
    axes.computed_zorder = False
    _draw_points(axes, points, _torque(parameters, *points[:2]), above=False)
    axes.plot_surface(
        *grid, heights, cmap=COLOURS.resampled(40), vmin=0, vmax=220, rstride=stride, cstride=stride,
        edgecolor="white", linewidth=0.25, alpha=0.93, antialiased=True,
    )  # fmt: skip
    _draw_points(axes, points, _torque(parameters, *points[:2]), above=True)
    axes.view_init(**VIEW)
    axes.set_xlabel("Speed [rpm]", labelpad=-2)
    axes.set_ylabel("Rel_Airmass [%]", labelpad=-2)
    axes.set(zlim=(-30, 230), zticks=range(0, 201, 50))
    axes.set(xticks=range(1000, 6001, 1000), yticks=range(40, 101, 20))
    axes.set_title(title, loc="center", pad=0)
    axes.text2D(0.0, 0.86, "torque [Nm]", transform=axes.transAxes)
    axes.set_box_aspect((1.25, 1.0, 0.85), zoom=1.15)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set(facecolor="white", edgecolor=EDGE)
        axis.line.set_color(EDGE)
        axis._axinfo["grid"].update(color=GRID, linewidth=0.7)
        axis.set_tick_params(pad=-1, labelsize=8)


def _draw_points(axes: Any, points: list[Float], surface: Float, *, above: bool) -> None:
    """Draw the points on one side of the surface, with their distance from it."""
    speed, air, torque = (part[(points[2] >= surface) == above] for part in points)
    surface = surface[(points[2] >= surface) == above]
    axes.plot(*_sticks(speed, air, surface, torque), color=ERROR, linewidth=0.6)
    axes.plot(*_sticks(speed, air, torque, torque + 0.01), color=MEASURED, linewidth=1.8, solid_capstyle="round")


def _sticks(x: Float, y: Float, low: Float, high: Float) -> tuple[Float, Float, Float]:
    """Return one line with gaps that goes from `low` to `high` at each point."""
    gap = np.full(x.size, np.nan)
    return np.repeat(x, 3), np.repeat(y, 3), np.column_stack([low, high, gap]).ravel()


def _torque(parameters: kf.ParameterSet, speed: Float, air: Float) -> Float:
    data = kf.Dataset.of("grid", {"Speed": speed, "Rel_Airmass": air})
    return values(BEST, "torque", data, parameters)


def _draw_legend(figure: Any) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [], [], marker=".", linestyle="", color=MEASURED, label=f"measured within {NEAR:g} deg of the best ignition"
        ),
        Line2D([], [], color=ERROR, label="error"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=2, labelcolor=QUIET)
