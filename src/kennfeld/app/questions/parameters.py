"""The editor of one parameter."""

from collections.abc import Sequence

import numpy as np

from kennfeld.app.answer import finite_list
from kennfeld.app.session.calibration_source import SourceName
from kennfeld.app.session.cell_keys import lock_changes, pin_changes, pinned_cells
from kennfeld.app.session.reference import choose_reference as choose
from kennfeld.app.session.reference import deviation_of, reference_set, reference_table
from kennfeld.app.session.session import Session
from kennfeld.app.session.value_edits import ValueEdit, require_cells
from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.graph.traversal import coordinates_of


@dataclass(frozen=True)
class AskedTable:
    """A parameter by its name."""

    name: str


@dataclass(frozen=True)
class AxisPoints:
    """An axis of a table: its input, unit and breakpoints."""

    input: str
    unit: str
    points: Sequence[float]


@dataclass(frozen=True)
class EditedTable:
    """A parameter as the editor shows it; lists are in C order: `values[i * ny + j]` is at x[i], y[j].

    Attributes:
        reference: values to compare with.
        reference_title: where these are from.
        locked: numbers of values that are not fitted.
        pinned: numbers of values that a pin holds.
        waiting: numbers of values whose edits wait for the end of a run.
        samples: number of samples that inform each value; null if it is not known.
        deviation: standard deviation of each value; null if it is not known.
    """

    name: str
    kind: str
    unit: str
    description: str
    axes: Sequence[AxisPoints]
    values: Sequence[float]
    reference: Sequence[float]
    reference_title: str
    locked: Sequence[int]
    pinned: Sequence[int]
    waiting: Sequence[int]
    lower: Sequence[float | None]
    upper: Sequence[float | None]
    samples: Sequence[int] | None
    deviation: Sequence[float | None] | None


@dataclass(frozen=True)
class TableReply:
    """The parameter that was asked for."""

    table: EditedTable


def table(session: Session, asked: AskedTable) -> TableReply:
    """Return a parameter: axes, values now and to compare with, bounds, locks, samples and uncertainty."""
    view, name = session.require_view(), asked.name
    own, reference = view.now.parameters[name], reference_table(session, name, reference_set(session))
    samples, deviation = view.samples.get(name), deviation_of(session, name)
    inputs = coordinates_of(view.model.problem.model.graph, name)
    return TableReply(
        EditedTable(
            name=name,
            kind=own.kind,
            unit=own.unit,
            description=own.description,
            axes=describe_axes(own, inputs),
            values=own.values.ravel().tolist(),
            reference=reference.values.ravel().tolist(),
            reference_title=reference.title,
            locked=np.flatnonzero(own.locked.ravel()).tolist(),
            pinned=pinned_cells(session.settings, own),
            waiting=sorted({cell for edit in session.waiting if edit.name == name for cell in edit.cells}),
            lower=finite_list(own.lower),
            upper=finite_list(own.upper),
            samples=None if samples is None else samples.ravel().tolist(),
            deviation=None if deviation is None else finite_list(deviation),
        )
    )


@dataclass(frozen=True)
class ChosenReference:
    """The set to compare with; null takes the last run, or the start."""

    source: SourceName | None = None


@dataclass(frozen=True)
class CellMark:
    """Values of a parameter that are locked or pinned, or not any more, by their numbers in C order."""

    name: str
    cells: Sequence[int]
    on: bool
    title: str


def describe_axes(table: Parameter, inputs: Sequence[str] = ()) -> list[AxisPoints]:
    """Return input, unit and breakpoints of each axis; `inputs` are those of axes that do not name theirs."""
    names = (*inputs, *[""] * len(table.index_axes))
    return [
        AxisPoints(axis.input or name, axis.unit, axis.breakpoints.tolist())
        for axis, name in zip(table.index_axes, names, strict=False)
    ]


def set_values(session: Session, edit: ValueEdit) -> None:
    """Edit values of a parameter; during a calibration the edit waits for its end."""
    session.edit(edit)


def choose_reference(session: Session, asked: ChosenReference) -> None:
    """Choose the set that the present values are compared with."""
    choose(session, asked.source)


def lock_values(session: Session, asked: CellMark) -> None:
    """Lock values of a parameter, or unlock them, in the project file."""
    table = _table_of(session, asked, session.require_view().model.problem.parameters)
    where = np.zeros(table.size, dtype=bool)
    where[np.array(asked.cells, dtype=np.int64)] = True
    changes = lock_changes(session.settings, table, where.reshape(table.values.shape), locked=asked.on)
    session.do(session.key_command(asked.title, changes))


def pin_values(session: Session, asked: CellMark) -> None:
    """Pin values of a parameter to the present ones, or remove their pins, in the project file."""
    table = _table_of(session, asked, session.parameters)
    if asked.on and asked.name not in session.require_view().model.problem.free_names:
        raise ArgumentError(f"{asked.name} is fixed: set it free to pin values of it")
    changes = pin_changes(session.settings, table, asked.cells, pinned=asked.on)
    session.do(session.key_command(asked.title, changes))


def _table_of(session: Session, asked: CellMark, parameters: ParameterSet) -> Parameter:
    if asked.name not in parameters:
        raise ArgumentError(f"{asked.name[:100]} is not a parameter of the project")
    table = parameters[asked.name]
    require_cells(table, asked.cells)
    return table
