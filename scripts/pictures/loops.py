"""The loop of the idle demo: its parts with the fitted gains, and how the engine follows the set value."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch
from scripts.pictures import demos
from scripts.pictures.drawing import AFTER, EDGE, LIMIT, MEASURED, QUIET, new_figure, save

import kennfeld as kf
from kennfeld.project.demo import idle

# left, bottom, width and height of each part of the loop
MISS, GOVERNOR, ENGINE = (6.0, 3.3, 9.0, 4.0), (20.5, 3.3, 19.5, 4.0), (47.5, 3.3, 16.0, 4.0)
WIDTH, HEIGHT = 72.0, 10.0


def make() -> None:
    """Draw the loop above the speed of the physical engine with both sets of gains."""
    figure = new_figure(4.4)
    above, below = figure.subplots(2, 1, height_ratios=[1, 2.2])
    results = [demos.result("idle", file) for file in ("kennfeld.toml", "limited.toml")]
    _draw_loop(above, results[0].parameters)
    data = idle.set_values()
    wanted, time = data["n_set"].values, data.time
    below.plot(time, wanted, color=MEASURED, linewidth=1.0, label="set value")
    texts = ("smallest error", "overshoot limited to 10 rpm")
    for result, colour, text in zip(results, (AFTER, LIMIT), texts, strict=True):
        kp, ki = (float(result.parameters[gain].values) for gain in ("Kp", "Ki"))
        miss, over = idle.on_the_engine(kp, ki)
        error = f"RMSE {np.sqrt(np.mean(miss**2)):.0f} rpm, overshoot {over.max():.0f} rpm"
        label = f"{text}: Kp {kp:.4f}, Ki {ki:.5f}; {error}"
        below.plot(time, wanted - miss, color=colour, label=label)
    below.set(xlabel="time [s]", ylabel="n [rpm]", xlim=(0, time[-1]))
    below.set_title("The gains on the physical engine, which no fit has used")
    figure.legend(*below.get_legend_handles_labels(), loc="outside lower center", ncols=1)
    save(figure, "idle-loop")


def _draw_loop(axes: Axes, parameters: kf.ParameterSet) -> None:
    axes.set(xlim=(0, WIDTH), ylim=(0, HEIGHT))
    axes.axis("off")
    kp, ki = (float(parameters[gain].values) for gain in ("Kp", "Ki"))
    _draw_box(axes, MISS, "miss", "n_set - n", EDGE)
    _draw_box(axes, GOVERNOR, "PI governor", f"Kp = {kp:.4f}, Ki = {ki:.5f}", AFTER)
    _draw_box(axes, ENGINE, "engine", "trained on recordings", EDGE)
    level, right = 5.3, ENGINE[0] + ENGINE[2]
    _draw_wire(axes, [(0.5, level), (MISS[0], level)], "n_set")
    _draw_wire(axes, [(MISS[0] + MISS[2], level), (GOVERNOR[0], level)], "")
    _draw_wire(axes, [(GOVERNOR[0] + GOVERNOR[2], level), (ENGINE[0], level)], "throttle")
    _draw_wire(axes, [(right, level), (WIDTH - 0.5, level)], "n")
    middle = MISS[0] + MISS[2] / 2
    _draw_wire(axes, [(right + 3.5, level), (right + 3.5, 1.2), (middle, 1.2), (middle, MISS[1])], "")
    _draw_wire(axes, [(ENGINE[0] + 3.0, HEIGHT - 0.3), (ENGINE[0] + 3.0, ENGINE[1] + ENGINE[3])], "")
    axes.text(ENGINE[0] + 3.8, 8.5, "load", color=QUIET, va="center")


def _draw_box(axes: Axes, box: tuple[float, float, float, float], first: str, second: str, colour: str) -> None:
    left, bottom, width, height = box
    style = {"boxstyle": "round,pad=0,rounding_size=0.4", "facecolor": "white", "edgecolor": colour}
    axes.add_patch(FancyBboxPatch((left, bottom), width, height, **style))
    axes.text(left + width / 2, bottom + 0.68 * height, first, ha="center", va="center", weight="bold")
    axes.text(left + width / 2, bottom + 0.28 * height, second, ha="center", va="center", color=QUIET)


def _draw_wire(axes: Axes, points: list[tuple[float, float]], text: str) -> None:
    """Draw a line with an arrow at its end, and a name above its first part."""
    axes.plot(*zip(*points[:-1], strict=True), color=QUIET, linewidth=1.0)
    arrow = {"arrowstyle": "->", "color": QUIET, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", points[-1], points[-2], arrowprops=arrow)
    (x1, y1), (x2, _) = points[:2]
    axes.text((x1 + x2) / 2, y1 + 0.5, text, ha="center", va="bottom", color=QUIET)
