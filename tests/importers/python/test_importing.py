"""Functions in Python as models and in formula text."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import formula
from kennfeld.models.function_files import read_function_file
from kennfeld.models.model_function import FunctionInput, as_model
from kennfeld.project.demo import exhaust

LAG = """\
def lag(settled, before, constant, dt):
    \"\"\"A lag of first order.\"\"\"
    return before + dt / (constant + dt) * (settled - before)


def called(settled, before, constant, dt):
    values = {0: before, 1: dt / (constant + dt) * (settled - before)}
    return sum(values.values())
"""
PROGRAM = """\
import math
import numpy as np
from math import exp as e_to

raise RuntimeError("this file must not run")
GAIN = 2.5


def half(x):
    return x / 2


def step(u, n, offset=-1.5):
    total = 0.0
    for k in range(1, 6, 2):
        if k == 3:
            continue
        total += k * u
    for _ in range(4):
        if total <= 10:
            break
        total = half(total)
    if 0 < u <= 2 and not n == 1:
        total = np.where(n > 2, total, -total)
    elif u > 2:
        total = max(total, n, 3.0)
    first = total + GAIN * math.sin(u) + (n // 2) + (n % 3) + u ** 2 + np.clip(u, -1, 1) + offset
    return first, e_to(-abs(u)) if u < 0 else np.arctan2(u, 2.0)
"""


def _problems(text, tmp_path, name="step"):
    (tmp_path / "f.py").write_text(text)
    with pytest.raises(InputError) as error:
        read_function_file(f"f.py:{name}", tmp_path)
    return str(error.value)


def test_a_function_of_numbers_becomes_a_graph_without_running(tmp_path):
    (tmp_path / "f.py").write_text(PROGRAM)
    function = read_function_file("f.py:step", tmp_path)
    assert function.inputs == (FunctionInput("u"), FunctionInput("n"), FunctionInput("offset", default=-1.5))
    assert not function.remarks
    rng = np.random.default_rng(1)
    u, n = rng.normal(0.0, 3.0, 80), rng.integers(-3, 5, 80).astype(float)
    columns = {"u": u, "n": n, "offset": np.full(80, -1.5)}
    nodes = evaluate(as_model(function).graph, columns, ParameterSet())
    names = {}
    exec(PROGRAM.replace("raise", "# raise"), names)
    expected = np.array([names["step"](a, b) for a, b in zip(u, n, strict=True)], dtype=float).T
    np.testing.assert_allclose([nodes["first"], nodes["y2"]], expected, rtol=1e-12)


@pytest.mark.parametrize("name", ["lag", pytest.param("called", marks=pytest.mark.slow)])
def test_the_exhaust_model_calibrates_to_the_parameters_of_the_formula(name, tmp_path):
    (tmp_path / "lag.py").write_text(LAG)
    function = read_function_file(f"lag.py:{name}", tmp_path, "lag")
    assert bool(function.remarks) == (name == "called")
    text = exhaust.FORMULA.replace(
        "PT1(settled, CurveTimeConstant(AirMass))",
        "lag(settled, prev(TemperaturePredict, settled), CurveTimeConstant(AirMass), dt)",
    )
    start, data = exhaust.start(), exhaust._record("drive", 600, 0, "training")
    names = list(exhaust.SMOOTHNESS)
    models = [formula(exhaust.FORMULA, parameters=names), formula(text, parameters=names, functions=[function])]
    results = [
        kf.calibrate(model, data, start, "Temperature", node="TemperaturePredict", smoothness=exhaust.SMOOTHNESS)
        for model in models
    ]
    for name in names:
        expected, values = (result.parameters[name].values for result in results)
        np.testing.assert_allclose(values, expected, rtol=1e-6)


def test_errors_of_a_function_are_reported_with_lines(tmp_path):
    text = "def step(a, b='x', c=[1], *rest):\n    if a:\n        return a, b\n    return a\n"
    message = _problems(text, tmp_path)
    assert "f.py line 1: the default of b must be a number, got 'x'" in message
    assert "f.py line 1: the default of c must be a number" in message
    assert "different numbers of values" in message
    assert "Did you mean step?" in _problems("def step(x): return x", tmp_path, "stepp")
    assert "f.py line 2" in _problems("def step(x):\n  return x +\n", tmp_path)
    assert "returns no value" in _problems("def step(x):\n  print(x)\n", tmp_path)


@pytest.mark.parametrize(
    "text", ["\x00", "(" * 50_000, "x = " + "-" * 100_000 + "1", "def f(:", "def step(x): return\n"]
)
def test_hostile_text_is_refused(text, tmp_path):
    assert _problems(text, tmp_path)


def test_an_exception_of_a_called_function_is_nan(tmp_path):
    (tmp_path / "f.py").write_text("def step(x):\n    values = {0: x}\n    return 1 / values[0]\n")
    model = as_model(read_function_file("f.py:step", tmp_path))
    values = evaluate(model.graph, {"x": np.array([0.0, 2.0])}, ParameterSet())["step"]
    np.testing.assert_array_equal(values, [np.nan, 0.5])


def test_a_file_that_changed_after_it_was_read_does_not_run(tmp_path):
    file = tmp_path / "f.py"
    file.write_text("def step(x):\n    values = {0: x}\n    return values[0]\n")
    model = as_model(read_function_file("f.py:step", tmp_path))
    file.write_text("def step(x):\n    values = {0: x}\n    return 2 * values[0]\n")
    with pytest.raises(InputError, match="has changed"):
        evaluate(model.graph, {"x": np.array([0.0])}, ParameterSet())


def test_a_fit_warns_of_a_function_whose_results_are_random(tmp_path):
    (tmp_path / "f.py").write_text("import random\n\n\ndef noisy(x):\n    return x + 0.1 * random.gauss(0, 1)\n")
    function = read_function_file("f.py:noisy", tmp_path)
    x = np.linspace(0.0, 5.0, 40)
    result = kf.calibrate(
        formula("y = a * noisy(x)", parameters=["a"], functions=[function]),
        {"x": x, "m": 2 * x},
        {"a": 1.0},
        target="m",
    )
    (warning,) = [each for each in result.warnings if "equal arguments" in each.message]
    assert (warning.location.file, warning.location.line) == ("f.py", 4)
    assert "f.py line 4: noisy gives different results" in str(result)
