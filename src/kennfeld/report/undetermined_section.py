"""The sections on what the data leave open, and on the limits that hold.

Where surrogates are used outside the data they were trained on, as a table.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.analysis import active_constraints, output_ranges
from kennfeld.arrays import Bool
from kennfeld.constraints import Equality
from kennfeld.parameters import Parameter
from kennfeld.report.markup import MISSING, Html, element, percent, recorded, shown, table
from kennfeld.report.pieces import MOST_LISTED, note
from kennfeld.report.report_data import ParameterChange, ReportData

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation

__all__ = ["limits", "undetermined"]

HEAD = ("surrogate", "dataset", "use", "farthest outside its data", "samples", "outside", "share")


def extrapolation_table(found: "Sequence[Extrapolation]") -> Html | None:
    """A row for each surrogate and dataset; None where there is none."""
    return table(HEAD, [_row(row) for row in found], words=4, class_="wide") if found else None


def _row(row: "Extrapolation") -> list[str]:
    counts = (MISSING, MISSING) if row.outside is None else (str(row.outside), percent(row.share))
    farthest = MISSING if row.worst is None else f"{row.place}: {row.worst.sentence}"
    return [row.name, row.dataset, row.use, farthest, str(row.samples), *counts]


def undetermined(subject: ReportData) -> Html:
    """What the data leave open, in words and counted."""
    trust = subject.trust
    told = [*([trust.null_space] if trust.null_space else []), *trust.directions]
    lines = [element("li", element("b", d.sentence), f" {d.remedy}") for d in told]
    rows = [
        [c.name, str(c.after.size), *(_known_count(x) for x in _states_of(c))]
        for c in subject.changes
        if any(x is not None and np.any(x) for x in _states_of(c))
    ]
    head = ["parameter", "values", "without training data", "held by smoothness alone", "held by nothing: start kept"]
    nothing = "Every value is informed by training data." if not rows else None
    return element(
        "div",
        note(trust.remark) if trust.remark else None,
        element("ul", lines, class_="directions") if lines else None,
        table(head, rows, class_="wide") if rows else None,
        note(nothing) if nothing else None,
        extrapolation_table(subject.left),
    )


def _states_of(change: ParameterChange) -> tuple[Bool, Bool | None, Bool | None]:
    kept = None if change.informed is None else ~change.informed
    return change.uncovered, change.by_smoothness, kept


def _known_count(marked: Bool | None) -> str:
    return MISSING if marked is None else str(int(np.count_nonzero(marked)))


def limits(subject: ReportData) -> Html:
    """Bounds, locks, pins and limits that hold at the end, and limited outputs."""
    rows = []
    for c in subject.changes:
        for side, word in ((-1, "lower"), (1, "upper")):
            at = np.argwhere(c.bound == side)
            if len(at):
                limit = (c.after.lower if side < 0 else c.after.upper)[c.bound == side]
                text = shown(float(limit[0])) if limit.min() == limit.max() else "of each value"
                rows.append([c.name, f"{word} bound {text}", str(len(at)), _places(c.after, at)])
        if c.after.locked.any():
            at = np.argwhere(c.after.locked)
            rows.append([c.name, "locked", str(len(at)), _places(c.after, at)])
    rows += _linear(subject)
    outputs = _outputs(subject)
    held = [element("li", sentence) for sentence in subject.trust.holdings]
    if not rows and not outputs and not held:
        return note("No value lies at a bound, and nothing is locked or pinned.")
    linear = table(["parameter", "limit", "values", "where"], rows, words=4, class_="where") if rows else None
    return element("div", linear, outputs, element("ul", held, class_="directions") if held else None)


def _linear(subject: ReportData) -> Iterator[list[str]]:
    """Pins, and the shapes and equalities that press."""
    for pin in subject.problem.pins:
        where = ", ".join(recorded(x) for x in pin.at)
        yield [pin.parameter, f"pinned to {recorded(pin.value)}", "1", f"at {where}" if where else ""]
    for held in active_constraints(subject.problem, subject.parameters):
        constraint = held.constraint
        if isinstance(constraint, Equality):
            names = ", ".join(dict.fromkeys(term.parameter for term in constraint.terms))
            yield [names, f"equality {constraint}", "", ""]
        elif held.active:
            axis = "xyzw"[constraint.axis]
            ends = f"from {recorded(constraint.lower)} to {recorded(constraint.upper)}"
            prefix = f"{constraint.kind} of {constraint.parameter} along {axis} "
            listed = "; ".join(name.removeprefix(prefix) for name in held.active[:MOST_LISTED])
            more = f" and {len(held.active) - MOST_LISTED} more" if len(held.active) > MOST_LISTED else ""
            limit = f"{constraint.kind} along {axis} {ends}"
            yield [constraint.parameter, limit, f"{len(held.active)} of {held.rows}", listed + more]


def _outputs(subject: ReportData) -> Html | None:
    """How far the limited outputs come to their limits."""
    before = output_ranges(subject.problem, subject.problem.parameters)
    after = output_ranges(subject.problem, subject.parameters)
    rows = [
        [
            new.limit.node,
            f"{recorded(new.limit.lower)} to {recorded(new.limit.upper)}",
            new.limit.where or "everywhere",
            str(new.samples),
            *(f"{shown(one.least)} to {shown(one.greatest)}" for one in (old, new)),
            *(str(one.beyond) for one in (old, new)),
        ]
        for old, new in zip(before, after, strict=True)
    ]
    head = ["output", "limit", "where", "samples", "range before", "range after", "beyond before", "beyond after"]
    return table(head, rows, words=3, class_="wide") if rows else None


def _places(parameter: Parameter, at: Any) -> str:
    """Coordinates of grid points, the first few."""
    axes = parameter.index_axes
    listed = [", ".join(recorded(float(a.breakpoints[i])) for a, i in zip(axes, point, strict=True)) for point in at]
    if not axes:
        return ""
    more = f" and {len(listed) - MOST_LISTED} more" if len(listed) > MOST_LISTED else ""
    return "; ".join(listed[:MOST_LISTED]) + more
