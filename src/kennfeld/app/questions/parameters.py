"""The editor of one parameter."""

import numpy as np

from kennfeld.app.answer import Answer, Given, finite_list
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetValues
from kennfeld.project.model import coordinates_of


def table(session: Session, given: Given) -> Answer:
    """Return the parameter `name`: axes, values now and to compare with, bounds, locks, samples and uncertainty."""
    view, name = session.require_view(), given["name"]
    own, reference = view.now.parameters[name], session.reference(name)
    samples, deviation = view.samples.get(name), session.deviation(name)
    inputs = [*coordinates_of(view.model.problem.model.graph, name), *([""] * 4)]
    return Answer(
        {
            "table": {
                "name": name,
                "kind": own.kind,
                "unit": own.unit,
                "description": own.description,
                "axes": [
                    {"input": a.input or inputs[i], "unit": a.unit, "points": a.breakpoints.tolist()}
                    for i, a in enumerate(own.index_axes)
                ],
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


def set_values(session: Session, given: Given) -> Answer:
    """Set values of the parameter `name`: `cells` are numbers of values in C order."""
    own = session.parameters[given["name"]]
    values = own.values.ravel().copy()
    values[np.array(given["cells"], dtype=np.int64)] = np.array(given["values"], dtype=np.float64)
    session.do(SetValues(given["title"], given["name"], values.reshape(own.values.shape)), str(given.get("drag", "")))
    return Answer()
