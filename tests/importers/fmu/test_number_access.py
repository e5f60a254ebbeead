"""Integers, booleans, enumerations and single precision of FMUs as doubles."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.graph.external_function import evaluate_points
from kennfeld.importers.fmu.importing import fmu
from kennfeld.importers.fmu.number_types import number_type
from tests.importers.fmu.signals_fmu import build_signals

GEAR = np.array([-1.0, 0.0, 2.4, 2.6, -1.5, 1e12])
ROUNDED = np.array([-1.0, 0.0, 2.0, 3.0, -2.0, 2**31 - 1])
ON = np.array([0.0, 1.0, 0.4, 0.6, 1.0, 0.0])


@pytest.fixture(params=[2, 3])
def version(request):
    return request.param


@pytest.fixture
def model(version, tmp_path):
    return fmu(build_signals(tmp_path, version))


def columns(version):
    data = {"gear": GEAR, "on": ON, "mode": np.full(6, 2.0)}
    return data | ({"narrow": np.full(6, 0.1), "level": np.full(6, 300.0)} if version == 3 else {})


@pytest.mark.slow
def test_inputs_are_rounded_and_outputs_are_numbers(model, version):
    result = kf.simulate(model, columns(version), {"gain": 0.5})
    on = np.array([0, 1, 0, 1, 1, 0])
    np.testing.assert_array_equal(result["same"].values, ROUNDED)
    np.testing.assert_array_equal(result["lit"].values, on)
    np.testing.assert_array_equal(result["chosen"].values, np.full(6, 2.0))
    exact = 0.5 * (200 + 10 * ROUNDED + on)
    np.testing.assert_array_equal(result["y"].values[:5], exact[:5])
    if version == 3:
        np.testing.assert_array_equal(result["small"].values, np.full(6, np.float32(0.1) + np.float32(255)))


def test_a_model_without_states_needs_no_time(model, version):
    data = columns(version)
    data["target"] = kf.simulate(model, data, {"gain": 0.7})["y"].values
    weights = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    kept = {name: values[weights > 0] for name, values in data.items()}
    result = kf.calibrate(model, kept, {}, "target", node="y")
    assert result.parameters["gain"].value == pytest.approx(0.7, rel=1e-9)


def test_a_model_that_depends_on_the_time_needs_a_step(version, tmp_path):
    path = build_signals(tmp_path, version, "-DTIME_EVENT")
    with pytest.raises(InputError, match="its outputs depend on the time"):
        kf.simulate(fmu(path), columns(version), {})


def test_slopes_along_and_of_integers_are_zero(model):
    function = next(node.payload.function for node in model.graph.nodes if node.op == "external")
    point = np.ones((1, function.inputs))
    point[0, 0] = 0.0
    results, slopes = evaluate_points(function, point)
    assert results[0, 0] == 111.0
    expected = np.zeros_like(slopes[0])
    expected[0, -1] = 111.0
    np.testing.assert_allclose(slopes[0], expected, rtol=1e-8)


def test_nan_for_an_integer_gives_nan(model):
    function = next(node.payload.function for node in model.graph.nodes if node.op == "external")
    points = np.ones((2, function.inputs))
    points[0, -2] = np.nan
    results, _ = evaluate_points(function, points)
    assert np.isnan(results[0]).all()
    assert np.isfinite(results[1]).all()


@pytest.mark.parametrize(
    ("name", "least", "most"), [("Int8", -128, 127), ("UInt16", 0, 65535), ("Int64", -(2**63), None)]
)
def test_types_have_their_limits(name, least, most):
    kind = number_type("3.0", name)
    assert kind.least == least
    assert kind.most == (2**63 - 1024 if most is None else most)
