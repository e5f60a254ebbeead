"""A picture for each key of a dataset that deals with time: shift, warm-up, plateaus."""

import re
from collections.abc import Sequence
from contextlib import chdir
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.axes import Axes
from scripts.pictures import demos
from scripts.pictures.drawing import AFTER, BEFORE, LIMIT, LIMIT_SOFT, MEASURED, new_figure, panels, save

import kennfeld as kf
from kennfeld.base.arrays import Float
from kennfeld.preprocessing.plateaus import average_plateaus, find_plateaus, first_in_band, segment_starts
from kennfeld.project.demo import exhaust

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "delay.md"
SHOWN = (42.0, 58.0)  # s, of the delayed drive
BEGIN, WARMUP, END = 760.0, 40.0, 120.0  # s; a recording that begins in the middle of the demo's drive
BANDS = {"Speed": 60.0, "Temperature": 12.0}  # tolerances
WINDOW = 10.0  # s
STRETCH = (296.0, 410.0)  # s


def make() -> None:
    """Draw all pictures of this group."""
    draw_shift()
    draw_warmup()
    draw_plateaus()


def draw_shift() -> None:
    """Draw the torque of docs/how-to/delay.md as recorded and shifted, and the error at each shift."""
    with TemporaryDirectory() as folder, chdir(folder):
        _write_page()
        result = kf.Project.read("delay.toml").calibrate()
        data = kf.read("drive.csv")
    shifts = next(iter(result.shifts.values()))
    figure, (left, right) = panels(2, 2.9)
    _draw_shifted(left, data, result, shifts)
    delays = np.round(np.arange(-1.4, 0.05, 0.1), 1)
    errors = [_error_at(data, {"Torque": delay, "Speed": shifts["Speed"]}) for delay in delays]
    right.plot(delays, errors, "o-", color=AFTER)
    right.plot(shifts["Torque"], result.quality[0].rmse_after, "D", color=LIMIT, markersize=7)
    best = f"{shifts['Torque']:g} s: {result.quality[0].rmse_after:.1f} Nm"
    right.text(shifts["Torque"] + 0.07, 1.2, best, va="center")
    right.set(
        title="The error of a fit at each shift", xlabel="shift of Torque [s]", ylabel="RMSE [Nm]", ylim=(0, None)
    )
    save(figure, "shift")


def draw_warmup() -> None:
    """Draw a recording that begins while the sensor is still hot from before."""
    data, parameters = exhaust.training(), demos.result("exhaust").parameters
    part = (data.time >= BEGIN) & (data.time < BEGIN + END)
    time = data.time[part] - BEGIN
    columns = {channel.name: channel.values[part] for channel in data.channels}
    model = kf.simulate(exhaust.FORMULA, kf.Dataset.of("part", columns, time=time), parameters)[
        "TemperaturePredict"
    ].values
    error, scored = model - columns["Temperature"], time >= WARMUP
    figure = new_figure(2.7)
    axes = figure.subplots()
    axes.axvspan(0, WARMUP, color=LIMIT_SOFT, zorder=0)
    axes.plot(time[::2], columns["Temperature"][::2], color=MEASURED, label="measured", linewidth=1.0)
    axes.plot(time[::2], model[::2], color=AFTER, label="model")
    axes.text(WARMUP / 2, 0.04, "warm-up: simulated, not scored", transform=axes.get_xaxis_transform(), ha="center")
    axes.set(
        title=f"RMSE {_rms(error):.1f} degC over all samples, {_rms(error[scored]):.1f} degC with warmup = {WARMUP:g}",
        xlabel="time [s]", ylabel="temperature [degC]", xlim=(0, END),
    )  # fmt: skip
    axes.legend(loc="lower right", ncols=2)
    save(figure, "warm-up")


