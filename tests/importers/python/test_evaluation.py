"""Python functions over many samples: arrays or numbers, own derivatives or differences."""

import math
import re

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.python.evaluation import PythonEvaluation

POINTS = np.array([np.linspace(0.5, 2.0, 50), np.linspace(-1.0, 1.0, 50) ** 2])


class Counted:
    """A function that counts its calls."""

    def __init__(self, function):
        self.function, self.calls = function, 0

    def __call__(self, *arguments):
        self.calls += 1
        return self.function(*arguments)


def product(x, y):
    return x * np.exp(y)


def scalar_product(x, y):
    return x * math.exp(y)


@pytest.mark.parametrize("function", [product, scalar_product])
@pytest.mark.parametrize("along", [(), (0,), (1, 0)])
def test_results_and_slopes_at_many_samples(function, along):
    results, slopes = PythonEvaluation("f", function, 2, 1).evaluate(POINTS, along)
    x, y = POINTS
    exact = [np.exp(y), x * np.exp(y)]
    assert results == pytest.approx(np.array([x * np.exp(y)]))
    assert slopes.shape == (1, len(along), 50)
    for number, argument in enumerate(along):
        assert slopes[0, number] == pytest.approx(exact[argument], rel=1e-8)


def test_a_function_of_arrays_is_called_once_for_all_samples():
    function = Counted(product)
    evaluation = PythonEvaluation("f", function, 2, 1)
    evaluation.evaluate(POINTS, ())
    before = function.calls
    evaluation.evaluate(POINTS, (0, 1))
    assert function.calls == before + 5


@pytest.mark.parametrize(
    "function",
    [
        lambda x, y: x if np.all(y < 0.5) else -x,  # a condition on all samples
        lambda x, y: x + np.max(y),  # samples affect each other
        lambda x, y: float(x) + y,  # numbers only
        lambda x, y: [x, y][0] if x > 1 else y,
    ],
)
def test_a_function_that_treats_arrays_otherwise_is_called_for_each_sample(function):
    results, _ = PythonEvaluation("f", function, 2, 1).evaluate(POINTS, ())
    assert results[0].tolist() == [function(x, y) for x, y in POINTS.T.tolist()]


def test_a_function_that_changes_its_arguments_is_called_with_numbers():
    def halved(x):
        x /= 2
        return x

    points = np.linspace(1.0, 2.0, 5)[None]
    results, slopes = PythonEvaluation("halved", halved, 1, 1).evaluate(points, [0])
    np.testing.assert_array_equal(points, [np.linspace(1.0, 2.0, 5)])
    np.testing.assert_array_equal(results, points / 2)
    np.testing.assert_allclose(slopes, np.full((1, 1, 5), 0.5))


def test_several_results_have_rows():
    evaluation = PythonEvaluation("f", lambda x, y: (x * y, np.sin(x)), 2, 2)
    results, slopes = evaluation.evaluate(POINTS, (0, 1))
    x, y = POINTS
    assert results == pytest.approx(np.array([x * y, np.sin(x)]))
    assert slopes[0] == pytest.approx(np.array([y, x]), rel=1e-8, abs=1e-12)
    assert slopes[1] == pytest.approx(np.array([np.cos(x), 0 * x]), rel=1e-8, abs=1e-12)


@pytest.mark.parametrize(
    "jacobian", [lambda x, y: (np.exp(y), x * np.exp(y)), lambda x, y: [math.exp(y), x * math.exp(y)]]
)
def test_own_derivatives_are_used(jacobian):
    counted = Counted(jacobian)
    _, slopes = PythonEvaluation("f", product, 2, 1, counted).evaluate(POINTS, (1,))
    assert np.array_equal(slopes[0, 0], POINTS[0] * np.exp(POINTS[1]))
    assert counted.calls


def test_own_derivatives_of_several_results():
    evaluation = PythonEvaluation("f", lambda x, y: (x * y, x**2), 2, 2, lambda x, y: ((y, x), (2 * x, 0.0)))
    _, slopes = evaluation.evaluate(POINTS, (0, 1))
    assert np.array_equal(slopes[1], [2 * POINTS[0], 0 * POINTS[0]])
    assert np.array_equal(evaluation.point_slopes([3.0, 4.0], [0]), [[4.0], [6.0]])


