"""The editor of one parameter."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.app.answer import Answer, Given, finite_list
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetValues
from kennfeld.domain.parameters import Parameter
from kennfeld.project.model import coordinates_of


def table(session: Session, given: Given) -> Answer:
    """Return the parameter `name`: axes, values now and to compare with, bounds, locks, samples and uncertainty."""
    view, name = session.require_view(), given["name"]
    own, reference = view.now.parameters[name], session.reference(name)
    samples, deviation = view.samples.get(name), session.deviation(name)
    inputs = coordinates_of(view.model.problem.model.graph, name)
    return Answer(
        {
            "table": {
                "name": name,
                "kind": own.kind,
                "unit": own.unit,
                "description": own.description,
                "axes": describe_axes(own, inputs),
                "values": own.values.ravel().tolist(),
                "reference": reference.values.ravel().tolist(),
                "locked": np.flatnonzero(own.locked.ravel()).tolist(),
                "lower": finite_list(own.lower),
                "upper": finite_list(own.upper),
                "samples": None if samples is None else samples.ravel().tolist(),
                "deviation": None if deviation is None else finite_list(deviation),
            }
        }
    )


def describe_axes(table: Parameter, inputs: Sequence[str] = ()) -> list[dict[str, Any]]:
    """Return input, unit and breakpoints of each axis; `inputs` are those of axes that do not name theirs."""
    names = (*inputs, *[""] * len(table.index_axes))
    return [
        {"input": axis.input or name, "unit": axis.unit, "points": axis.breakpoints.tolist()}
        for axis, name in zip(table.index_axes, names, strict=False)
    ]


def set_values(session: Session, given: Given) -> Answer:
    """Set values of the parameter `name`: `cells` are numbers of values in C order."""
    own = session.parameters[given["name"]]
    values = own.values.ravel().copy()
    values[np.array(given["cells"], dtype=np.int64)] = np.array(given["values"], dtype=np.float64)
    session.do(SetValues(given["title"], given["name"], values.reshape(own.values.shape)), str(given.get("drag", "")))
    return Answer()
