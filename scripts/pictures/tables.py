"""A picture for each key of the project file that shapes a table: curves fitted to data of the demos and examples."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scripts.pictures.drawing import AFTER, BEFORE, ERROR, GOOD, LIMIT, LIMIT_SOFT, MEASURED, panels, save

import kennfeld as kf
from kennfeld.base.arrays import Float
from kennfeld.domain.constraints import Shape
from kennfeld.domain.parameters import Parameter
from kennfeld.project.demo import diesel_drive, exhaust, petrol_engine
from kennfeld.project.demo.torque import motored

SPEEDS = np.linspace(700.0, 6100.0, 19)
COARSE, FINE = kf.Step(name="coarse", grid_reduction=3), kf.Step(name="fine")


def make() -> None:
    """Draw all pictures of this group."""
    draw_smoothness()
    draw_lock()
    draw_pin()
    draw_slope_limit()
    draw_grid_reduction()
    draw_free_breakpoints()


def draw_smoothness() -> None:
    """Draw three factors: one follows the noise, one the engine, one cannot bend."""
    figure, row = panels(3, 2.7, sharey=True)
    for axes, factor, text in zip(row, (0.01, 100.0, 1e6), ("0.01", "100", "1e6"), strict=True):
        curve = fit_drag(motored(), smoothness=factor)
        _draw_drag(axes, curve, f"smoothness = {text}\ncurve off by {_distance(curve):.1f} Nm RMS")
    _finish(figure, row, (15, 95))
    save(figure, "smoothness")


def draw_lock() -> None:
    """Draw values that stay as they were up to 1900 rpm."""
    start = _initial()
    locked = start.changed(locked=SPEEDS <= 1900.0)
    figure, row = panels(2, sharey=True)
    _draw_drag(row[0], fit_drag(motored(), start, smoothness=100.0), "without lock", start)
    _draw_drag(row[1], fit_drag(motored(), locked, smoothness=100.0), "lock = [{ x = [700, 1900] }]", start)
    row[1].axvspan(700, 1900, color=LIMIT_SOFT, zorder=0)
    _finish(figure, row, (30, 80))
    save(figure, "lock")


def draw_pin() -> None:
    """Draw a value that is known where nothing was measured."""
    data = motored()
    low = data.select(data["Speed"].values < 3500.0)
    figure, row = panels(2, sharey=True)
    _draw_drag(row[0], fit_drag(low, smoothness=100.0), "without pin", data=low)
    pinned = fit_drag(low, smoothness=100.0, pins=[kf.Pin("CurveDrag", (6100.0,), 70.0)])
    _draw_drag(row[1], pinned, "pin = [{ at = [6100], value = 70 }]", data=low)
    row[1].plot(6100.0, 70.0, "D", color=LIMIT, markersize=7, label="pin")
    _finish(figure, row, (30, 80))
    save(figure, "pin")


def draw_slope_limit() -> None:
    """Draw a curve that must not fall."""
    figure, row = panels(2, sharey=True)
    limits = ((), [Shape("CurveDrag", 0, "slope", lower=0.0)])
    for axes, constraints, text in zip(row, limits, ("without limit", "gradient = { x = [0, inf] }"), strict=True):
        curve = fit_drag(motored(), smoothness=0.03, constraints=constraints)
        falling = np.flatnonzero(np.diff(curve.values) < -1e-6)
        _draw_drag(axes, curve, f"{text}\n{falling.size or 'no'} falling segments")
        for i in falling:
            axes.plot(SPEEDS[i : i + 2], curve.values[i : i + 2], color=ERROR, linewidth=2.5)
    _finish(figure, row, (30, 80))
    save(figure, "slope-limit")


def draw_grid_reduction() -> None:
    """Draw the time constant of the exhaust demo after each of two steps."""
    figure, row = panels(2, sharey=True)
    breakpoints = np.array(exhaust.AIR_MASS)
    for axes, steps, text in zip(
        row, ((COARSE,), (COARSE, FINE)), ("step 1: grid_reduction = 3", "step 2: all breakpoints"), strict=True
    ):
        _draw_time_constant(axes, fit_exhaust(breakpoints, steps=steps), text, every=3 if steps[-1] is COARSE else 1)
    _add_legend(figure, row)
    save(figure, "grid-reduction")


def draw_free_breakpoints() -> None:
    """Draw the time constant of the exhaust demo on four breakpoints, fixed and free."""
    figure, row = panels(2, sharey=True)
    uniform = np.linspace(30.0, 450.0, 4)
    for axes, free, text in zip(row, (False, True), ("fixed breakpoints", 'breakpoints = "free"'), strict=True):
        _draw_time_constant(axes, fit_exhaust(uniform, free=free), text)
    _add_legend(figure, row)
    save(figure, "free-breakpoints")


def fit_drag(data: kf.Dataset, start: kf.Curve | None = None, **options: Any) -> Parameter:
    """Fit a curve of the drag torque to motored points of the torque demo."""
    begin = start or kf.Curve("CurveDrag", kf.Axis(SPEEDS), np.full(SPEEDS.size, 20.0))
    result = kf.calibrate("drag = CurveDrag(Speed)", data, kf.ParameterSet([begin]), "MotoringTorque", **options)
    return result.parameters["CurveDrag"]


def fit_exhaust(breakpoints: Float, *, free: bool = False, steps: tuple[kf.Step, ...] = ()) -> kf.Result:
    """Fit the exhaust demo with a time constant over these breakpoints."""
    axis = kf.Axis(breakpoints, input="AirMass", unit="kg/h", free=free)
    curve = kf.Curve("CurveTimeConstant", axis, np.full(breakpoints.size, 5.0), lower=0.1, upper=100.0)
    return kf.calibrate(
        exhaust.FORMULA,
        exhaust.training(),
        exhaust.start().with_parameters(curve),
        "Temperature",
        node="TemperaturePredict",
        test=exhaust.another(),
        smoothness={"MapSettled": 1.0},
        options=kf.Options(steps=steps),
    )


def _initial() -> kf.Curve:
    return kf.Curve("CurveDrag", kf.Axis(SPEEDS), 44.0 + 0.003 * (SPEEDS - 700.0))


def _distance(curve: Parameter) -> float:
    return float(np.sqrt(np.mean((curve.values - petrol_engine.drag(SPEEDS)) ** 2)))


def _draw_drag(
    axes: Axes, curve: Parameter, title: str, start: kf.Curve | None = None, data: kf.Dataset | None = None
) -> None:
    measured, speed = data or motored(), np.linspace(700.0, 6100.0, 100)
    axes.plot(speed, petrol_engine.drag(speed), "--", color=GOOD, label="engine, without noise")
    if start is not None:
        axes.plot(SPEEDS, start.values, "o-", color=BEFORE, label="initial curve", markersize=3)
    axes.plot(SPEEDS, curve.values, "o-", color=AFTER, label="fitted curve")
    axes.plot(measured["Speed"].values, measured["MotoringTorque"].values, "x", color=MEASURED, label="measured")
    axes.set(title=title, xlabel="Speed [rpm]")


def _draw_time_constant(axes: Axes, result: kf.Result, text: str, *, every: int = 1) -> None:
    flow, curve = np.linspace(30.0, 450.0, 200), result.parameters["CurveTimeConstant"]
    axes.plot(flow, diesel_drive.lag(flow), "--", color=GOOD, label="engine")
    axes.plot(curve.axes[0].breakpoints, curve.values, "o-", color=AFTER, label="fitted curve", markevery=every)
    rmse = next(row.rmse_after for row in result.quality if row.use == "test")
    axes.set(title=f"{text}\nRMSE on test data {rmse:.2f} degC", xlabel="AirMass [kg/h]", ylim=(0, None))


def _add_legend(figure: Figure, row: Sequence[Axes]) -> None:
    row[0].set_ylabel("CurveTimeConstant [s]")
    figure.legend(*row[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)


def _finish(figure: Figure, row: Sequence[Axes], limits: tuple[float, float]) -> None:
    row[0].set(ylabel="CurveDrag [Nm]", ylim=limits)
    handles = {label: handle for axes in row for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5)
    for axes in row:
        axes.set_xticks(range(1000, 6001, 1000), [f"{speed}" for speed in range(1000, 6001, 1000)])
