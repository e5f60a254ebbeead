"""Expansions in radial basis functions as parameters: their values, their bounds, their file."""

import json

import numpy as np
import pytest
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.calfiles.comparison import compare
from kennfeld.domain.rbf import parts
from kennfeld.graph.interpreter import evaluate
from kennfeld.native.rbf_code import KERNELS
from tests.draws import few_or_many


def rbf(inputs=2, size=3, seed=0, kernel="gaussian", **attributes):
    rng = np.random.default_rng(seed)
    tables = rng.normal(size=(size, inputs)), rng.uniform(0.5, 2.0, (size, inputs))
    expansion = kf.Expansion(rng.normal(), rng.normal(size=inputs), rng.normal(size=size), *tables, kernel)
    return kf.RBF("F", expansion, list("abcdefgh"[:inputs]), **attributes)


@few_or_many(st.integers(1, 6), st.integers(0, 12), st.integers(0, 99), few=20, many=100)
def test_values_and_expansion_are_the_same_numbers(inputs, size, seed):
    parameter = rbf(inputs, size, seed)
    assert (parameter.coordinates, parameter.centres) == (inputs, size)
    assert parameter.with_values(parameter.values).expansion == parameter.expansion
    at = parts(inputs, size)
    np.testing.assert_array_equal(parameter.values[at.weights], parameter.expansion.weights)
    np.testing.assert_array_equal(parameter.values[at.widths].reshape(inputs, size).T, parameter.expansion.widths)


@few_or_many(st.integers(1, 4), st.integers(0, 5), st.integers(0, 99), st.sampled_from(KERNELS), few=20, many=40)
def test_slopes_of_the_values_are_those_of_differences(inputs, size, seed, kernel):
    parameter = rbf(inputs, size, seed, kernel)
    x = np.random.default_rng(seed).normal(size=(7, inputs))
    exact, step = parameter.value_slopes(x), 1e-6
    for i in range(parameter.size):
        ends = [parameter.values + side * step * (np.arange(parameter.size) == i) for side in (1, -1)]
        high, low = (parameter.with_values(end).expansion(x) for end in ends)
        np.testing.assert_allclose(exact[:, i], (high - low) / (2 * step), rtol=1e-5, atol=1e-7)


def test_a_width_stays_above_0():
    parameter = rbf()
    at = parts(2, 3).widths
    np.testing.assert_allclose(parameter.lower[at], 0.05 * parameter.values[at])
    bounded = rbf(lower=np.full(parameter.size, 0.4))
    assert np.all(bounded.lower[at] == 0.4)
    moved = parameter.with_values(2 * parameter.values)
    np.testing.assert_array_equal(moved.lower, parameter.lower)


def test_a_changed_one_keeps_its_inputs_and_its_kernel():
    changed = rbf(kernel="matern52").changed(unit="Nm")
    assert (changed.inputs, changed.kernel, changed.expansion.kernel) == (("a", "b"), "matern52", "matern52")


def test_a_file_without_a_kernel_holds_gaussian_bells(tmp_path):
    kf.ParameterSet([rbf()]).save(tmp_path / "p.json")
    assert "kernel" not in (tmp_path / "p.json").read_text()
    assert kf.read_parameters(tmp_path / "p.json")["F"].kernel == "gaussian"


