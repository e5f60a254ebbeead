"""Comparison of translated Python functions with Python itself."""

import math

import numpy as np

from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.function_files import read_function_file
from kennfeld.models.model_function import as_model


def translated(text, folder, columns):
    """Return the results of `f` of a file for columns of its arguments; it must be translated."""
    (folder / "f.py").write_text(text)
    function = read_function_file("f.py:f", folder)
    assert not any("cannot be translated" in remark.message for remark in function.remarks)
    names = [item.name for item in function.inputs]
    arrays = {name: np.asarray(columns[name], dtype=float) for name in names}
    (result,) = as_model(function).graph.outputs
    values = evaluate(as_model(function).graph, arrays, ParameterSet())[result]
    return np.broadcast_to(values, len(next(iter(arrays.values()))))


def computed(text, columns):
    """Return the results of `f` by Python, NaN for exceptions."""
    names = {}
    exec(text, names)

    def call(*arguments):
        try:
            return float(names["f"](*arguments))
        except Exception:
            return math.nan

    with np.errstate(all="ignore"):
        rows = np.array(list(columns.values()), dtype=float).T.tolist()
        return np.array([call(*row) for row in rows])
