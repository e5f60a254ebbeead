"""Charts of the tables in `docs/benchmarks.md`, so that both always show the same numbers."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from scripts.pictures.drawing import AFTER, BEFORE, INK, QUIET, new_figure, save

PAGE = Path(__file__).parents[2] / "docs" / "benchmarks.md"
OWN = "Kennfeld"
RECORDINGS = {
    "20 channels of 3 rasters, MF4, 169 MB": "MF4, 169 MB",
    "1 000 000 rows of 20 columns, CSV, 210 MB": "CSV, 210 MB",
}
UNITS = {"ms": 1e-3, "s": 1.0}

Row = Mapping[str, str]
Bar = tuple[str, float | None, str]  # label, seconds, remark


def make() -> None:
    """Draw all pictures of this group."""
    tables = read_tables(PAGE.read_text(encoding="utf-8"))
    draw_torque(tables)
    draw_exhaust(tables)
    draw_fmus(tables)
    draw_files(tables)
    draw_scaling(tables)


def read_tables(text: str) -> dict[str, list[Row]]:
    r"""Return the rows of the table below each heading.

    >>> text = "## a: some words\n\n| x | y |\n|---|---|\n| 1 s | 2 |\n"
    >>> read_tables(text)
    {'a: some words': [{'x': '1 s', 'y': '2'}]}
    """
    tables = {}
    for section in re.split("^## ", text, flags=re.MULTILINE)[1:]:
        title, *lines = section.splitlines()
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
        if rows:
            tables[title] = [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]
    return tables


def seconds(cell: str) -> float | None:
    """Return a duration in s; None for a dash.

    >>> seconds("93.5 ms"), seconds("1.53 s"), seconds("-")
    (0.0935, 1.53, None)
    """
    match = re.fullmatch(r"([\d.]+) (ms|s)", cell)
    return float(match[1]) * UNITS[match[2]] if match else None


def draw_torque(tables: Mapping[str, Sequence[Row]]) -> None:
    """Times until the cost is within 0.1 % of the best, of the solvers that get there."""
    rows = _table(tables, "torque: 2812 points")
    bars = [(row["solver"], seconds(row["to 0.1%"]), row["remark"].rpartition("stops ")[2]) for row in rows]
    _draw(bars, "benchmark-torque", "Time to within 0.1 % of the best cost", lambda remark: f"ends {remark}")


def draw_exhaust(tables: Mapping[str, Sequence[Row]]) -> None:
    """Times of solvers that all end at the same cost."""
    rows = _table(tables, "exhaust: 26482 samples")
    bars = [(row["solver"], seconds(row["solve"]), "") for row in rows]
    _draw(bars, "benchmark-exhaust", "Time of the calibration; all end at the same cost")


def draw_fmus(tables: Mapping[str, Sequence[Row]]) -> None:
    """Times with Kennfeld and with FMPy, for the longest data."""
    bars: list[Bar] = []
    for title, samples, solver in (("model exchange", "100000", "ode1"), ("co-simulation", "10000", "co-simulation")):
        for row in _table(tables, f"fmu: calibration of FMUs for {title}"):
            if row["samples"] == samples and row["solver"] == solver:
                label = f"{row['FMU']}, {title}, {int(samples):,} samples: {row['tool']}".replace(",000", " 000")
                bars.append((label, seconds(row["time"]), ""))
    _draw(bars, "benchmark-fmus", "Time of the calibration; equal costs")


def draw_files(tables: Mapping[str, Sequence[Row]]) -> None:
    """Times in which recordings are read."""
    rows = [row for row in _table(tables, "files: reading") if "as recorded" not in row["reader"]]
    bars = [
        (f"{kind}: {row['reader']}", seconds(row["best"]), "")
        for row in rows
        for file, kind in RECORDINGS.items()
        if row["file"] == file
    ]
    _draw(bars, "benchmark-files", "Time to read a recording")


def draw_scaling(tables: Mapping[str, Sequence[Row]]) -> None:
    """Time of an iteration by the number of points, on one core and on two."""
    rows = _table(tables, "scaling: cost, gradient")
    figure = new_figure(2.9, 4.6)
    axes = figure.add_subplot()
    for threads, colour in (("1", BEFORE), ("2", AFTER)):
        own = [row for row in rows if row["threads"] == threads and row["values"] == "520"]
        points = [(float(row["points"]), seconds(row["iteration"]) or 0.0) for row in own]
        label = "one core" if threads == "1" else "two cores"
        axes.loglog(*zip(*points, strict=True), marker="o", color=colour, label=label)
    axes.set_xlabel("points")
    axes.set_ylabel("one iteration, s")
    axes.legend()
    save(figure, "benchmark-scaling")


def _table(tables: Mapping[str, Sequence[Row]], beginning: str) -> Sequence[Row]:
    return next(rows for title, rows in tables.items() if title.startswith(beginning))


def _draw(bars: Sequence[Bar], name: str, title: str, remark: Callable[[str], str] = str) -> None:
    """Draw horizontal bars, those of Kennfeld in its colour; what has no time says why."""
    figure = new_figure(0.7 + 0.24 * len(bars))
    axes = figure.add_subplot()
    for number, (label, duration, reason) in enumerate(bars):
        axes.barh(number, duration or 0.0, height=0.62, color=AFTER if OWN in label else BEFORE)
        text = remark(reason) if duration is None else _duration(duration)
        place, style = (duration or 0.0, number), {"color": INK if duration else QUIET, "fontsize": 8, "va": "center"}
        axes.annotate(text, place, (4, 0), textcoords="offset points", **style)
    axes.set_yticks(range(len(bars)), [label for label, _, _ in bars])
    for tick, (label, _, _) in zip(axes.get_yticklabels(), bars, strict=True):
        tick.set_color(INK if OWN in label else QUIET)
    axes.set_ylim(len(bars) - 0.4, -0.6)
    axes.margins(x=0.12)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("s")
    axes.set_title(title)
    save(figure, name)


def _duration(value: float) -> str:
    return f"{value:.3g} s" if value >= 1 else f"{value * 1000:.3g} ms"
