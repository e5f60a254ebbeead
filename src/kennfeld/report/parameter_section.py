"""Report section of the parameters: values before and after, and their uncertainty."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool
from kennfeld.base.markup import MISSING, Html, decimal, details, element, note, percent, table
from kennfeld.domain.parameters import Parameter
from kennfeld.report import figures
from kennfeld.report.figures import Pictures
from kennfeld.report.report_data import ParameterChange, ReportData

OPEN_CARDS = 4  # parameters that are unfolded initially


def render_parameters(report: ReportData, pictures: Pictures) -> tuple[Html, list[tuple[str, str]]]:
    """Return a card for each table, with their entries in the table of contents."""
    scalars = [c for c in report.changes if c.after.size == 1]
    tables = [c for c in report.changes if c.after.size > 1]
    cards = [_card(i, c, pictures, report) for i, c in enumerate(tables)]
    entries = [(f"parameter-{i}", c.name) for i, c in enumerate(tables)]
    names = [name for name in report.problem.model.graph.parameters if name not in report.problem.free_names]
    fixed = [report.parameters[name] for name in names]
    content = element(
        "div",
        note(
            "Free parameters."
            if report.result is None
            else "Fitted parameters, largest change first. The relative change is the root mean square of the change "
            "divided by that of the values."
        ),
        _overview(tables) if tables else None,
        [element("h4", "Scalars"), _scalar_table(scalars)] if scalars else None,
        _breakpoints(report),
        cards,
        details(f"Fixed parameters: {len(fixed)}", _fixed_table(fixed)) if fixed else None,
    )
    return content, entries


def _overview(changes: Sequence[ParameterChange]) -> Html:
    head = ["parameter", "kind", "unit", "values", "relative change", "largest change", "without data", "at a bound"]
    # rows are cut to the length of the heading
    head += ["median std deviation"] if any(c.deviation is not None for c in changes) else []
    rows = [
        [
            *(element("a", c.name, href=f"#parameter-{i}"), c.after.kind, c.after.unit or MISSING),
            *("x".join(map(str, c.after.values.shape)), percent(c.size), decimal(float(np.max(np.abs(c.difference))))),
            *(_count(c.uncovered), _count(c.bound != 0)),
            MISSING if c.deviation is None else _deviation(float(np.median(c.deviation))),
        ][: len(head)]
        for i, c in enumerate(changes)
    ]
    return table(head, rows, words=3, class_="wide")


def _count(marked: Bool) -> str:
    count = int(np.count_nonzero(marked))
    return str(count) if count else MISSING


def _scalar_table(changes: Sequence[ParameterChange]) -> Html:
    head = ["parameter", "unit", "before", "after", "change", "std deviation", "lower", "upper", ""]
    rows = []
    for c in changes:
        before, after = float(c.before.values.item()), float(c.after.values.item())
        rows.append(
            [
                *(c.name, c.after.unit or MISSING, decimal(before, 7), decimal(after, 7), decimal(after - before)),
                MISSING if c.deviation is None else _deviation(float(c.deviation.item())),
                *(decimal(float(c.after.lower.item())), decimal(float(c.after.upper.item())), _state(c)),
            ]
        )
    if all(c.deviation is None for c in changes):
        for row in (head, *rows):
            del row[5]
    return table(head, rows, words=2, class_="wide")


def _breakpoints(report: ReportData) -> list[Html] | None:
    """Return the table of fitted breakpoints, with their standard deviations."""
    trust, rows = report.trust, []
    for key, free in report.problem.free_axes.items() if report.result is not None else ():
        name = f"axis {key}" if str(key) in report.problem.parameters else str(key)
        place, which = free.places[0]
        before, after = free.axis.breakpoints, report.parameters[place].axes[which].breakpoints
        if after.size != before.size:
            continue
        deviation, samples = (_of_size(after.size, arrays.get(name)) for arrays in (trust.deviation, trust.samples))
        for i, (old, new) in enumerate(zip(before, after, strict=True)):
            rows.append(
                [
                    *(name, str(i + 1), free.axis.unit or MISSING),
                    *(decimal(old, 6), decimal(new, 6), decimal(new - old)),
                    MISSING if deviation is None else _deviation(float(deviation[i])),
                    MISSING if samples is None else str(int(samples[i])),
                ]
            )
    head = ["axis", "breakpoint", "unit", "before", "after", "change", "std deviation", "samples"]
    return [element("h4", "Breakpoints"), table(head, rows, words=1, class_="wide")] if rows else None


def _of_size(size: int, array: Any) -> Any:
    return array if array is not None and np.size(array) == size else None


def _deviation(value: float) -> str:
    return "not determined" if np.isinf(value) else decimal(value, 3)


def _state(change: ParameterChange) -> str:
    if change.after.locked.any():
        return "locked"
    if change.informed is not None and not change.informed.all():
        return "no data: start kept"
    return {-1: "at the lower bound", 1: "at the upper bound", 0: ""}[int(change.bound.item())]


def _card(number: int, change: ParameterChange, pictures: Pictures, report: ReportData) -> Html:
    after = change.after
    unit = f" [{after.unit}]" if after.unit not in ("", "-") else ""
    parts = [element("b", change.name), f"{unit} {after.kind} of {'x'.join(map(str, after.values.shape))}"]
    parts.append(f", changed by {percent(change.size)}" if report.result is not None else "")
    words = [after.description] if after.description else []
    if change.moved:
        words.append("Breakpoints have moved; the previous values are interpolated at the new ones.")
    return details(
        parts,
        note(". ".join(word.rstrip(".") for word in words) + ".") if words else None,
        pictures.place(figures.parameter(change, report.inputs(change.name)), "", f"{change.name} before and after"),
        open_=number < OPEN_CARDS,
        class_="part card",
        id=f"parameter-{number}",
    )


def _fixed_table(parameters: Iterable[Parameter]) -> Html:
    rows = []
    for p in parameters:
        low, high = float(p.values.min()), float(p.values.max())
        value = decimal(low, 6) if low == high else f"{decimal(low)} to {decimal(high)}"
        rows.append([p.name, p.kind, p.unit or MISSING, "x".join(map(str, p.values.shape)) or "1", value])
    return table(["parameter", "kind", "unit", "values", "value"], rows, words=3)
