"""Report section of the parameters: values before and after, and their uncertainty."""

from collections.abc import Sequence

import numpy as np

from kennfeld.arrays import Bool
from kennfeld.parameters import Parameter
from kennfeld.report import figures
from kennfeld.report.markup import MISSING, Html, details, element, percent, shown, table
from kennfeld.report.pieces import OPEN_PARTS, Pictures, note
from kennfeld.report.report_data import ParameterChange, ReportData


def parameters(report: ReportData, pictures: Pictures) -> tuple[Html, list[tuple[str, str]]]:
    """Return a card for each table, with their entries in the table of contents."""
    scalars = [c for c in report.changes if c.after.size == 1]
    tables = [c for c in report.changes if c.after.size > 1]
    cards = [_card(i, c, pictures, report) for i, c in enumerate(tables)]
    entries = [(f"parameter-{i}", c.name) for i, c in enumerate(tables)]
    fixed = [n for n in report.problem.model.graph.parameters if n not in report.problem.free_names]
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
        details(f"Fixed parameters: {len(fixed)}", _fixed_table(report, fixed)) if fixed else None,
    )
    return content, entries


def _overview(changes: Sequence[ParameterChange]) -> Html:
    head = ["parameter", "kind", "unit", "values", "relative change", "largest change", "without data", "at a bound"]
    head += ["median std deviation"] if any(c.deviation is not None for c in changes) else []
    rows = []
    for i, c in enumerate(changes):
        size = "x".join(map(str, c.after.values.shape))
        row = [
            element("a", c.name, href=f"#parameter-{i}"),
            *(c.after.kind, c.after.unit or MISSING, size, percent(c.size), shown(float(np.max(np.abs(c.difference))))),
            *(_count(c.uncovered), _count(c.bound != 0)),
        ]
        if c.deviation is not None:
            row.append(_deviation(float(np.median(c.deviation))))
        rows.append(row if len(row) == len(head) else [*row, MISSING])
    return table(head, rows, words=3, class_="wide")


def _count(marked: Bool) -> str:
    count = int(np.count_nonzero(marked))
    return str(count) if count else MISSING


def _scalar_table(changes: Sequence[ParameterChange]) -> Html:
    known = any(c.deviation is not None for c in changes)
    head = [
        "parameter",
        "unit",
        "before",
        "after",
        "change",
        *(["std deviation"] if known else []),
        "lower",
        "upper",
        "",
    ]
    rows = []
    for c in changes:
        before, after = float(c.before.values.item()), float(c.after.values.item())
        lower, upper = float(c.after.lower.item()), float(c.after.upper.item())
        deviation = [] if not known else [MISSING if c.deviation is None else _deviation(float(c.deviation.item()))]
        rows.append(
            [
                *(c.name, c.after.unit or MISSING, shown(before, 7), shown(after, 7), shown(after - before)),
                *(*deviation, shown(lower), shown(upper), _state(c)),
            ]
        )
    return table(head, rows, words=2, class_="wide")


def _breakpoints(report: ReportData) -> list[Html] | None:
    """Return the table of fitted breakpoints, with their standard deviations."""
    trust, rows = report.trust, []
    for key, axis in report.problem.free_axes.items() if report.result is not None else ():
        name = f"axis {key}" if str(key) in report.problem.parameters else str(key)
        place, which = axis.places[0]
        after = report.parameters[place].axes[which].breakpoints
        if after.size != len(axis.axis):
            continue
        deviation, samples = trust.deviation.get(name), trust.samples.get(name)
        for i, (old, new) in enumerate(zip(axis.axis.breakpoints, after, strict=True)):
            known = deviation is not None and np.size(deviation) == after.size
            rows.append(
                [
                    *(name, str(i + 1), axis.axis.unit or MISSING, shown(old, 6), shown(new, 6), shown(new - old)),
                    _deviation(float(deviation[i])) if known and deviation is not None else MISSING,
                    MISSING if samples is None or np.size(samples) != after.size else str(int(samples[i])),
                ]
            )
    head = ["axis", "breakpoint", "unit", "before", "after", "change", "std deviation", "samples"]
    return [element("h4", "Breakpoints"), table(head, rows, words=1, class_="wide")] if rows else None


def _deviation(value: float) -> str:
    return "not determined" if np.isinf(value) else shown(value, 3)


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
        open_=number < OPEN_PARTS,
        class_="part card",
        id=f"parameter-{number}",
    )


def _fixed_table(report: ReportData, names: Sequence[str]) -> Html:
    rows = []
    for name in names:
        p = report.parameters[name]
        size = "x".join(map(str, p.values.shape)) or "1"
        rows.append([name, p.kind, p.unit or MISSING, size, _range(p)])
    return table(["parameter", "kind", "unit", "values", "value"], rows, words=3)


def _range(parameter: Parameter) -> str:
    low, high = float(parameter.values.min()), float(parameter.values.max())
    return shown(low, 6) if low == high else f"{shown(low)} to {shown(high)}"