def test_another_kernel_is_a_difference():
    differences = compare(kf.ParameterSet([rbf()]), kf.ParameterSet([rbf(kernel="matern52")])).differences
    assert [(d.aspect, d.left, d.right) for d in differences] == [("kernel", "gaussian", "matern52")]


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_file_holds_it_bit_for_bit(tmp_path, kernel):
    parameter = rbf(3, 4, kernel=kernel, unit="Nm", description="a model")
    kf.ParameterSet([parameter]).save(tmp_path / "p.json")
    read = kf.read_parameters(tmp_path / "p.json")["F"]
    assert read.expansion == parameter.expansion
    assert (read.inputs, read.unit, read.description) == (parameter.inputs, "Nm", "a model")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"widths": [[1.0, 0.0]] * 3}, "widths of an expansion must be > 0"),
        ({"weights": [1.0, 2.0, None]}, "must be a finite number"),
        ({"centres": [[1.0, 2.0]] * 2}, r"F\.centres: must have length 3, got 2"),
        ({"inputs": ["a"]}, r"F\.slopes: must have length 1, got 2"),
        ({"offset": "x"}, r"F\.offset: must be a number, got 'x'"),
        ({"centers": []}, "Did you mean centres"),
        ({"kernel": "cosine"}, "kernel='cosine' of an expansion must be gaussian or matern52"),
        ({"inputs": ["a", 1]}, r"F\.inputs: must be a list of names, got a list"),
        ({"hinges": {}}, r"F\.hinges: must be a list of rows of input, position and height, got an object"),
        ({"hinges": [[0, "1", 2]]}, r"F\.hinges\[0\]\[1\]: must be a number, got '1'"),
        ({"hinges": [[True, 1, 2]]}, r"F\.hinges\[0\]\[0\]: must be a number, got True"),
        ({"hinges": [0, 1, 2]}, r"F\.hinges\[0\]: must be a list of length 3, got 0"),
        ({"hinges": [[2, 1, 2]]}, r"F: hinges of an expansion are along inputs 0 to 1, counted from 0, not 2"),
    ],
)
def test_a_broken_file_is_answered(tmp_path, change, expected):
    kf.ParameterSet([rbf()]).save(tmp_path / "p.json")
    content = json.loads((tmp_path / "p.json").read_text())
    content["F"] |= change
    (tmp_path / "p.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=expected):
        kf.read_parameters(tmp_path / "p.json")


@pytest.mark.parametrize("ending", ["dcm", "csv"])
def test_formats_that_cannot_hold_it_refuse_it(tmp_path, ending):
    with pytest.raises(InputError, match="cannot store"):
        kf.ParameterSet([rbf()]).save(tmp_path / f"p.{ending}")


def hinged():
    e = rbf().expansion
    return kf.Expansion(e.offset, e.slopes, e.weights, e.centres, e.widths, e.kernel, ((0, 0.2, 3.0), (1, -0.1, -1.5)))


def test_hinges_stay_through_changes_and_files(tmp_path):
    bent = kf.RBF("F", hinged(), ["a", "b"])
    assert bent.with_values(2 * bent.values).expansion.hinges == bent.hinges == hinged().hinges
    path = tmp_path / "p.json"
    kf.ParameterSet([bent]).save(path)
    assert kf.read_parameters(path)["F"].expansion == hinged()
    [difference] = compare(kf.ParameterSet([bent]), kf.ParameterSet([rbf()])).differences
    assert (difference.aspect, difference.left, difference.right) == ("hinges", "a 0.2 3; b -0.1 -1.5", "none")


def test_a_model_adds_the_hinges_of_a_surrogate_and_fits_through_them():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 80))
    surrogate = kf.StaticSurrogate("engine", ("a", "b"), "y", (), hinged())
    model = kf.formula("y = engine(gain * a, b)\nscalar gain", surrogates=[surrogate])
    target = hinged()(np.column_stack([1.3 * a, b]))
    data = kf.Dataset.of("d", {"a": a, "b": b, "y": target})
    np.testing.assert_allclose(kf.simulate(model, data, {"gain": 1.3})["y"].values, target, rtol=1e-12)
    values = model.carried.merged(kf.ParameterSet([kf.Scalar("gain", 1.3)]))
    np.testing.assert_allclose(evaluate(model.graph, {"a": a, "b": b}, values)["y"], target, rtol=1e-12)
    assert abs(float(kf.calibrate(model, data, {"gain": 1.0}, target="y").parameters["gain"].values) - 1.3) < 1e-6


def test_inputs_must_be_as_many_as_the_expansion_has():
    with pytest.raises(ArgumentError, match="has 2 inputs, got inputs="):
        kf.RBF("F", rbf().expansion, ["a"])


def test_a_model_is_recovered_from_its_data():
    truth = rbf(1, 3, seed=4)
    x = np.linspace(-3, 3, 200)
    data = {"x": x, "y": truth.expansion(x[:, None])}
    start = truth.with_values(truth.values + 0.05 * np.random.default_rng(0).normal(size=truth.size))
    result = kf.calibrate("m = F(x)", data, kf.ParameterSet([start]), target="y")
    assert result.quality[0].rmse_after < 1e-4
    assert result.quality[0].rmse_before > 1e-2


def test_a_lookup_with_the_wrong_number_of_coordinates_is_reported():
    with pytest.raises(InputError, match="F is looked up with 1 coordinate, but has 2 axes"):
        kf.simulate("m = F(x)", {"x": [1.0]}, kf.ParameterSet([rbf()]))
