"""Units of channels, functions and axes in Python; projects are in `project/test_units.py`."""

import warnings

import numpy as np
import pytest

import kennfeld as kf

TEXT = "input p[Pa]\ny[Nm] = C(p)"
P = np.array([0.0, 1.5, 3.0, 5.0])  # kPa
DATA = kf.Dataset.of("bench", {"p": P, "z": 2.0 * P}, units={"p": "kPa", "z": "kNm"})


def curve(unit=""):
    return kf.ParameterSet([kf.Curve("C", kf.Axis(1000 * P, input="p", unit=unit), np.zeros(4))])


def test_a_calibration_converts_inputs_and_targets_to_the_units_of_the_function():
    result = kf.calibrate(TEXT, DATA, curve("Pa"), target="z")
    np.testing.assert_allclose(result.parameters["C"].values, 2000.0 * P, atol=1e-6)
    [data] = result.inspection.problem.datasets
    assert (data["p"].unit, data["z"].unit) == ("Pa", "Nm")
    remark = "dataset bench: channel p is converted from kPa to Pa, the unit of the input p"
    assert remark in [str(finding) for finding in data.findings]


def test_a_simulation_converts_inputs_to_the_units_of_the_function():
    nodes = kf.simulate("input p[Pa]\ny = p / 1000", DATA, {})
    np.testing.assert_allclose(nodes["y"].values, P)


def test_a_cross_validation_converts_as_a_calibration_does():
    validation = kf.cross_validate("input p[Pa]\ny[Nm] = k * p", DATA, {"k": 1.0}, target="z", folds=2)
    assert validation.mean("y") == pytest.approx(0, abs=1e-6)


def test_several_datasets_are_in_the_unit_of_the_first():
    second = kf.Dataset.of("road", {"p": 1000 * P, "z": 2.0 * P}, units={"p": "Pa"})
    result = kf.calibrate("y = k * p", [DATA, second], {"k": 1.0}, target="z")
    assert result.parameters["k"].value == pytest.approx(2.0)


def test_a_unit_of_another_quantity_is_a_warning():
    data = kf.Dataset.of("bench", {"p": P, "z": P}, units={"p": "rpm"})
    message = (
        "channel p is in rpm, but the input p of the function is in Pa, a different quantity. Name another channel"
    )
    with pytest.warns(kf.InputWarning, match=message):
        kf.calibrate(TEXT, data, curve(), target="z")
    with pytest.warns(kf.InputWarning, match=message):
        kf.simulate(TEXT, data, curve())


def test_the_unit_of_an_axis_is_compared_with_that_of_the_channel():
    message = "axis x of C is in Pa, but channel p of dataset bench is in kPa. State the unit of p in the function"
    with pytest.warns(kf.InputWarning, match=message):
        kf.calibrate("y = C(p)", DATA, curve("Pa"), target="z")


def test_the_unit_of_an_axis_is_compared_with_that_of_the_function():
    message = "axis x of C is in bar, but the input p of the function is in Pa. Correct the unit of the axis"
    with pytest.warns(kf.InputWarning, match=message):
        kf.simulate(TEXT, DATA, curve("bar"))


@pytest.mark.parametrize("unit", ["", "-", "kPa", "FSN"])
def test_an_axis_whose_unit_is_the_same_or_unknown_causes_no_warning(unit):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kf.simulate("y = C(p)", DATA, curve(unit))
