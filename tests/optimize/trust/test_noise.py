"""The scatter of measurements about a model."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.criteria import ROBUST_LOSSES
from tests.draws import mostly_slow


def line(count, noise, seed=0, outliers=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, count)
    y = 2 + 3 * x + rng.normal(0, noise, count)
    y[:outliers] += 100 * noise
    return {"x": x, "y": y}


def test_the_noise_is_in_the_targets_unit_and_for_the_values_that_were_fitted():
    data = line(12, 0.5)
    result = kf.calibrate(
        "m = a + b * x", data, {"a": 0.0, "b": 0.0}, criteria=[kf.Criterion("m", "y", 7.0, scale=4.0)]
    )
    a, b = (result.parameters[n].value for n in "ab")
    squares = float(np.sum((a + b * data["x"] - data["y"]) ** 2))
    assert result.trust.noise == {"m": pytest.approx(np.sqrt(squares / 10))}
    assert result.trust.freedom == pytest.approx(2.0)
    assert result.trust.persistence == {"m": 1.0}


@pytest.mark.parametrize("loss", ROBUST_LOSSES)
def test_outliers_do_not_enter_the_noise_of_a_robust_loss(loss):
    criteria = [kf.Criterion("m", "y", loss=loss, delta=1.0, scale=0.5)]
    result = kf.calibrate("m = a + b * x", line(4000, 0.5, outliers=40), {"a": 0.0, "b": 0.0}, criteria=criteria)
    assert result.trust.noise["m"] == pytest.approx(0.5, rel=0.12)


@pytest.mark.slow
@pytest.mark.parametrize("loss", mostly_slow(ROBUST_LOSSES, 1))
def test_robust_fits_scatter_as_predicted(loss):
    rng = np.random.default_rng(0)
    groups, ends, predicted = np.arange(120.0), [], []
    for _ in range(3):
        scatter = np.where(rng.random((groups.size, 60)) < 0.1, 4.0, 0.5) * rng.normal(size=(groups.size, 60))
        x = rng.uniform(-1, 1, 60)
        columns = {"x": np.tile(x, groups.size), "group": np.repeat(groups, 60), "y": (2 + scatter).ravel()}
        start = kf.ParameterSet([kf.Curve("A", groups, np.full(groups.size, 2.0)), kf.Scalar("b", 0.0)])
        criteria = [kf.Criterion("m", "y", loss=loss, delta=0.8, scale=0.5)]
        result = kf.calibrate("m = A(group) + b * x", columns, start, criteria=criteria)
        ends.append(result.parameters["A"].values)
        predicted.append(result.trust.deviation["A"])
    assert np.mean(predicted) == pytest.approx(np.std(ends), rel=0.1)


def test_each_criterion_has_its_own_noise():
    rng = np.random.default_rng(2)
    x = rng.uniform(-1, 1, 3000)
    data = {"x": x, "y": x + rng.normal(0, 0.1, x.size), "z": x + rng.normal(0, 2.0, x.size)}
    criteria = [kf.Criterion("m", "y"), kf.Criterion("m", "z")]
    trust = kf.calibrate("m = a * x", data, {"a": 0.0}, criteria=criteria).trust
    assert trust.noise == {"m against y": pytest.approx(0.1, rel=0.05), "m against z": pytest.approx(2.0, rel=0.05)}
    # both count alike, so the estimate is the mean of a good and a bad one
    lone = np.array([0.1, 2.0]) / np.sqrt(np.sum(x**2))
    assert float(trust.deviation["a"]) == pytest.approx(np.hypot(*lone) / 2, rel=0.05)


def test_datasets_of_different_weight_have_different_noise():
    good = kf.Dataset.of("good", line(400, 0.1), weight=25.0)
    bad = kf.Dataset.of("bad", line(4000, 0.5, seed=1))
    trust = kf.calibrate("m = a + b * x", [good, bad], {"a": 0.0, "b": 0.0}, target="y").trust
    alone = kf.calibrate("m = a + b * x", good, {"a": 0.0, "b": 0.0}, target="y").trust
    # each weighs as its noise asks for, so both together are as good as 400 + 4000 / 25 good ones
    assert trust.deviation["a"] == pytest.approx(alone.deviation["a"] * np.sqrt(400 / 560), rel=0.08)


def test_the_deviation_is_unknown_without_redundant_samples():
    trust = kf.calibrate("m = a + b * x", {"x": [0.0, 1.0], "y": [1.0, 3.0]}, {"a": 0.0, "b": 0.0}, target="y").trust
    assert np.isnan(trust.noise["m"])
    assert np.isnan(trust.deviation["a"])
    assert trust.as_json()["noise"] == {"m": None}
