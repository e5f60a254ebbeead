"""Wrong kinds of arguments are one sentence each; starts, smoothness and shifts may come from results."""

import copy
import pickle

import numpy as np
import pytest

import kennfeld as kf

X = np.linspace(0.0, 3.0, 31)
DATA = {"x": X, "z": 2 * X + 1}
TEXT = "y = a * x + b"
START = {"a": 1.0, "b": 0.0}
CURVE = kf.Curve("C", [0.0, 1.0, 2.0, 3.0], np.zeros(4))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"model": 3}, "model must be a model or formula text, got 3 of type int"),
        ({"start": 3}, "start must be a parameter set, a result, a list of parameters, .* got 3 of type int"),
        ({"start": None}, "calibrate requires start, unless its first argument is a problem"),
        ({"start": {1: 2.0}}, "start: 1 must be the name of a parameter"),
        ({"start": {"a": "x", "b": 1.0}}, "value of a must be numbers, got 'x'"),
        ({"start": {"a": [1.0, 2.0]}}, r'start: a must be a number; a table is kf\.Curve\("a", breakpoints, values\)'),
        ({"options": {"starts": 2}}, "options must be Options"),
        ({"options": kf.Options}, "options must be Options"),
        ({"progress": 3}, "progress must be a function"),
        ({"target": None, "criteria": kf.Criterion("y", "z")}, "criteria must be a list of Criterion"),
        ({"target": None, "criteria": ["z"]}, "criteria must be a list of Criterion"),
        ({"target": ["z"]}, "target must be the name of a channel, or a number"),
        ({"pins": kf.Pin("a", (), 1.0)}, "pins must be a list of Pin"),
        ({"limits": {"a": 3.0}}, r"limits must be a dict of \(lower, upper\) by name, or a list of Limit"),
        ({"limits": 3.0}, "limits must be a dict"),
        ({"constraints": ["a"]}, "constraints must be a list of Shape and Equality"),
        ({"channels": ["x"]}, "channels must be a dict of channels by the name of an input"),
        ({"shift": 0.2}, "shift must be a dict of shifts by channel"),
        ({"shift": {"road": {"z": 0.2}}}, "shift: there is no dataset road, but training"),
        ({"free": [3]}, "free must be a list of patterns"),
    ],
)
def test_a_wrong_kind_is_one_sentence(arguments, message):
    call = {"model": TEXT, "data": DATA, "start": START, "target": "z", **arguments}
    with pytest.raises(kf.ArgumentError, match=message):
        kf.calibrate(call.pop("model"), call.pop("data"), call.pop("start"), **call)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: kf.Options(seed=None), "seed must be an integer >= 0, got None"),
        (lambda: kf.Options(steps=[{"name": "fine"}]), "steps must be a list of Step"),
        (lambda: kf.Options(max_seconds=0), "max_seconds=0 of the options must be a finite number > 0"),
        (lambda: kf.Shape("C", "u", "slope"), "axis='u' of a shape of C must be x, y, z or w, or its number from 0"),
        (lambda: kf.Shape("C", 0.5, "slope"), "axis=0.5 of a shape of C"),
        (lambda: kf.Shape("C", 0, "bend"), "kind='bend' of a shape of C must be slope or curvature"),
        (lambda: kf.cross_validate(TEXT, DATA, START, "z", seed=None), "seed must be an integer >= 0, got None"),
        (lambda: kf.cross_validate(TEXT, DATA, START, "z", kind="all"), "kind must be auto, files, blocks, random"),
        (lambda: kf.cross_validate(TEXT), "cross_validate requires data"),
        (lambda: CURVE(1.0, 2.0), "C takes 1 coordinates, got 2"),
    ],
)
def test_a_wrong_value_of_a_setting_is_one_sentence(call, message):
    with pytest.raises(kf.ArgumentError, match=message):
        call()


def test_an_axis_of_a_shape_may_be_a_letter():
    assert kf.Shape("M", "y", "slope", lower=0) == kf.Shape("M", 1, "slope", lower=0)


def test_a_bound_may_be_none():
    result = kf.calibrate(TEXT, DATA, START, target="z", bounds={"a": (None, 1.5)}, limits={"y": (-5, None)})
    assert result.parameters["a"].value == 1.5
    assert kf.Scalar("a", 1.0, lower=None, upper=2.0).lower == -np.inf
    assert kf.Limit("y", None, 3.0) == kf.Limit("y", upper=3.0)


