"""Pictures of the tutorials, drawn after their steps: `python -m scripts.pictures.tutorials`.

They follow the project files and scripts that the pages show, on data of the demos and examples.
"""

import os
import re
import runpy
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import chdir
from pathlib import Path
from typing import Any

os.environ.setdefault("MPLBACKEND", "agg")

import matplotlib.pyplot as plt
import numpy as np
import pyarrow.parquet as pq
from matplotlib.figure import Figure

import kennfeld as kf
from kennfeld import cli
from kennfeld.project import demo

ROOT = Path(__file__).parents[2]
IMAGES, PAGES = ROOT / "docs" / "images", ROOT / "docs" / "tutorials"
STYLE: Any = {
    "font.size": 9,
    "figure.facecolor": "white",
    "axes.grid": True,
    "grid.alpha": 0.3,
    "svg.hashsalt": "kennfeld",
}
MEASURED, FITTED, OTHER = "#8a8f98", "#0b7285", "#d9480f"


def make() -> None:
    """Make the pictures of all tutorials."""
    IMAGES.mkdir(exist_ok=True)
    for draw in (torque, exhaust, idle, simulink, two_days):
        with plt.rc_context(STYLE), tempfile.TemporaryDirectory() as folder, chdir(folder):
            draw()


def torque() -> None:
    """Draw the drag torque from points under load, and with motored points."""
    demo.write("torque", ".")
    text = Path("load-only.toml").read_text(encoding="utf-8")
    additions = (added for added in _blocks("torque", "toml") if added.startswith("# at the end of"))
    Path("motored.toml").write_text("\n".join([text, *additions]), encoding="utf-8")
    figure = plt.figure(figsize=(8, 3.4))
    for place, (file, title) in enumerate(
        [("load-only.toml", "points under load"), ("motored.toml", "with 27 motored points")], 1
    ):
        drag = kf.Project.read(file).calibrate().parameters["MapDragTorque"]
        axes: Any = figure.add_subplot(1, 2, place, projection="3d")
        speed, air = (axis.breakpoints for axis in drag.axes)
        axes.plot_surface(
            speed[:, None], air[None, :], drag.values, cmap="viridis", vmin=30, vmax=140, edgecolor="k", lw=0.2
        )
        if place == 2:
            points = kf.read("motored.csv")
            axes.scatter(
                *(points[name].values for name in ("Speed", "Rel_Airmass", "MotoringTorque")), color=OTHER, s=9
            )
        axes.set(
            xlabel="Speed [rpm]", ylabel="Rel_Airmass [%]", zlabel="MapDragTorque [Nm]", zlim=(0, 150), title=title
        )
        axes.set_xticks([1000, 3000, 5000])
        axes.view_init(24, -125)
    _save(figure, "tutorial-torque-drag.png")


def exhaust() -> None:
    """Draw the third trip by the map alone and by the lag, and the start of the first trip."""
    shutil.copytree(ROOT / "examples" / "exhaust-temperature", ".", dirs_exist_ok=True)
    _write_files("exhaust")
    runpy.run_path("trips.py")
    sensor = Path("sensor.toml").read_text(encoding="utf-8").replace("lag.kf", "exhaust.kf")
    curve = next(added for added in _blocks("exhaust", "toml") if "CurveTimeConstant" in added)
    sensor = sensor.partition("[parameters.TimeConstant]")[0] + curve
    Path("sensor.toml").write_text(sensor, encoding="utf-8")
    shortened = sensor.partition("[parameters.CurveT")[0].replace("exhaust.kf", "static.kf")
    Path("static.toml").write_text(shortened, encoding="utf-8")
    static, lag = _simulation("static.toml"), _simulation("sensor.toml")
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3), sharey=True)
    part = (lag["file"] == "trip_3.csv") & (lag["time"] > 90) & (lag["time"] < 150)
    left.plot(lag["time"][part], lag["t_exhaust"][part], color=MEASURED, lw=3, alpha=0.5, label="measured")
    left.plot(static["time"][part], static["Temperature"][part], color=OTHER, lw=1, label="map alone")
    left.plot(lag["time"][part], lag["Temperature"][part], color=FITTED, lw=1, label="with lag")
    part = (lag["file"] == "trip_1.csv") & (lag["time"] < 90)
    right.plot(lag["time"][part], lag["t_exhaust"][part], color=MEASURED, lw=3, alpha=0.5)
    right.plot(lag["time"][part], lag["Temperature"][part], color=FITTED, lw=1)
    right.axvspan(40, 60, color=MEASURED, alpha=0.2, lw=0)
    right.text(41, 250, "warm-up")
    left.set(xlabel="time [s]", ylabel="temperature [degC]", title="trip 3")
    right.set(xlabel="time [s]", title="trip 1")
    left.legend(loc="upper left", fontsize=8)
    _save(figure, "tutorial-exhaust-lag.png")


