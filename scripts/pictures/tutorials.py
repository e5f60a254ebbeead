"""Pictures of the tutorials, drawn after their steps: `python -m scripts.pictures.tutorials`.

They follow the project files and scripts that the pages show, on data of the demos and examples.
"""

import os
import re
import runpy
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import chdir
from pathlib import Path
from typing import Any

os.environ.setdefault("MPLBACKEND", "agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

import kennfeld as kf
from kennfeld.project import demo

ROOT = Path(__file__).parents[2]
IMAGES, PAGES = ROOT / "docs" / "images", ROOT / "docs" / "tutorials"
STYLE = {"font.size": 9, "figure.facecolor": "white", "axes.grid": True, "grid.alpha": 0.3, "svg.hashsalt": "kennfeld"}
MEASURED, FITTED, OTHER = "#8a8f98", "#0b7285", "#d9480f"


def make() -> None:
    """Make the pictures of all tutorials."""
    IMAGES.mkdir(exist_ok=True)
    for draw in (torque,):
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


def _blocks(page: str, language: str) -> Iterator[str]:
    text = (PAGES / f"{page}.md").read_text(encoding="utf-8")
    return iter(re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL))


def _save(figure: Figure, name: str) -> None:
    figure.savefig(IMAGES / name, dpi=110, bbox_inches="tight", pad_inches=0.15)
    plt.close(figure)


if __name__ == "__main__":
    make()
