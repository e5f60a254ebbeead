"""The packages of the program in layers, as the import contracts of pyproject.toml state them."""

import tomllib
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch
from scripts.pictures.drawing import AFTER, EDGE, GOOD, INK, LIMIT, QUIET, new_figure, save

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
# the first layer of each band, its name, and its colour
BANDS = (
    ("__main__", "commands", AFTER),
    ("app", "app, reports,\nnotebooks", AFTER),
    ("analysis", "projects", AFTER),
    ("optimize", "calibration", GOOD),
    ("preprocessing", "data", GOOD),
    ("importers", "functions", GOOD),
    ("native", "evaluation,\nformats", GOOD),
    ("domain", "domain types", LIMIT),
    ("base", "helpers", EDGE),
)
ROW, GAP, BESIDE = 0.25, 0.07, 0.12  # inches
LABELS, WIDTH, CHARACTER = 1.15, 7.9, 0.068


def make() -> None:
    """Draw each layer as a row, from the commands to the helpers."""
    rows = layers()
    starts = {name: (label, colour) for name, label, colour in BANDS}
    figure = new_figure(height=len(rows) * ROW + len(BANDS) * GAP + 0.1, width=WIDTH)
    figure.set_layout_engine("none")
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, WIDTH), ylim=(figure.get_figheight(), 0))
    axes.axis("off")
    top, colour = 0.05, EDGE
    for row in rows:
        if row[0] in starts:
            label, colour = starts[row[0]]
            top += GAP
            axes.text(0.05, top + 0.05, label, va="top", color=QUIET)
        _draw_row(axes, row, top, colour)
        top += ROW
    save(figure, "layers")


def layers() -> list[list[str]]:
    """Return the layers from top to bottom, each with its packages and modules."""
    contracts = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    rows = next(contract["layers"] for contract in contracts if contract["containers"] == ["kennfeld"])
    return [row.split(" | ") for row in rows]


def _draw_row(axes: Axes, names: list[str], top: float, colour: str) -> None:
    """Draw boxes side by side, as wide as their names need, over the whole width."""
    room = WIDTH - LABELS - 0.05 - BESIDE * (len(names) - 1)
    needed = [CHARACTER * (len(name) + 2) for name in names]
    left = LABELS
    for name, least in zip(names, needed, strict=True):
        width = room * least / sum(needed)
        style = {"boxstyle": "round,pad=0,rounding_size=0.04", "facecolor": "white", "edgecolor": colour}
        axes.add_patch(FancyBboxPatch((left, top + 0.02), width, ROW - 0.04, linewidth=0.8, **style))
        axes.text(left + width / 2, top + ROW / 2, name, ha="center", va="center", fontsize=7.5, color=INK)
        left += width + BESIDE
