"""Report sections of undetermined parameters, extrapolating surrogates and active limits."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.analysis.limit_margins import active_constraints, output_ranges
from kennfeld.arrays import Bool
from kennfeld.constraints import Equality
from kennfeld.formatting import join_names
from kennfeld.parameters import Parameter
from kennfeld.report.markup import MISSING, Html, element, percent, recorded, shown, table
from kennfeld.report.pieces import MAX_LISTED, note
from kennfeld.report.report_data import ParameterChange, ReportData

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation


HEAD = ("surrogate", "dataset", "use", "farthest outside its data", "samples", "outside", "share")


def undetermined(report: ReportData) -> Html:
    """Return the undetermined and poorly determined directions, and a table of the values concerned."""
    trust = report.trust
    directions = [*([trust.null_space] if trust.null_space else []), *trust.directions]
    lines = [element("li", element("b", d.sentence), f" {d.remedy}") for d in directions]
    rows = [
        [c.name, str(c.after.size), *(_known_count(x) for x in _states(c))]
        for c in report.changes
        if any(x is not None and np.any(x) for x in _states(c))
    ]
    head = ["parameter", "values", "without training data", "by smoothness alone", "undetermined: start kept"]
    return element(
        "div",
        note(trust.remark) if trust.remark else None,
        element("ul", lines, class_="directions") if lines else None,
        table(head, rows, class_="wide") if rows else note("Every value is determined by training data."),
        _extrapolation_table(report.extrapolation),
    )


def _extrapolation_table(extrapolation: "Sequence[Extrapolation]") -> Html | None:
    rows = [_extrapolation_row(row) for row in extrapolation]
    return table(HEAD, rows, words=4, class_="wide") if rows else None


def _extrapolation_row(row: "Extrapolation") -> list[str]:
    counts = (MISSING, MISSING) if row.outside is None else (str(row.outside), percent(row.share))
    farthest = MISSING if row.worst is None else f"{row.place}: {row.worst.sentence}"
    return [row.name, row.dataset, row.use, farthest, str(row.samples), *counts]


def _states(change: ParameterChange) -> tuple[Bool, Bool | None, Bool | None]:
    kept = None if change.informed is None else ~change.informed
    return change.uncovered, change.by_smoothness, kept


def _known_count(marked: Bool | None) -> str:
    return MISSING if marked is None else str(int(np.count_nonzero(marked)))


def limits(report: ReportData) -> Html:
    """Return the bounds, locks, pins, constraints and output limits that are active at the end."""
    rows = []
    for c in report.changes:
        for side, word in ((-1, "lower"), (1, "upper")):
            at = np.argwhere(c.bound == side)
            if len(at):
                limit = (c.after.lower if side < 0 else c.after.upper)[c.bound == side]
                text = shown(float(limit[0])) if limit.min() == limit.max() else "of each value"
                rows.append([c.name, f"{word} bound {text}", str(len(at)), _places(c.after, at)])
        if c.after.locked.any():
            at = np.argwhere(c.after.locked)
            rows.append([c.name, "locked", str(len(at)), _places(c.after, at)])
    rows += _linear(report)
    outputs = _outputs(report)
    held = [element("li", sentence) for sentence in report.trust.holdings]
    if not rows and not outputs and not held:
        return note("No value is at a bound, locked or pinned.")
    linear = table(["parameter", "limit", "values", "where"], rows, words=4, class_="where") if rows else None
    return element("div", linear, outputs, element("ul", held, class_="directions") if held else None)


def _linear(report: ReportData) -> Iterator[list[str]]:
    """Return rows of pins, equalities and active shape constraints."""
    for pin in report.problem.pins:
        where = ", ".join(recorded(x) for x in pin.at)
        yield [pin.parameter, f"pinned to {recorded(pin.value)}", "1", f"at {where}" if where else ""]
    for held in active_constraints(report.problem, report.parameters):
        constraint = held.constraint
        if isinstance(constraint, Equality):
            names = ", ".join(dict.fromkeys(term.parameter for term in constraint.terms))
            yield [names, f"equality {constraint}", "", ""]
        elif held.active:
            axis = "xyzw"[constraint.axis]
            ends = f"from {recorded(constraint.lower)} to {recorded(constraint.upper)}"
            prefix = f"{constraint.kind} of {constraint.parameter} along {axis} "
            limit = f"{constraint.kind} along {axis} {ends}"
            places = join_names([name.removeprefix(prefix) for name in held.active], MAX_LISTED, "; ")
            yield [constraint.parameter, limit, f"{len(held.active)} of {held.rows}", places]


def _outputs(report: ReportData) -> Html | None:
    """Return the ranges of the limited outputs before and after."""
    before = output_ranges(report.problem, report.problem.parameters)
    after = output_ranges(report.problem, report.parameters)
    rows = [
        [
            new.limit.node,
            f"{recorded(new.limit.lower)} to {recorded(new.limit.upper)}",
            new.limit.where or "everywhere",
            str(new.samples),
            *(f"{shown(reached.least)} to {shown(reached.greatest)}" for reached in (old, new)),
            *(str(reached.beyond) for reached in (old, new)),
        ]
        for old, new in zip(before, after, strict=True)
    ]
    head = ["output", "limit", "where", "samples", "range before", "range after", "beyond before", "beyond after"]
    return table(head, rows, words=3, class_="wide") if rows else None


def _places(parameter: Parameter, at: Any) -> str:
    axes = parameter.index_axes
    points = [", ".join(recorded(float(a.breakpoints[i])) for a, i in zip(axes, point, strict=True)) for point in at]
    return join_names(points, MAX_LISTED, "; ") if axes else ""
