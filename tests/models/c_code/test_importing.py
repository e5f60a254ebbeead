"""C functions as models and in formula text, and what is said about those that cannot be read."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.errors import InputError
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import formula
from kennfeld.models.function_files import read_function_file
from kennfeld.parameter_set import ParameterSet
from kennfeld.project.demo import exhaust

pytest.importorskip("pycparser")

LAG = """\
/* The thermocouple of the exhaust model: a lag of first order. */
double lag(double settled, double constant, double dt)
{
    static int started = 0;
    static double temperature;
    if (!started) {
        temperature = settled;
        started = 1;
    }
    temperature += dt / (constant + dt) * (settled - temperature);
    return temperature;
}
"""


def _problems(text, tmp_path, name="step"):
    (tmp_path / "f.c").write_text(text)
    with pytest.raises(InputError) as error:
        read_function_file(f"f.c:{name}", tmp_path)
    return str(error.value)


def test_the_exhaust_model_in_c_calibrates_to_the_parameters_of_the_formula(tmp_path):
    (tmp_path / "lag.c").write_text(LAG)
    function = read_function_file("lag.c:lag", tmp_path)
    text = exhaust.FORMULA.replace(
        "PT1(settled, CurveTimeConstant(AirMass))", "lag(settled, CurveTimeConstant(AirMass), dt)"
    )
    start, data = exhaust.start(), exhaust._record("drive", 3000, 0, "training")
    names = list(exhaust.SMOOTHNESS)
    models = [formula(exhaust.FORMULA, parameters=names), formula(text, parameters=names, functions=[function])]
    results = [
        kf.calibrate(model, data, start, "Temperature", node="TemperaturePredict", smoothness=exhaust.SMOOTHNESS)
        for model in models
    ]
    for name in names:
        expected, values = (result.parameters[name].values for result in results)
        np.testing.assert_allclose(values, expected, rtol=1e-6)


def test_each_call_has_states_of_its_own(tmp_path):
    (tmp_path / "count.c").write_text("double count(double x) { static int n; n += 1; return n * x; }")
    function = read_function_file("count.c:count", tmp_path)
    model = formula("y = count(u) + count(2 * u)", functions=[function])
    columns = {"u": np.array([1.0, 2.0, 3.0])}
    np.testing.assert_array_equal(evaluate(model.graph, columns, ParameterSet())["y"], [3.0, 12.0, 27.0])
    assert function.memory


def test_all_problems_are_reported_at_once_with_their_lines(tmp_path):
    text = "double step(double x) {\n  goto end;\n  x = unknown(x);\n  x = y;\n  end: return x;\n}\n"
    message = _problems(text, tmp_path)
    assert "f.c line 2: goto is not supported" in message
    assert "f.c line 3: unknown function unknown" in message
    assert "f.c line 4: unknown name y" in message


def test_a_wrong_name_is_answered_with_the_functions_of_the_file(tmp_path):
    assert "Did you mean step?" in _problems("double step(double x) { return x; }", tmp_path, "stepp")


def test_an_output_that_is_not_assigned_in_every_case_is_an_error(tmp_path):
    message = _problems("void step(double x, double *y) { if (x > 0) *y = x; }", tmp_path)
    assert "not assigned in every case" in message


def test_text_that_is_not_c_is_reported_with_its_line(tmp_path):
    assert "f.c line 2" in _problems("double step(double x) {\n  return x +;\n}", tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "double step(double x) { return " + "(" * 5000 + "x" + ")" * 5000 + "; }",
        "double step(double x) { return " + "-" * 20000 + "x; }",
        "double step(double x) { return x" + " + x" * 20000 + "; }",
        "#define A A A\ndouble step(double x) { return A; }",
        "double step(double x) { while (1) x = x + 1; return x; }",
        "double step(double x) { while (x > 0) x = x - 1; return x; }",
        "double step(double x) { double a[1000000]; return x; }",
        "double step(double x) { int n = 99999999999999999999999999999999; return x; }",
        "double step(double x) { return step(x); }",
        "#if 1\ndouble step(double x) { return x; }",
        "/* never closed",
        "\x01\x02",
        "",
    ],
)
def test_hostile_text_is_refused(text, tmp_path):
    assert _problems(text, tmp_path)
