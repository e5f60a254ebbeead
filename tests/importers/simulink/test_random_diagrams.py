"""Random block diagrams: their signals against the same arithmetic in NumPy, and against their formula text."""

import numpy as np
import pytest

from kennfeld.importers.simulink.formula_export import formula_lines
from kennfeld.models.formula import formula
from tests.draws import mostly_slow
from tests.importers.simulink.random_diagrams import COLUMNS, Diagram
from tests.importers.simulink.simulink_runs import imported, run

RNG = np.random.default_rng(1)
INPUTS = {name: np.round(RNG.normal(0, 3, 14), 2) for name in COLUMNS}


@pytest.mark.parametrize("seed", mostly_slow(range(100), 5))
def test_a_diagram_of_type_single_computes_what_floats_of_numpy_compute(seed, tmp_path):
    drawn = Diagram(seed, single=True)
    model = imported(drawn.model, tmp_path, float32=True)
    values = run(model, INPUTS)
    for name, expected in drawn.outputs(INPUTS).items():
        np.testing.assert_array_equal(values[f"y{name}" if f"y{name}" in values else name], expected, err_msg=name)
    assert_text_computes(values, model)


@pytest.mark.parametrize("seed", mostly_slow(range(100), 5))
def test_a_diagram_of_type_double_computes_what_doubles_of_numpy_compute(seed, tmp_path):
    drawn = Diagram(seed, single=False)
    model = imported(drawn.model, tmp_path)
    values = run(model, INPUTS)
    for name, expected in drawn.outputs(INPUTS).items():
        np.testing.assert_allclose(values[f"y{name}"], expected, rtol=1e-10, atol=1e-12, err_msg=name)
    assert_text_computes(values, model)


def assert_text_computes(values, model):
    """The formula text of a model, read again, computes the values of its outputs bit for bit."""
    text = "\n".join(line.text for line in formula_lines(model))
    read = formula(text, parameters=model.values)
    assert set(model.graph.outputs) <= set(read.graph.names)
    again = run(read, INPUTS)
    for name in model.graph.outputs:
        np.testing.assert_array_equal(again[name], values[name], err_msg=name)
