import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError
from kennfeld.surrogate.recursion import Lags, Recording, Runs
from kennfeld.surrogate.stability import check_stability
from tests.surrogate.surrogates import dynamic_surrogate, random_expansion, static_surrogate


def inputs(samples=40):
    return np.random.default_rng(0).normal(size=(samples, 2))


def by_hand(model, u, y0):
    y = []
    for k in range(len(u)):
        if k < len(y0):
            y.append(y0[k])
            continue
        before = y0[0] if len(y0) else model.start
        x = [y[k - lag] if k >= lag else before for lag in model.output_lags]
        x += [u[max(k - lag, 0), j] for j, lags in enumerate(model.lags) for lag in lags]
        y.append(float(np.clip(model.expansion(np.array(x)), *model.limits)))
    return np.array(y)


@pytest.mark.parametrize("given", [0, 1, 2, 3, 5, 40])
def test_a_simulation_is_the_recursion_written_out(given):
    model, u = dynamic_surrogate(), inputs()
    y0 = np.random.default_rng(1).normal(size=given)
    np.testing.assert_allclose(model.simulate(u, y0), by_hand(model, u, y0), rtol=1e-12, atol=1e-14)


def test_without_measured_outputs_it_begins_at_its_start():
    model = dynamic_surrogate()
    np.testing.assert_allclose(model.simulate(inputs()), by_hand(model, inputs(), []), rtol=1e-12)
    assert model.simulate(inputs(1)).shape == (1,)


def test_limits_hold_the_output():
    model = dynamic_surrogate(limits=(-0.05, 0.05))
    y = model.simulate(inputs())
    assert np.abs(y).max() == 0.05


def test_one_step_ahead_takes_the_measured_outputs():
    model, u = dynamic_surrogate(), inputs()
    y = np.random.default_rng(2).normal(size=40)
    predicted = model.predict(u, y)
    assert np.isnan(predicted[:3]).all()
    for k in (3, 17, 39):
        assert predicted[k] == pytest.approx(by_hand(model, u[: k + 1], y[:k])[k])


def test_points_far_from_the_training_data_are_outside():
    model, u = dynamic_surrogate(), inputs()
    u[20:, 0] += 50
    outside = model.outside(u, np.zeros(40))
    assert outside[20:].all()
    assert not outside[:20].all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lags": ((0, 2),)}, "one tuple for each of 2 inputs"),
        ({"output_lags": (1,)}, "give 4 inputs, its expansion has 5"),
        ({"lags": ((2, 0), (1,))}, "must increase strictly"),
        ({"output_lags": (0, 1)}, "whole numbers from 1 on"),
        ({"step": 0.0}, "step=0.0 of surrogate engine"),
        ({"limits": (1.0, 1.0)}, r"limits=\(1.0, 1.0\) of surrogate engine"),
        ({"start": np.nan}, "start=nan of surrogate engine"),
        ({"inputs": ("load", "load")}, "has input load twice"),
        ({"output": "load"}, "output='load' of surrogate engine is one of its inputs"),
        ({"units": ("deg",)}, "one per input and one for the output"),
    ],
)
def test_contradictory_attributes_are_named(change, message):
    with pytest.raises(ArgumentError, match=message):
        dynamic_surrogate(**change)


def test_inputs_of_the_wrong_shape_are_named():
    with pytest.raises(ArgumentError, match=r"u of shape \(40, 3\) must be \[samples, 2\]"):
        dynamic_surrogate().simulate(np.zeros((40, 3)))
    with pytest.raises(ArgumentError, match="y0 of surrogate engine has values that are not finite"):
        dynamic_surrogate().simulate(inputs(), [np.nan])


def test_a_static_surrogate_is_its_expansion_with_a_range():
    model = static_surrogate()
    x = np.array([[0.0, 0.0], [90.0, 90.0]])
    np.testing.assert_array_equal(model(x), model.expansion(x))
    assert model.outside(x).tolist() == [False, True]


def linear(slope, limits=(-np.inf, np.inf)):
    lags = Lags((1, 2), ((1,),))
    rng = np.random.default_rng(0)
    expansion = random_expansion(0, 3, 2, size=0.0)
    expansion = type(expansion)(0.0, [*slope, 0.1], expansion.weights, expansion.centres, expansion.widths)
    runs = Runs.of([Recording(rng.normal(size=(50, 1)), rng.normal(size=50))], lags)
    return check_stability(expansion, runs, limits)


def test_a_stable_recursion_is_called_so_with_its_eigenvalue():
    stability = linear((0.2, 0.63))  # eigenvalues 0.9 and -0.7
    assert stability.largest == pytest.approx(0.9)
    assert stability.bounded == stability.runs
    assert "All 48 free runs" in str(stability)


def test_an_unstable_recursion_is_reported_with_a_remedy():
    stability = linear((1.5, 0.0))
    assert stability.bounded == 0
    assert stability.stable == 0
    assert "0 of 48 free runs" in str(stability)
    assert "set limits" in str(stability)


def test_limits_bound_an_unstable_recursion():
    assert linear((1.5, 0.0), (-1.0, 1.0)).bounded == 48