def draw_plateaus() -> None:
    """Draw the stretches of a recording in which two channels are steady, and their means."""
    data = exhaust.training()
    starts = segment_starts(data.time, data.piece_starts, data.counting, 0.0)
    firsts = [first_in_band(data[name].values, tolerance, starts) for name, tolerance in BANDS.items()]
    ranges = find_plateaus(data.time, np.maximum.reduce(firsts), WINDOW)
    means = average_plateaus(data, data.counting, ranges)
    figure = new_figure(3.3)
    rows = figure.subplots(2, 1, sharex=True)
    for axes, (name, tolerance) in zip(rows, BANDS.items(), strict=True):
        _draw_strip(axes, data, name, tolerance, ranges, means[name].values)
    seconds = data.time[-1] - data.time[0]
    rows[0].set_title(f"{len(ranges)} plateaus of at least {WINDOW:g} s in a recording of {seconds / 60:.0f} min")
    rows[1].set_xlabel("time [s]")
    rows[1].legend(loc="lower right", ncols=2)
    save(figure, "plateaus")


def _write_page() -> None:
    """Write the files of the page, and run the script that writes its data."""
    for name, text in re.findall(
        r"^```\w+\n# ([\w.]+)[^\n]*\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S
    ):
        if name.endswith(".py"):
            exec(compile(text, name, "exec"), {})
        elif not Path(name).exists():
            Path(name).write_text(text, encoding="utf-8")


def _error_at(data: kf.Dataset, shifts: dict[str, float]) -> float:
    axes = (kf.Axis(np.linspace(1000.0, 5000.0, 8)), kf.Axis(np.linspace(20.0, 90.0, 6)))
    start = kf.ParameterSet([kf.Map("MapTorque", *axes, np.full((8, 6), 100.0))])
    model = "TorquePredict = MapTorque(Speed, Load)"
    result = kf.calibrate(model, data, start, "Torque", smoothness=1.0, shift=shifts)
    return result.quality[0].rmse_after


def _draw_shifted(axes: Axes, data: kf.Dataset, result: kf.Result, shifts: dict[str, float]) -> None:
    time, torque = data.time, data["Torque"].values
    speed = np.interp(time, time + shifts["Speed"], data["Speed"].values)
    inputs = kf.Dataset.of("inputs", {"Speed": speed, "Load": data["Load"].values}, time=time)
    model = kf.simulate("TorquePredict = MapTorque(Speed, Load)", inputs, result.parameters)["TorquePredict"].values
    moved = time + shifts["Torque"]
    for x, y, style in (
        (time, torque, {"color": BEFORE, "label": "Torque as recorded"}),
        (moved, torque, {"color": MEASURED, "marker": "x", "linestyle": "", "label": "Torque shifted"}),
        (time, model, {"color": AFTER, "label": "model"}),
    ):
        chosen = (x >= SHOWN[0]) & (x <= SHOWN[1])
        axes.plot(x[chosen], y[chosen], **style)
    axes.set(title='shift = { Torque = "auto", Speed = "auto" }', xlabel="time [s]", ylabel="torque [Nm]", xlim=SHOWN)
    axes.legend(loc="best")


def _draw_strip(
    axes: Axes, data: kf.Dataset, name: str, tolerance: float, ranges: Sequence[tuple[int, int]], means: Float
) -> None:
    time, values = data.time, data[name].values
    part = (time >= STRETCH[0]) & (time <= STRETCH[1])
    axes.plot(time[part][::2], values[part][::2], color=MEASURED, linewidth=1.0)
    labels = {"span": "plateau", "mean": "steady point"}
    for (first, last), mean in zip(ranges, means, strict=True):
        if STRETCH[0] <= time[first] and time[last] <= STRETCH[1]:
            axes.axvspan(time[first], time[last], color=LIMIT_SOFT, zorder=0, label=labels.pop("span", None))
            middle = (time[first] + time[last]) / 2
            axes.plot(middle, mean, "D", color=LIMIT, markersize=6, label=labels.pop("mean", None))
    channel = data[name]
    axes.set(ylabel=f"{name} [{channel.unit}]\n+-{tolerance:g}", xlim=STRETCH)


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2)))
