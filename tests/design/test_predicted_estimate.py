"""The predicted deviation of a function that is not linear depends on values that are not known yet, and says so."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.design import Design, design
from kennfeld.design.predicted_estimate import DRAWS
from tests.design.fits import drive, fitted, lag_fit, map_fit

NARROW, WIDE = (0.0, 0.25, 0.5), (0.0, 0.25, 0.5, 0.75, 1.0)


def growth(x, seed):
    return {"x": x, "m": np.exp(1.5 * x) + np.random.default_rng(seed).normal(0, 1.0, x.size)}


def test_the_range_of_a_prediction_is_that_of_its_closed_form_over_plausible_values():
    x = np.linspace(0, 0.5, 40)
    result = kf.calibrate("input x\ny = exp(a * x)", growth(x, 0), {"a": 1.0}, "m")
    proposal = design(result, n=3, ranges={"x": (0.0, 2.0)})
    fit, further = fitted(result), np.array([point["x"] for point in proposal.points])
    everywhere, a = np.concatenate([x, further]), np.concatenate(fit.draws(0, DRAWS))
    # the slope of exp(a x) is x exp(a x)
    curvature = np.sum((everywhere * np.exp(a[:, None] * everywhere)) ** 2, axis=1)
    deviation = np.sqrt(fit.estimate.dispersion / curvature)
    assert proposal.after["a"] == pytest.approx(deviation[0], rel=1e-6)
    assert proposal.least["a"] == pytest.approx(deviation.min(), rel=1e-6)
    assert proposal.most["a"] == pytest.approx(deviation.max(), rel=1e-6)
    assert deviation.max() > 1.1 * deviation[0]
    low, high = (f"{extreme:.3g}" for extreme in (deviation.min(), deviation.max()))
    (sentence,) = [line for line in proposal.sentences if "not known yet" in line]
    assert sentence.startswith("The predictions for 1 of 1 value depend on values that are not known yet")
    assert sentence.endswith(f"or from {low} to {high}.")


def test_a_function_that_is_linear_in_its_values_has_no_range():
    proposal = design(map_fit(), n=5, ranges={"n": (0, 1), "l": (0, 1)})
    for extreme in (proposal.least, proposal.most):
        np.testing.assert_allclose(extreme["M"], proposal.after["M"], rtol=1e-6)
    assert not any("not known yet" in line for line in proposal.sentences)


def test_the_deviation_of_a_time_constant_is_within_its_range_once_the_steps_are_known(tmp_path):
    known, new = drive(60, NARROW), drive(60, WIDE, 2, name="new")
    result = lag_fit(known)
    use = drive(60, WIDE, 3)
    proposal = design(result, segments=6, candidates=new, use=use, length=10.0, warmup=0.0)
    refit = lag_fit([known, new])
    noise = refit.trust.noise["y"] / result.trust.noise["y"]
    # levels that no data had were extrapolated, and so were the steps that tell the time constant
    assert not 0.95 < refit.trust.deviation["T"] / noise / proposal.after["T"] < 1.05
    assert proposal.least["T"] <= refit.trust.deviation["T"] / noise <= proposal.most["T"]
    saved = Design.read(proposal.save(tmp_path / "next.json"))
    np.testing.assert_array_equal(saved.most["C"], proposal.most["C"])


def test_the_deviation_left_by_a_measurement_follows_the_noise_of_each_criterion():
    random = np.random.default_rng(0)
    n = random.uniform(0, 1, 300)
    data = {"n": n, "my": 2 + n + 0.02 * random.normal(size=300), "mz": (2 + n) * 3 + 2 * random.normal(size=300)}
    start = [kf.Curve("C", np.linspace(0, 1, 3), np.ones(3)), kf.Scalar("k", 1.0)]
    criteria = [kf.Criterion("y", "my"), kf.Criterion("z", "mz", scale=10.0)]
    result = kf.calibrate("input n\ny = C(n)\nz = k * y", data, kf.ParameterSet(start), criteria=criteria)
    proposal = design(result, n=100, names=["k"], ranges={"n": (0, 1)})
    expected = proposal.after["k"] / proposal.before["k"]
    said = float(proposal.sentences[0].split(" leave ")[1].split()[0])
    assert said == pytest.approx(expected, abs=0.006)
    # of one noise for both, the values of C would seem to gain as much
    assert expected < 0.95


def test_a_second_minimum_stays_as_far_as_it_is_until_further_data_are_fitted():
    x = np.linspace(0, 1, 60)

    def fit(x, seed):
        noise = np.random.default_rng(seed).normal(0, 0.02, x.size)
        data = kf.Dataset.of(str(seed), {"x": x, "m": (1 + x) * (1.5 + x) + noise})
        return kf.calibrate("input x\ny = (p + x) * (q + x)", data, {"p": 1.0, "q": 1.6}, "m")

    proposal = design(fit(x, 0), n=20, ranges={"x": (0, 1)})
    # p and q may change places, whatever is measured
    refit = fit(np.concatenate([x, [point["x"] for point in proposal.points]]), 1)
    for name in "pq":
        assert proposal.before[name] > 0.3
        assert proposal.after[name] == pytest.approx(refit.trust.deviation[name], rel=0.2)
        assert proposal.least[name] > 0.3
