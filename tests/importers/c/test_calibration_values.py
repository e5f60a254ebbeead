"""Calibration values in C code as parameters, with exact derivatives."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import formula
from kennfeld.models.function_files import read_function_file
from kennfeld.models.model_function import as_model

pytest.importorskip("pycparser")
TEXT = """
    const volatile float K = 2.0f;
    const volatile struct { double offset; double map[2][3]; } CAL = { 0.5, { { 1, 2, 3 }, { 4, 5, 6 } } };
    volatile const unsigned char MODE = 1;
    static const double PLACES[3] = { 0.0, 1.0, 2.0 };
    static double look(double u, const double *x, const volatile double y[3])
    {
        int i = u > x[1] ? 1 : 0;
        return y[i] + (u - x[i]) / (x[i + 1] - x[i]) * (y[i + 1] - y[i]);
    }
    double step(double u, unsigned char gear)
    {
        double row[3];
        int i;
        for (i = 0; i < 3; i++) { row[i] = CAL.map[gear & 1][i]; }
        return MODE ? K * look(u, PLACES, row) + CAL.offset : 0.0;
    }
"""


@pytest.fixture
def model(tmp_path):
    (tmp_path / "f.c").write_text(TEXT)
    return as_model(read_function_file("f.c:step", tmp_path))


def _columns(count=400):
    rng = np.random.default_rng(5)
    return {"u": rng.uniform(0.0, 2.0, count), "gear": rng.integers(0, 2, count).astype(float)}


def _expected(columns, gain, offset, table):
    rows = np.asarray(table)[columns["gear"].astype(int)]
    values = [np.interp(u, [0.0, 1.0, 2.0], row) for u, row in zip(columns["u"], rows, strict=True)]
    return gain * np.array(values) + offset


def test_volatile_constants_are_parameters_with_the_values_of_the_file(model):
    assert list(model.values) == ["K", "CAL.offset", "CAL.map", "MODE"]
    np.testing.assert_array_equal(model.values["CAL.map"].values, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(model.values["CAL.map"].axes[1].breakpoints, [0.0, 1.0, 2.0])
    columns = _columns()
    result = evaluate(model.graph, columns, model.values)["step"]
    np.testing.assert_allclose(result, _expected(columns, 2.0, 0.5, [[1, 2, 3], [4, 5, 6]]), rtol=1e-14)


def test_integers_keep_their_values_unless_a_project_frees_them(model):
    assert model.values["MODE"].locked.all()
    assert not np.any(model.values["K"].locked)


def test_a_calibration_finds_the_values_of_a_table_in_c(model):
    columns, table = _columns(), np.array([[3.0, 1.0, 4.0], [1.5, 9.0, 2.6]])
    data = kf.Dataset.of("bench", {**columns, "y": _expected(columns, 2.0, 0.25, table)})
    start = kf.ParameterSet(p.changed(locked=p.locked | (p.name == "K")) for p in model.values.parameters)
    result = kf.calibrate(model, data, start, "y", node="step")
    np.testing.assert_allclose(
        result.parameters["CAL.map"].values + result.parameters["CAL.offset"].values / 2, table + 0.125, rtol=1e-6
    )


def test_calls_in_formula_text_prefix_the_names(tmp_path):
    (tmp_path / "f.c").write_text(TEXT)
    function = read_function_file("f.c:step", tmp_path, "f")
    assert list(function.values) == ["f.K", "f.CAL.offset", "f.CAL.map", "f.MODE"]
    text = formula("y = 2 * f(u, gear)", functions=[function])
    columns = _columns()
    expected = 2 * _expected(columns, 2.0, 0.5, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(evaluate(text.graph, columns, function.values)["y"], expected, rtol=1e-14)
