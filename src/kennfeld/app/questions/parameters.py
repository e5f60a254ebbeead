"""The editor of one parameter."""

from collections.abc import Sequence

import numpy as np

from kennfeld.app.answer import finite_list
from kennfeld.app.session.session import Session
from kennfeld.app.session.value_edits import ValueEdit
from kennfeld.base.lazy_dataclass import dataclass
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
        locked: numbers of values that are not fitted.
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
    locked: Sequence[int]
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
    own, reference = view.now.parameters[name], session.reference(name)
    samples, deviation = view.samples.get(name), session.deviation(name)
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
            locked=np.flatnonzero(own.locked.ravel()).tolist(),
            waiting=sorted({cell for edit in session.waiting if edit.name == name for cell in edit.cells}),
            lower=finite_list(own.lower),
            upper=finite_list(own.upper),
            samples=None if samples is None else samples.ravel().tolist(),
            deviation=None if deviation is None else finite_list(deviation),
        )
    )


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
