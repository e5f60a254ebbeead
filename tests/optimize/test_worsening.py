"""Fits that end with larger errors than they started with say so, and why."""

import re

import numpy as np
import pytest

import kennfeld as kf
from tests.draws import mostly_slow

GRID = np.arange(10.0)


def surface(x, z):
    return 20 * np.sin(x) + (z - 4) ** 2


def rough_map(seed, smoothness, text="m = A(x, z)"):
    """A map whose start is good, few points, and a smoothness that is far too large."""
    random = np.random.default_rng(seed)
    (x, u), (z, v) = (np.split(random.uniform(0, 9, 70), [20]) for _ in range(2))
    data = {"x": x, "z": z, "y": surface(x, z) + random.normal(size=x.size)}
    fresh = {"x": u, "z": v, "y": surface(u, v)}
    values = surface(GRID[:, None], GRID) + 2 * random.normal(size=(10, 10))
    start = kf.ParameterSet([kf.Map("A", GRID, GRID, values)])
    return kf.calibrate(text, data, start, target="y", test=fresh, smoothness=smoothness)


def share_of(result):
    (warning,) = result.warnings
    return float(re.search(r"by about (\S+),", warning.remedy)[1])


@pytest.mark.parametrize(
    "text", mostly_slow(["m = A(x, z)", "m = 40 * tanh(A(x, z) / 40)"], ["m = 40 * tanh(A(x, z) / 40)"])
)
@pytest.mark.parametrize("seed", mostly_slow(range(4), 2))
def test_the_suggested_share_of_smoothness_restores_the_fit(seed, text):
    smoothness = 10.0 ** (1 + seed % 3)
    worse = rough_map(seed, smoothness, text)
    assert worse.converged
    assert worse.quality[0].rmse_after > worse.quality[0].rmse_before
    assert worse.warnings[0].message.startswith("Smoothness outweighs the data: the RMSE of m on training rises from ")
    assert "of m on test (test data) rises from" in worse.warnings[0].message
    assert worse.warnings[0].severity == "warning"
    share = share_of(worse)
    better = rough_map(seed, smoothness * share, text).quality[0]
    assert better.rmse_after <= better.rmse_before
    much = rough_map(seed, smoothness * share * 5, text).quality[0]
    assert much.rmse_after > much.rmse_before  # it is not far from the largest one


@pytest.mark.parametrize("smoothness", [1e8, 1e12])
def test_a_smoothness_of_any_size_is_named_as_the_cause(smoothness):
    (warning,) = rough_map(0, smoothness).warnings
    assert warning.message.startswith("Smoothness outweighs the data")
    assert warning.remedy.startswith("Multiply the smoothness by about ")


def test_a_fit_that_is_worse_on_test_data_alone_has_a_warning():
    x = np.linspace(0, 1, 8)
    data = {"x": x, "y": x + 0.3 * np.sin(40 * x)}
    test = {"x": np.linspace(0, 1, 50), "y": np.linspace(0, 1, 50)}
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 1, 8), np.linspace(0.05, 1.05, 8))])
    (warning,) = kf.calibrate("m = C(x)", data, start, target="y", test=test).warnings
    assert str(warning).startswith("The fit is worse than its start on test data: the RMSE of m on test (test data)")
    assert "Add training data there" in warning.remedy


def test_a_criterion_that_others_outweigh_has_a_warning():
    x = np.linspace(0, 1, 20)
    criteria = [kf.Criterion("m", "y", 100.0), kf.Criterion("m", "z")]
    (warning,) = kf.calibrate("m = k * x", {"x": x, "y": 2 * x, "z": x}, {"k": 1.2}, criteria=criteria).warnings
    assert warning.message.startswith("The fit is partly worse than its start")
    assert "Increase its weight" in warning.remedy


def test_a_criterion_of_weight_zero_has_no_warning():
    x = np.linspace(0, 1, 20)
    criteria = [kf.Criterion("m", "y"), kf.Criterion("n", "z", 0.0)]
    result = kf.calibrate("m = k * x\nn = m", {"x": x, "y": 2 * x, "z": x}, {"k": 1.2}, criteria=criteria)
    assert result.quality[1].rmse_after > result.quality[1].rmse_before
    assert result.warnings == ()


def test_limits_that_the_start_violates_are_named_as_the_cause():
    x = np.linspace(0, 1, 20)
    start = kf.ParameterSet([kf.Scalar("k", 2.0)])
    (warning,) = kf.calibrate(
        "m = k * x", {"x": x, "y": 2.1 * x}, start, target="y", pins=[kf.Pin("k", (), 1.0)]
    ).warnings
    assert "the start may violate them" in warning.remedy


@pytest.mark.parametrize("start", [0.0, 2.0])
def test_a_fit_that_gains_or_ends_in_rounding_has_no_warning(start):
    x = np.linspace(0, 1, 20)
    result = kf.calibrate("m = k * x + exp(k) - exp(k)", {"x": x, "y": 2 * x}, {"k": start}, target="y")
    assert result.warnings == ()
    assert result.as_json()["warnings"] == []


def test_text_notebook_and_json_contain_the_warning():
    result = rough_map(0, 10.0)
    assert f"warning: {result.warnings[0]}" in str(result).splitlines()
    assert "Smoothness outweighs the data" in result._repr_html_()
    (entry,) = result.as_json()["warnings"]
    assert entry["sentence"].startswith("Smoothness outweighs the data")
    assert entry["remedy"] == result.warnings[0].remedy