def idle() -> None:
    """Draw set values and load steps with the fast gains, and with those that limit the overshoot."""
    demo.write("idle", ".")
    demo.prepare("idle", Path(), lambda line: None)
    _write_files("idle")
    runpy.run_path("load_steps.py")
    steps = next(added for added in _blocks("idle", "toml") if "load_steps.csv" in added)
    Path("limited.toml").write_text(Path("limited.toml").read_text(encoding="utf-8") + steps, encoding="utf-8")
    _simulation("kennfeld.toml")
    assert cli.run(["simulate", "limited.toml", "-q", "-p", "kennfeld/parameters.dcm", "-o", "fast.parquet"]) == 0
    runs = {"fast": (_columns("fast.parquet"), OTHER), "limited": (_simulation("limited.toml"), FITTED)}
    figure, panels = plt.subplots(1, 2, figsize=(8, 3))
    for panel, name in zip(panels, ("set values", "load steps"), strict=True):
        for label, (run, color) in runs.items():
            part = (run["dataset"] == name) & (run["time"] >= 5)
            if label == "fast":
                panel.plot(run["time"][part], run["n_set"][part], color=MEASURED, lw=1, label="set value")
            panel.plot(run["time"][part], run["n"][part], color=color, lw=1.2, label=label)
        panel.set(xlabel="time [s]", title=name)
    panels[0].set_ylabel("speed [rpm]")
    panels[0].legend(fontsize=8)
    _save(figure, "tutorial-idle-loop.png")


def simulink() -> None:
    """Draw the error over the vehicle speed, with the gain of the cooling held and fitted."""
    shutil.copytree(ROOT / "examples" / "simulink", ".", dirs_exist_ok=True)
    text = Path("kennfeld.toml").read_text(encoding="utf-8")
    held = text.replace("[calibration]", '[calibration]\nfree = ["MapGas", "KRetard", "TauSensor"]')
    Path("held.toml").write_text(held, encoding="utf-8")
    vehicle = np.concatenate([kf.read(f"drive_{number}.csv")["v_fzg"].values for number in (1, 2, 3)])
    figure, panels = plt.subplots(1, 2, figsize=(8, 2.8), sharey=True)
    titles = {"held.toml": "gain held at -1", "kennfeld.toml": "gain fitted"}
    for panel, (project, title) in zip(panels, titles.items(), strict=True):
        run = _simulation(project)
        error = run["T_sensor"] - run["t_abg"]
        for dataset, color in (("drives", FITTED), ("another drive", OTHER)):
            part = run["dataset"] == dataset
            panel.plot(vehicle[part][::4], error[part][::4], ".", color=color, ms=2, label=dataset)
        panel.set(xlabel="vehicle speed [m/s]", title=title)
    panels[0].set_ylabel("error [degC]")
    panels[0].legend(fontsize=8, markerscale=4)
    _save(figure, "tutorial-simulink-cooling.png")


def two_days() -> None:
    """Draw the changes of the map in standard deviations, and in degC after the fit of the block."""
    demo.write("exhaust", ".")
    _write_files("two-days")
    kf.Project.read("kennfeld.toml").calibrate().parameters.save("released.dcm")
    runpy.run_path("days.py")
    text = Path("days.toml").read_text(encoding="utf-8").replace('["CurveTimeConstant"]', '["MapSettled"]')
    changes: list[Any] = []
    for lock in [line for page in _blocks("two-days", "toml") for line in page.splitlines() if line.startswith("lock")]:
        Path("days.toml").write_text(text.replace("smoothness = 1", f"smoothness = 1\n{lock}", 1), encoding="utf-8")
        result = kf.Project.read("days.toml").calibrate()
        fitted, start = (values["MapSettled"] for values in (result.parameters, kf.read_parameters("released.dcm")))
        changes.append(np.where(fitted.values == start.values, np.nan, fitted.values - start.values))
        if len(changes) == 1:
            assert result.trust is not None
            with np.errstate(invalid="ignore"):
                changes[0] /= result.trust.deviation["MapSettled"]
    figure, panels = plt.subplots(1, 2, figsize=(8.5, 3.4), sharey=True)
    titles = ("points with data: change in standard deviations", "block: change in degC")
    for panel, change, title, limit in zip(panels, changes, titles, (10, 35), strict=True):
        speed, injection = (np.arange(n) for n in change.shape)
        mesh = panel.pcolormesh(injection, speed, change, cmap="RdBu_r", vmin=-limit, vmax=limit)
        panel.set_facecolor("#d5d8dc")
        panel.set_xticks(injection[::2], [f"{y:.0f}" for y in fitted.axes[1].breakpoints[::2]])
        panel.set_yticks(speed[::2], [f"{x:.0f}" for x in fitted.axes[0].breakpoints[::2]])
        panel.set_xlabel("Injection [mg/stk]")
        panel.set_title(title, fontsize=9)
        panel.grid(False)
        figure.colorbar(mesh, ax=panel)
    panels[0].set_ylabel("Speed [rpm]")
    _save(figure, "tutorial-two-days-change.png")


def _simulation(project: str) -> Mapping[str, Any]:
    """Calibrate a project and return the columns of its simulation."""
    results = Path(project).stem
    assert cli.run(["calibrate", project, "-q", "-o", results]) == 0
    return _columns(Path(results) / "simulation.parquet")


def _columns(file: str | Path) -> Mapping[str, Any]:
    table = pq.read_table(file)
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}


def _write_files(page: str) -> None:
    """Write the files that a page shows."""
    for language in ("kf", "python", "toml"):
        for text in _blocks(page, language):
            if name := re.match(r"# ([\w-]+\.(?:toml|kf|py))\b", text):
                Path(name[1]).write_text(text, encoding="utf-8")


def _blocks(page: str, language: str) -> Iterator[str]:
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    return iter(re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL))


def _save(figure: Figure, name: str) -> None:
    figure.savefig(IMAGES / name, dpi=110, bbox_inches="tight", pad_inches=0.15)
    plt.close(figure)


if __name__ == "__main__":
    make()