def test_wrong_derivatives_are_an_error():
    evaluation = PythonEvaluation("gain", product, 2, 1, lambda x, y: (np.exp(y), np.exp(y)))
    message = r"gain: the derivative of result 1 along argument 2 is .* by jac and .* by differences, at 0\.5, 1"
    with pytest.raises(InputError, match=message):
        evaluation.evaluate(POINTS, (0,))


@pytest.mark.parametrize(
    ("jacobian", "message"),
    [
        (lambda x, y: ((y, x),), "returns rows of 2 slopes, expected 2 of 2"),
        (lambda x, y: ((y, x), (2 * x, 0 * x), (y, x)), "returns rows of 2 and 2 and 2 slopes, expected 2 of 2"),
        (lambda x, y: ((y, x), (2 * x,)), "returns rows of 2 and 1 slopes, expected 2 of 2"),
        (lambda x, y: ((y, x), None), "fails at 0.5, 1: TypeError"),
        (lambda x, y: 1 / 0, "fails at 0.5, 1: ZeroDivisionError"),
    ],
)
def test_derivatives_of_another_shape_are_an_error(jacobian, message):
    evaluation = PythonEvaluation("f", lambda x, y: (x * y, x**2), 2, 2, jacobian)
    with pytest.raises(InputError, match=re.escape(f"f: jac {message}")):
        evaluation.evaluate(POINTS, (0, 1))
    assert np.isnan(evaluation.point_slopes([3.0, 4.0], [0])).all()


def test_derivatives_with_fewer_rows_for_arrays_are_called_with_numbers():
    def jacobian(x, y):
        rows = (y, x), (2 * x, 0.0)
        return rows if np.ndim(x) == 0 else rows[:1]

    counted = Counted(jacobian)
    evaluation = PythonEvaluation("f", lambda x, y: (x * y, x**2), 2, 2, counted)
    _, slopes = evaluation.evaluate(POINTS, (0, 1))
    assert np.array_equal(slopes[1], [2 * POINTS[0], 0 * POINTS[0]])
    counted.calls = 0
    evaluation.evaluate(POINTS, (0, 1))
    assert counted.calls == 1 + POINTS.shape[1]


def test_own_derivatives_may_differ_at_a_kink():
    points = np.array([np.linspace(-1.0, 1.0, 17)])
    evaluation = PythonEvaluation("f", np.abs, 1, 1, lambda x: [np.where(x < 0, -1.0, 1.0)])
    assert evaluation.evaluate(points, (0,))[1][0, 0, 8] == 1.0


def failing(x, y):
    raise KeyError("table")


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (failing, r"f: the function fails at 0\.5, 1: KeyError\('table'\)"),
        (lambda x, y: (x, y), r"f: the function returns 2 numbers, not 1\. Name its results: function\(f, outputs="),
        (lambda x, y: None, "f: the function fails at .*TypeError.* It must take numbers and return numbers"),
    ],
)
def test_a_function_without_results_is_an_error(function, message):
    with pytest.raises(InputError, match=message):
        PythonEvaluation("f", function, 2, 1).evaluate(POINTS, ())


def test_single_samples_that_fail_are_nan():
    results, _ = PythonEvaluation("f", lambda x, y: math.log(x - 1), 2, 1).evaluate(POINTS, ())
    assert np.array_equal(np.isnan(results[0]), POINTS[0] <= 1)


def counted_calls():
    calls = [0]

    def counting(x):
        calls[0] += 1
        return x + calls[0]

    return counting


def with_memory():
    kept = [0.0]

    def filtered(x):
        kept[0] += 0.5 * (x - kept[0])
        return kept[0]

    return filtered


@pytest.mark.parametrize("function", [counted_calls(), with_memory(), lambda x: x + np.random.normal()])
def test_results_that_change_between_calls_are_reported(function):
    evaluation = PythonEvaluation("f", function, 1, 1)
    evaluation.evaluate(POINTS[:1], (0,))
    (warning,) = evaluation.changing_results()
    assert warning.location.line > 0
    assert re.match("f gives different results for equal arguments: .* and .* at ", warning.message)


@pytest.mark.parametrize("function", [lambda x: x**2, lambda x: math.nan if x > 1 else x])
def test_results_that_stay_are_not_reported(function):
    evaluation = PythonEvaluation("f", function, 1, 1)
    evaluation.evaluate(POINTS[:1], ())
    evaluation.point([2.0])
    assert not evaluation.changing_results()