@pytest.mark.parametrize(
    "start",
    [
        lambda path: kf.ParameterSet([kf.Scalar("a", 1.0), kf.Scalar("b", 0.0)]),
        lambda path: [kf.Scalar("a", 1.0), kf.Scalar("b", 0.0)],
        lambda path: kf.calibrate(TEXT, DATA, START, target="z"),
        lambda path: path,
        str,
    ],
    ids=["set", "list", "result", "path", "text"],
)
def test_a_start_comes_in_many_forms(start, tmp_path):
    path = tmp_path / "start.json"
    kf.ParameterSet([kf.Scalar("a", 1.0), kf.Scalar("b", 0.0)]).save(path)
    result = kf.calibrate(TEXT, DATA, start(path), target="z")
    assert result.parameters["a"].value == pytest.approx(2)
    assert kf.simulate(TEXT, DATA, start(path)).samples == 31


def test_a_single_parameter_is_a_start():
    assert kf.calibrate("y = C(x)", DATA, CURVE, target="z").parameters["C"](1.0) == pytest.approx(3)


def test_the_smoothness_of_a_result_may_be_passed_on():
    rough = {"x": X, "z": np.sin(3 * X)}
    first = kf.calibrate("y = C(x)", rough, CURVE, target="z", smoothness="auto")
    again = kf.calibrate("y = C(x)", rough, CURVE, target="z", smoothness=first.smoothness)
    assert again.parameters["C"].values == pytest.approx(
        first.parameters["C"].values, rel=1e-3
    )  # without the restraint


def test_the_shifts_of_a_result_may_be_passed_on():
    time, u = 0.1 * np.arange(80), np.sin(0.3 * np.arange(80)) + np.cos(0.1 * np.arange(80))
    data = {"time": time, "u": u, "z": np.roll(2 * u, 3)}
    first = kf.calibrate("y = k * u", data, {"k": 1.0}, "z", shift={"z": "auto"})
    again = kf.calibrate("y = k * u", data, {"k": 1.0}, "z", shift=first.shifts)
    assert first.shifts["training"]["z"] == pytest.approx(-0.3, abs=0.02)
    assert again.parameters["k"].value == pytest.approx(first.parameters["k"].value, rel=1e-9)


def test_mappings_of_a_result_cannot_be_changed():
    result = kf.calibrate("y = C(x)", DATA, CURVE, target="z", smoothness="auto")
    for mapping in (result.smoothness, result.smoothness["C"], result.shifts, result.trust.deviation):
        with pytest.raises(TypeError, match="cannot be changed"):
            mapping["C"] = 1.0


def test_a_problem_is_calibrated_and_cross_validated_as_its_arguments():
    problem = kf.problem(TEXT, DATA, START, target="z")
    result = kf.calibrate(problem)
    assert result.parameters == kf.calibrate(TEXT, DATA, START, target="z").parameters
    assert kf.cross_validate(problem, folds=2) == kf.cross_validate(TEXT, DATA, START, "z", folds=2)
    with pytest.raises(kf.ArgumentError, match=r"calibrate\(problem\) takes no start, free: the problem states them"):
        kf.calibrate(problem, start=START, free=["a"])


BOUNDED = [kf.Scalar("a", 1.0, lower=0.0, upper=5.0), kf.Scalar("b", 0.0, lower=0.0, upper=5.0)]


@pytest.mark.parametrize(
    ("options", "arguments", "steps"),
    [
        ({}, {}, 1),
        ({"starts": 3, "workers": 1}, {}, 1),
        ({"steps": [kf.Step(free=["a"]), kf.Step()]}, {}, 1),
        ({"method": "global"}, {}, 1),
        ({}, {"limits": {"y": (None, 5.0)}}, 1),
        # the fit that smoothness is chosen by, and the last one with the factors so far
        ({}, {"model": "y = C(x)", "start": CURVE, "smoothness": "auto"}, 2),
    ],
    ids=["one descent", "several starts", "a sequence", "global", "limits of outputs", "smoothness"],
)
def test_a_search_of_any_kind_stops_after_its_time_with_the_best_values(options, arguments, steps):
    lines = []
    chosen = kf.Options(max_seconds=1e-9, **options)
    case = {"model": TEXT, "data": DATA, "start": BOUNDED, "target": "z", **arguments}
    result = kf.calibrate(**case, options=chosen, progress=lines.append)
    assert result.status == "stopped"
    assert "Stopped after max_seconds = 1e-09; these are the best values so far." in result.message
    assert result.cost_after <= result.cost_before
    assert len(lines) <= steps


def test_a_search_that_ends_within_its_time_has_converged():
    assert kf.calibrate(TEXT, DATA, START, "z", options=kf.Options(max_seconds=1e6)).status == "converged"


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_values_can_be_copied_and_pickled(duplicate):
    result = kf.calibrate(kf.formula("y[V] = PT1(a * x, b)", parameters=["a", "b"]), {**DATA, "time": X}, START, "z")
    problem = duplicate(result.inspection.problem)
    assert duplicate(problem.model).graph.names == problem.model.graph.names
    assert kf.calibrate(problem).parameters == kf.calibrate(result.inspection.problem).parameters
    assert duplicate(result).parameters == result.parameters
