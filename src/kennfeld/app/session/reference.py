"""The values that the present ones are compared with: by default those of the last run, or of the start."""

import numpy as np

from kennfeld.app.session.calibration_source import SourceName, source_of
from kennfeld.app.session.edited_values import fit_onto
from kennfeld.app.session.reference_set import ReferenceSet
from kennfeld.app.session.session import Session
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Parameter


@dataclass(frozen=True, eq=False)
class ReferenceTable:
    """The values that a table is compared with, on its present breakpoints, and in words where they are from."""

    values: Float
    title: str


def choose_reference(session: Session, name: SourceName | None) -> None:
    """Choose the set that the present values are compared with; None takes the last run, or the start.

    Raises:
        ArgumentError: there is no such set.
        InputError: the file cannot be read.
    """
    if name is None:
        session.compare_with(None)
        return
    origin, source = str(name.from_), source_of(session, name)
    if origin == "now":
        raise ArgumentError("the present values cannot be compared with themselves")
    key = f"file:{name.file}" if origin == "file" else origin
    session.compare_with(ReferenceSet(key, source.label, source.parameters))


def reference_set(session: Session) -> ReferenceSet:
    """Return the set that is chosen, or else the last run, or the start if there was none."""
    chosen, start = session.chosen_reference, session.require_view().start.parameters
    if chosen is not None and chosen.key != "start":
        return chosen
    if chosen is not None or not session.runs:
        return ReferenceSet("start", "start", start)  # that of now: initial files may have changed since it was chosen
    run = session.runs[-1]
    return ReferenceSet(str(run.number), f"run {run.number}", run.result.parameters)


def reference_table(session: Session, name: str, chosen: ReferenceSet) -> ReferenceTable:
    """Return the values that a parameter is compared with.

    Values on other breakpoints are interpolated. A parameter that the set lacks, or has as another kind of table, is
    compared with the start; the title says so.
    """
    own, other = session.parameters[name], chosen.parameters.get(name)
    if other is not None and other.has_grid_of(own):
        return ReferenceTable(other.values, chosen.title)
    start = session.require_view().start.parameters[name]
    by_default = session.chosen_reference is None
    if other is None or by_default:
        # a run before other breakpoints says nothing about these
        return ReferenceTable(start.values, "start" if by_default else f"start, as {chosen.title} lacks it")
    try:
        return ReferenceTable(fit_onto(own, other).values, f"{chosen.title}, interpolated")
    except ArgumentError:
        return ReferenceTable(start.values, f"start, as {chosen.title} has another kind of table")


def deviation_of(session: Session, name: str) -> Float | None:
    """Return the standard deviation of the values of a parameter after the last fit of all values.

    None if it is unknown. A fit of a part holds the other values, and says nothing about them.
    """
    last = session.last_whole_run
    if last is None or name not in last.result.parameters:
        return None
    same = last.result.parameters[name].has_grid_of(session.parameters[name])
    return last.result.trust.deviation.get(name) if same else None


def relative_change(own: Parameter, reference: Float) -> float:
    """Return the largest change of a value, relative to the largest value of both."""
    if not own.size:
        return 0.0
    scale = max(float(np.abs(own.values).max()), float(np.abs(reference).max())) or 1.0
    return float(np.abs(own.values - reference).max()) / scale


def relative_deviation(own: Parameter, deviation: Float | None) -> float | None:
    """Return the median standard deviation of the fitted values, relative to the span of the table.

    Infinite if most of them are undetermined; None if it is unknown, or nothing of the table was fitted.
    """
    if deviation is None:
        return None
    fitted = deviation[(deviation > 0) & ~np.isnan(deviation)]
    if not fitted.size:
        return None
    span = float(np.ptp(own.values)) or float(np.abs(own.values).max()) or 1.0
    return float(np.median(fitted)) / span
