"""Report sections of undetermined parameters, extrapolating surrogates and active limits."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.analysis.extrapolation import Extrapolation
from kennfeld.analysis.limit_margins import active_constraints, output_ranges
from kennfeld.base.formatting import join_names
from kennfeld.base.markup import MISSING, Html, decimal, element, full_decimal, note, percent, table
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.constraints import Equality
from kennfeld.domain.parameters import Parameter
from kennfeld.report.report_data import ReportData

if TYPE_CHECKING:
    from kennfeld.surrogate.surrogate_file import Surrogate

SETTLE = (
    "kennfeld design PROJECT --direction 1 finds the points that settle the first of the directions, 2 the second, or "
    "says that no point does, and what does."
)
MAX_LISTED = 8  # values in a row


def render_undetermined(report: ReportData) -> Html:
    """Return the undetermined and poorly determined directions, a table of the values concerned, and coupled ones."""
    trust = report.trust
    directions = [*([trust.null_space] if trust.null_space else []), *trust.directions]
    lines = [element("li", element("b", d.sentence), f" {d.remedy}") for d in directions]
    rows = []
    for c in report.changes:
        marks = (c.uncovered, c.by_smoothness, None if c.informed is None else ~c.informed)
        counts = [None if mark is None else int(np.count_nonzero(mark)) for mark in marks]
        if any(counts):
            rows.append([c.name, str(c.after.size), *(MISSING if n is None else str(n) for n in counts)])
    head = ["parameter", "values", "without training data", "by smoothness alone", "undetermined: start kept"]
    return element(
        "div",
        note(trust.remark) if trust.remark else None,
        element("ul", lines, class_="directions") if lines else None,
        note(SETTLE) if trust.directions else None,
        table(head, rows, class_="wide") if rows else None,
        note("Coupled, but determined:") if trust.coupled else None,
        element("ul", [element("li", sentence) for sentence in trust.coupled], class_="remarks")
        if trust.coupled
        else None,
        None if rows or lines else note("Every value is determined by training data."),
        _extrapolation_table(report.extrapolation) if report.extrapolation else None,
        _surrogate_errors(report.problem.model.surrogates),
    )


def _surrogate_errors(surrogates: Sequence["Surrogate"]) -> Html | None:
    """Return errors of the surrogates on the data of their training, beside linear models, and their deviations."""
    if not surrogates:
        return None
    from kennfeld.surrogate.surrogate_file import deviation_note

    rows = [
        [s.name, q.dataset, q.use, q.mode, str(q.samples), decimal(q.rmse), decimal(q.r2), decimal(q.max_abs)]
        for s in surrogates
        for q in s.quality
    ]
    head = ("surrogate", "dataset", "use", "mode", "samples", "RMSE", "R2", "max |error|")
    deviations = [note(f"{s.name}: {deviation_note(s)}") for s in surrogates]
    return element("div", table(head, rows, words=4, class_="wide") if rows else None, *deviations)


def _extrapolation_table(extrapolation: Sequence[Extrapolation]) -> Html:
    rows = []
    for row in extrapolation:
        farthest = MISSING if row.worst is None else f"{row.place}: {row.worst.sentence}"
        counts = (MISSING, MISSING) if row.outside is None else (str(row.outside), percent(row.share))
        rows.append([row.name, row.dataset, row.use, farthest, str(row.samples), *counts])
    head = ("surrogate", "dataset", "use", "farthest outside its data", "samples", "outside", "share")
    return table(head, rows, words=4, class_="wide")


def render_limits(report: ReportData) -> Html:
    """Return the bounds, locks, pins, constraints and output limits that are active at the end."""
    rows = []
    for c in report.changes:
        for side, word in ((-1, "lower"), (1, "upper")):
            at = np.argwhere(c.bound == side)
            if len(at):
                limit = (c.after.lower if side < 0 else c.after.upper)[c.bound == side]
                text = decimal(float(limit[0])) if limit.min() == limit.max() else "of each value"
                rows.append([c.name, f"{word} bound {text}", str(len(at)), _places(c.after, at)])
        if c.after.locked.any():
            at = np.argwhere(c.after.locked)
            rows.append([c.name, "locked", str(len(at)), _places(c.after, at)])
    rows += _linear(report)
    outputs = _outputs(report)
    sentences = [element("li", sentence) for sentence in report.trust.holdings]
    if not rows and not outputs and not sentences:
        return note("No value is at a bound, locked or pinned.")
    linear = table(["parameter", "limit", "values", "where"], rows, words=4, class_="where") if rows else None
    return element("div", linear, outputs, element("ul", sentences, class_="directions") if sentences else None)


def _linear(report: ReportData) -> Iterator[list[str]]:
    """Return rows of pins, equalities and active shape constraints."""
    for pin in report.problem.pins:
        where = ", ".join(full_decimal(x) for x in pin.at)
        yield [pin.parameter, f"pinned to {full_decimal(pin.value)}", "1", f"at {where}" if where else ""]
    for active in active_constraints(report.problem, report.parameters):
        constraint, labels = active.constraint, active.active
        if isinstance(constraint, Equality):
            names = ", ".join(dict.fromkeys(term.parameter for term in constraint.terms))
            yield [names, f"equality {constraint}", "", ""]
        elif labels:
            axis = AXIS_LETTERS[constraint.axis]
            ends = f"from {full_decimal(constraint.lower)} to {full_decimal(constraint.upper)}"
            # labels begin with what the other cells of the row say
            prefix = f"{constraint.kind} of {constraint.parameter} along {axis} "
            places = join_names([label.removeprefix(prefix) for label in labels], MAX_LISTED, "; ")
            limit = f"{constraint.kind} along {axis} {ends}"
            yield [constraint.parameter, limit, f"{len(labels)} of {active.rows}", places]


def _outputs(report: ReportData) -> Html | None:
    """Return the ranges of the limited outputs before and after."""
    before = output_ranges(report.problem, report.problem.parameters)
    after = output_ranges(report.problem, report.parameters)
    rows = [
        [
            new.limit.node,
            f"{full_decimal(new.limit.lower)} to {full_decimal(new.limit.upper)}",
            new.limit.where or "everywhere",
            str(new.samples),
            *(f"{decimal(reached.least)} to {decimal(reached.greatest)}" for reached in (old, new)),
            *(str(reached.beyond) for reached in (old, new)),
        ]
        for old, new in zip(before, after, strict=True)
    ]
    head = ["output", "limit", "where", "samples", "range before", "range after", "beyond before", "beyond after"]
    return table(head, rows, words=3, class_="wide") if rows else None


def _places(parameter: Parameter, at: Any) -> str:
    breakpoints = [axis.breakpoints for axis in parameter.index_axes]
    points = [", ".join(full_decimal(x[i]) for x, i in zip(breakpoints, point, strict=True)) for point in at]
    return join_names(points, MAX_LISTED, "; ") if breakpoints else ""
