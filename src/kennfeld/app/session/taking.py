"""Values of another set taken into the present ones, whole or in part, and the tables that have to be taken together.

Two runs may fit equally well with different tables, if one table makes up for another. A part of such a set taken into
the other one ruins both fits, so that the errors after taking are computed first.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field

import numpy as np

from kennfeld.app.session.calibration_source import SourceName, source_of
from kennfeld.app.session.edited_values import fit_onto, moved_breakpoints, with_edits
from kennfeld.app.session.live_model import Evaluation
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet

Cells = Mapping[str, Sequence[int] | None]

WORSE = 1.2  # RMSE over the larger one of both sets from which tables are reported to belong together
TOGETHER = 1.5  # and up to which further tables are looked for
MAX_TRIED = 12  # tables that may belong to the chosen ones, those that differ most


@dataclass(frozen=True, eq=False)
class Taking:
    """Values that are taken.

    Attributes:
        tables: the values after it by parameter, as `SetTables` has them.
        count: number of values that it changes.
    """

    tables: Mapping[str, Float | None]
    count: int


@dataclass(frozen=True, eq=False)
class Belonging:
    """Tables that moved together in a set, so that one of them alone fits neither.

    Attributes:
        names: those that were chosen, and those that make up for them.
        evaluation: with all values of these tables.
        alone: with all values of the chosen tables only.
    """

    names: tuple[str, ...]
    evaluation: Evaluation = field(repr=False)
    alone: Evaluation = field(repr=False)


def values_of(session: Session, name: SourceName, *, onto_present: bool = False) -> ParameterSet:
    """Return the parameters of the project with the values of a set.

    Args:
        session: the open project.
        name: the set.
        onto_present: interpolate to the present breakpoints, also if the set has moved them.

    Raises:
        ArgumentError: there is no such set.
        InputError: the file cannot be read.
    """
    view = session.require_view()
    if str(name.from_) in ("now", "start") and not onto_present:
        return view.now.parameters if name.from_ == "now" else view.start.parameters
    wanted = source_of(session, name).parameters
    # a file may have other breakpoints, and lack tables; runs have those of the project
    if onto_present or name.from_ == "file":
        base = view.now.parameters if onto_present else view.start.parameters
        return base.with_parameters(*(fit_onto(base[each], wanted[each]) for each in _common(session, wanted)))
    tables = {each: wanted[each] for each in _common(session, wanted)}
    values = {each: table.values for each, table in tables.items()} | moved_breakpoints(wanted)
    return with_edits(view.start.parameters, values, tables)[0]


def _common(session: Session, wanted: ParameterSet) -> list[str]:
    """Return the parameters of the function that a set has, too, as the same kind of table."""
    now, common = session.parameters, []
    for name in session.require_view().model.problem.model.graph.parameters:
        try:
            if name in wanted and fit_onto(now[name], wanted[name]) is not None:
                common.append(name)
        except ArgumentError:
            continue
    return common


def take(session: Session, name: SourceName, cells: Cells) -> Taking:
    """Return what taking values of a set into the present ones leads to; nothing is changed.

    Breakpoints that a run has moved are taken with all its values. Otherwise the tables keep theirs.

    Args:
        session: the open project.
        name: the set.
        cells: numbers of the values in C order by parameter, None for all of them; the others stay as they are.

    Raises:
        ArgumentError: there is no such set or parameter.
    """
    now, free = session.parameters, session.require_view().model.problem.free_names
    for each in cells:
        if each not in now:
            raise ArgumentError(f"{each[:100]} is not a parameter of the project")
    if str(name.from_).isdigit() and all(each in cells and cells[each] is None for each in free):
        wanted = values_of(session, name)
        tables = session.values_of(wanted, free)
        return Taking(tables, _count(now, {each: wanted[each].values for each in free}))
    wanted = values_of(session, name, onto_present=True)
    parts = {each: _with_part(now[each].values, wanted[each].values, own) for each, own in cells.items()}
    changed = {each: values for each, values in parts.items() if not np.array_equal(values, now[each].values)}
    return Taking(changed, _count(now, changed))


def _with_part(own: Float, other: Float, cells: Sequence[int] | None) -> Float:
    values = own.ravel().copy()
    part = slice(None) if cells is None else np.array(cells, dtype=np.int64)
    if cells is not None and not all(0 <= cell < values.size for cell in cells):
        raise ArgumentError(f"a table of {values.size} values has no value {max(cells)}")
    values[part] = other.ravel()[part]
    return values.reshape(own.shape)


def _count(now: ParameterSet, tables: Mapping[str, Float]) -> int:
    return sum(
        int(np.count_nonzero(values != now[name].values)) if values.shape == now[name].values.shape else values.size
        for name, values in tables.items()
    )


def evaluate_with(session: Session, tables: Mapping[str, Float | None]) -> Evaluation:
    """Return the model after these values have been taken; nothing is changed."""
    view, state = session.require_view(), session.state
    after = SetTables("", tables).apply(state)
    same = {name: table for name, table in state.tables.items() if after.values.get(name) is state.values.get(name)}
    parameters, _ = with_edits(view.start.parameters, after.values, same)
    return view.model.evaluate(parameters)


def find_belonging(session: Session, name: SourceName, cells: Cells) -> Belonging | None:
    """Return the tables that have to be taken with the chosen ones; None if what is chosen fits about as well alone.

    Tables are added one by one, each time the one that lowers the error most, until the error is about that of the
    present values or of the whole set, the larger of both.

    Args:
        session: the open project.
        name: the set.
        cells: the values that are chosen, see `take`.
    """
    view = session.require_view()
    wanted = values_of(session, name, onto_present=True)
    whole = {each: wanted[each].values for each in _differing(view.now.parameters, wanted)}
    chosen = [each for each in whole if each in cells and cells[each] != ()]
    limits = [view.now, evaluate_with(session, whole)]
    if not chosen or _excess(evaluate_with(session, take(session, name, cells).tables), limits) < WORSE:
        return None
    alone = best = evaluate_with(session, {each: whole[each] for each in chosen})
    names = list(chosen)
    while _excess(best, limits) > TOGETHER and len(names) < len(whole):
        # each trial simulates all data, so that only those that differ most are tried
        others = [each for each in whole if each not in names][:MAX_TRIED]
        trials = {each: evaluate_with(session, {own: whole[own] for own in (*names, each)}) for each in others}
        following = min(trials, key=lambda each: _excess(trials[each], limits))
        if _excess(trials[following], limits) >= _excess(best, limits):
            break
        names.append(following)
        best = trials[following]
    # whole tables may fit where a part of them does not
    helps = _excess(best, limits) < _excess(alone, limits) or _excess(alone, limits) <= TOGETHER
    return Belonging(tuple(names), best, alone) if helps else None


def _differing(now: ParameterSet, wanted: ParameterSet) -> list[str]:
    """Return the tables that differ, the relatively largest difference first."""
    sizes = {}
    for table in now.parameters:
        other = wanted[table.name].values
        # relative to the table, so that its unit does not matter
        scale = max(float(np.abs(table.values).max(initial=0.0)), float(np.abs(other).max(initial=0.0))) or 1.0
        sizes[table.name] = float(np.abs(other - table.values).max(initial=0.0)) / scale
    return sorted((name for name, size in sizes.items() if size > 0), key=lambda name: -sizes[name])


def _excess(evaluation: Evaluation, limits: Collection[Evaluation]) -> float:
    """Return the largest ratio of a training error to the larger one of two evaluations."""
    ratios = [1.0]
    for number, score in enumerate(evaluation.scores):
        if score.use == "training" and score.samples:
            allowed = max(limit.scores[number].rmse for limit in limits)
            ratios.append(score.rmse / allowed if allowed > 0 else (1.0 if score.rmse <= 0 else np.inf))
    return max(ratios)
