"""Style of the pictures, and files that are equal whenever their numbers are."""

import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from kennfeld.base.arrays import Float
from kennfeld.notebook.pictures import HEIGHTS, css

IMAGES = Path(__file__).parents[2] / "docs" / "images"
MOST_BYTES = 60_000
# the colours of the app and the report, on white
INK, QUIET, EDGE, GRID = "#16191d", "#5c636b", "#c3c9d0", "#e9ebee"
MEASURED, AFTER, BEFORE = "#16191d", "#1f5fbf", "#868d94"
ERROR, LIMIT, LIMIT_SOFT, GOOD = "#c4372c", "#d97706", "#fdf0dc", "#23834a"
COLOURS = LinearSegmentedColormap.from_list("heights", [css(colour) for colour in HEIGHTS])
FONTS = "system-ui,-apple-system,Segoe UI,Helvetica,Arial,sans-serif"

matplotlib.rcParams.update(
    {
        "svg.fonttype": "none",  # text remains text
        "svg.hashsalt": "kennfeld",
        "font.family": "DejaVu Sans",  # comes with matplotlib and is wider than the fonts that replace it
        "font.size": 8.5,
        "axes.titlesize": 9.0,
        "axes.titleweight": "bold",
        "axes.titlelocation": "left",
        "axes.edgecolor": EDGE,
        "axes.labelcolor": INK,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "grid.color": GRID,
        "grid.linewidth": 0.8,
        "xtick.color": EDGE,
        "ytick.color": EDGE,
        "xtick.labelcolor": QUIET,
        "ytick.labelcolor": QUIET,
        "text.color": INK,
        "legend.frameon": False,
        "legend.fontsize": 8.5,
        "lines.linewidth": 1.5,
        "lines.markersize": 4.0,
    }
)


def new_figure(height: float = 2.9, width: float = 7.2) -> Figure:
    """Return an empty figure on white, in inches."""
    return Figure(figsize=(width, height), layout="constrained", facecolor="white")


def panels(count: int, height: float = 2.9, **options: Any) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with axes side by side."""
    figure = new_figure(height)
    return figure, figure.subplots(1, count, squeeze=False, **options)[0]


def draw_dots(axes: Axes, x: Float, y: Float, size: float, colour: str) -> None:
    """Draw many dots as one path, which is smaller than an element for each."""
    gap = np.full(x.size, np.nan)
    across, up = np.column_stack([x, x, gap]).ravel(), np.column_stack([y, y, gap]).ravel()
    (line,) = axes.plot(across, up, color=colour, linewidth=size, solid_capstyle="round")
    line.get_path().should_simplify = False


def save(figure: Figure, name: str) -> None:
    """Write a figure as SVG, with as many digits as a screen shows."""
    file = StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    write(name, file.getvalue())


def write(name: str, svg: str) -> None:
    """Write the text of an SVG; it must be small."""
    svg = _tidy(_with_classes(re.sub(r"<[^>]*>", lambda tag: _shorten(tag[0]), svg)))
    size = len(svg.encode())
    assert size <= MOST_BYTES, f"{name}.svg has {size} bytes, more than {MOST_BYTES}"
    (IMAGES / f"{name}.svg").write_text(svg, encoding="utf-8")
    print(f"{name}.svg: {size / 1000:.0f} kB")


def _shorten(tag: str) -> str:
    """Round the numbers of a tag, and leave out what draws nothing."""
    tag = re.sub(r"-?\d+\.\d{2,}", lambda number: f"{float(number[0]):.1f}".removesuffix(".0"), tag)
    tag = re.sub(r'(?<= d=")[^"]+', lambda path: re.sub(r"\s*([A-Za-z])\s*", r"\1", path[0]).replace("\n", " "), tag)
    return re.sub(r' transform="rotate\(-?0 [^"]*"', "", tag).replace("'DejaVu Sans'", FONTS)


def _tidy(svg: str) -> str:
    """Remove metadata, names of groups, points without a line, and blank lines."""
    svg = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->|<!DOCTYPE[^>]*>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'<path d="M[-\d. ]*" class="\w+"/>', "", svg)
    svg = re.sub(r'<g id="\w+_\d+">', "<g>", svg)
    for _ in range(4):
        svg = re.sub(r"<g>\s*</g>|<g>\s*(<[^<>]*/>)\s*</g>", lambda group: group[1] or "", svg)
    return re.sub(r"\s*\n\s*", "\n", svg).strip() + "\n"


def _with_classes(svg: str) -> str:
    """Name styles and clipping once for all elements that share them."""
    names: dict[str, str] = {}

    def shorten(match: re.Match[str]) -> str:
        style = f"{match[2]};clip-path:{match[1]}" if match[1] else match[2]
        return f'class="{names.setdefault(style, f"c{len(names)}")}"'

    svg = re.sub(r'(?:clip-path="([^"]*)" )?style="([^"]*)"', shorten, svg)
    rules = "".join(f".{name}{{{style}}}" for style, name in names.items())
    return re.sub(r"<svg [^>]*>", lambda head: f"{head[0]}<style>{rules}</style>", svg, count=1)
