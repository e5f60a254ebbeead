"""Code that a model keeps: shared by fits to other data, never by fits that need other code."""

import pickle

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.sums.compiled import CompiledProblem

TEXT = "y = C(x) + k * max(x, 1)"
X = np.linspace(0.0, 4.0, 40)


def table(points=(0.0, 2.0, 3.0), **attributes):
    return kf.Curve("C", kf.Axis(list(points), input="x"), [0.0] * len(points), **attributes)


def problem(model, measured=None, *tables, **arguments):
    measured = np.sin(X) if measured is None else measured
    start = kf.ParameterSet([*(tables or [table()]), kf.Scalar("k", 0.0)])
    return kf.problem(model, {"x": X, "m": measured}, start, **({"target": "m"} | arguments))


def bits(result):
    values = [parameter.values.tobytes() for parameter in result.parameters.values()]
    return values, result.cost_after, [line.cost for line in result.trace], repr(result.quality)


def test_fits_of_one_model_to_other_data_share_its_code_and_end_as_those_of_a_new_model():
    model = kf.formula(TEXT, parameters=["C", "k"])
    first, second = problem(model), problem(model, np.cos(X))
    assert CompiledProblem(first).kernel is CompiledProblem(second).kernel
    kf.calibrate(first)
    assert bits(kf.calibrate(second)) == bits(kf.calibrate(problem(TEXT, np.cos(X))))


@pytest.mark.parametrize(
    "other",
    [
        lambda model: problem(model, None, table((0.0, 1.0, 3.0))),
        lambda model: problem(model, None, table((-0.0, 2.0, 3.0))),
        lambda model: problem(model, None, table((0.0, 1.0, 2.0, 3.0))),
        lambda model: problem(model, None, table(extrapolation="linear")),
        lambda model: problem(model, free=["C"]),
        lambda model: problem(model, free_axes=["C.x"]),
        lambda model: problem(model, target=None, criteria=[kf.Criterion("y", "m", loss="huber", delta=0.1)]),
        lambda model: problem(model, target=None, criteria=[kf.Criterion("y", "m", scale=2.0)]),
        lambda model: problem(model, target=1.5),
    ],
)
def test_a_fit_that_needs_other_code_does_not_get_that_of_the_last_one(other):
    model = kf.formula(TEXT, parameters=["C", "k"])
    kf.calibrate(problem(model))
    assert bits(kf.calibrate(other(model))) == bits(kf.calibrate(other(TEXT)))


def test_a_group_axis_that_another_table_frees_is_not_that_of_the_kept_code():
    def structure(*, free):
        axes = [kf.Axis([0.0, 1.0, 4.0], input="x", name="AxisX", free=each) for each in (False, free)]
        tables = [kf.Curve(name, axis, [0.0] * 3) for name, axis in zip(("C", "Other"), axes, strict=True)]
        return problem(TEXT, None, *tables).structure

    assert structure(free=False) == structure(free=False) != structure(free=True)


def test_a_model_is_stored_without_what_it_keeps():
    model = kf.formula(TEXT)
    size = len(pickle.dumps(model))
    first = kf.calibrate(problem(model))
    assert len(pickle.dumps(model)) == size
    assert bits(kf.calibrate(problem(pickle.loads(pickle.dumps(model))))) == bits(first)


def test_a_model_that_calls_a_function_keeps_no_code():
    model = kf.function(lambda x, k: k * x, outputs=["y"])
    own = kf.problem(model, {"x": X, "m": 2 * X}, {"k": 0.0}, target="m")
    assert own.structure is None
    assert CompiledProblem(own).kernel is not CompiledProblem(own).kernel
