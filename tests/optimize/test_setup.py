"""Arguments of `calibrate` that contradict each other or the data."""

import warnings

import numpy as np
import pytest

import kennfeld as kf

X = np.linspace(0.0, 3.0, 31)
DATA = {"x": X, "z": 2 * X}


def test_a_name_that_is_a_parameter_and_a_channel_is_refused():
    message = (
        "formula line 1, column 9: x is both a parameter of the start and a channel of the data. Declare what it is"
    )
    with pytest.raises(kf.InputError, match=message):
        kf.calibrate("y = a * x", DATA, {"a": 1.0, "x": 2.0}, target="z")
    with pytest.raises(kf.InputError, match="x is both a parameter of the start and a channel of dataset bench"):
        kf.simulate(kf.formula("y = a * x"), kf.Dataset.of("bench", DATA), {"a": 1.0, "x": 2.0})


@pytest.mark.parametrize("declared", ["input x", "scalar a\ninput x"])
def test_a_declared_input_is_not_hidden_by_a_parameter_of_a_whole_control_unit(declared):
    whole = kf.ParameterSet([kf.Scalar("a", 1.0), kf.Scalar("x", 2.0), kf.Scalar("other", 0.0)])
    text = f"{declared}\ny = a * x"
    for model in (text, kf.formula(text, parameters=list(whole)), kf.formula(text, parameters=["a"])):
        result = kf.calibrate(model, DATA, whole, target="z")
        assert result.parameters["a"].value == pytest.approx(2)


def test_a_declared_scalar_may_have_the_name_of_a_channel():
    data = {**DATA, "a": np.ones(31)}
    assert kf.calibrate("scalar a\ny = a * x", data, {"a": 1.0}, target="z").parameters["a"].value == pytest.approx(2)


def test_target_and_criteria_cannot_be_combined():
    criteria = [kf.Criterion("y", 0.0)]
    with pytest.raises(kf.ArgumentError, match="target='z' and criteria cannot be combined; add Criterion"):
        kf.calibrate("y = a * x", DATA, {"a": 1.0}, target="z", criteria=criteria)
    with pytest.raises(kf.ArgumentError, match="node='y' belongs to target"):
        kf.calibrate("y = a * x", DATA, {"a": 1.0}, node="y", criteria=criteria)


def test_a_name_of_the_start_that_the_model_does_not_use_is_a_warning():
    with pytest.warns(kf.InputWarning, match="start: the model does not use gian. Did you mean gain?"):
        kf.calibrate("scalar gain\ny = gain * x", DATA, {"gain": 1.0, "gian": 2.0}, target="z")
    with pytest.warns(kf.InputWarning, match="start: the model does not use b"):
        kf.simulate("y = a * x", DATA, {"a": 1.0, "b": 2.0})


def test_the_names_of_a_set_need_not_be_used():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kf.simulate("y = a * x", DATA, kf.ParameterSet([kf.Scalar("a", 1.0), kf.Scalar("b", 1.0)]))


def test_a_parameter_under_another_name_is_refused():
    with pytest.raises(kf.ArgumentError, match="start: the parameter under 'b' is called a; use its name"):
        kf.calibrate("y = b * x", DATA, {"b": kf.Scalar("a", 1.0)}, target="z")
