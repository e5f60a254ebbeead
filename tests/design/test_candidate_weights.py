"""Candidates count with the weights they will have: a refit of data drawn from the fit has the predicted curvature.

Data without noise from the fitted function leave its values where they are, so that the curvature of the refit is that
of the fit and of the new data, whatever the function.
"""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.design import design
from kennfeld.optimize.trust.matrices import whole
from tests.design.fits import MAP, fitted, surface

AXIS = np.linspace(0, 1, 4)
RANGES = {"n": (0, 1), "l": (0, 1)}


def bench(count=120, seed=0, weights=None, **settings):
    random = np.random.default_rng(seed)
    n, l = random.uniform(0, 0.6, count), random.uniform(0, 1, count)  # noqa: E741
    columns = {"n": n, "l": l, "m": surface(n, l) + random.normal(0, 0.05, count)}
    if weights is not None:
        columns["w"] = np.broadcast_to(weights, count)
    return kf.Dataset.of("bench", columns, **settings)


def fit(data, **criterion):
    start = kf.ParameterSet([kf.Map("M", AXIS, AXIS, np.ones((4, 4)))])
    return kf.calibrate(MAP, data, start, criteria=[kf.Criterion("y", "m", **criterion)], smoothness=0.01)


def drawn(result, points, **columns):
    """The points with what the fitted function says there."""
    own = {name: np.array([point[name] for point in points]) for name in ("n", "l")}
    own["m"] = kf.simulate(MAP, kf.Dataset.of("new", own), result.parameters)["y"].values
    return own | {name: np.full(len(points), value) for name, value in columns.items()}


def ratios(result, proposal, refit):
    """Predicted deviations relative to those of the refit; equal ones if only the noise differs."""
    np.testing.assert_allclose(refit.parameters["M"].values, result.parameters["M"].values, atol=1e-6)
    return proposal.after["M"] / refit.trust.deviation["M"]


@pytest.mark.parametrize("of_dataset", [True, False])
def test_a_channel_of_weights_counts_by_its_mean(of_dataset):
    settings = {"weight_channel": "w"} if of_dataset else {}
    criterion = {} if of_dataset else {"weight_channel": "w"}
    data = bench(weights=1e4, **settings)
    result = fit(data, **criterion)
    proposal = design(result, n=15, ranges=RANGES)
    new = kf.Dataset.of("new", drawn(result, proposal.points, w=1e4), **settings)
    ratio = ratios(result, proposal, fit([data, new], **criterion))
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-6)
    assert np.max(proposal.before["M"] / proposal.after["M"]) > 2


def test_a_region_counts_where_it_holds():
    data, criterion = bench(), {"regions": [kf.Region("n > 0.5", 1.4)]}
    result = fit(data, **criterion)
    proposal = design(result, n=15, ranges=RANGES)
    refit = fit([data, kf.Dataset.of("new", drawn(result, proposal.points))], **criterion)
    # weights of about one size share a noise
    assert len(fitted(result).estimate.groups) == 1
    ratio = ratios(result, proposal, refit)
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-6)


def test_no_point_is_chosen_where_nothing_counts():
    result = fit(bench(), regions=[kf.Region("n > 0.7", 0.0)])
    proposal = design(result, n=15, ranges=RANGES)
    assert max(point["n"] for point in proposal.points) <= 0.7


@pytest.mark.parametrize(
    "settings",
    [
        {"constraints": [kf.Shape("M", 1, "slope", lower=-1.9, upper=-1.2)]},
        {"pins": [kf.Pin("M", (0.5, 0.5), 3.0)]},
        {"bounds": {"M": (0.0, 2.5)}},
    ],
    ids=["slopes", "pin", "bounds"],
)
def test_limits_of_values_are_those_of_the_refit(settings):
    def fit(data):
        start = kf.ParameterSet([kf.Map("M", AXIS, AXIS, np.ones((4, 4)))])
        return kf.calibrate(MAP, data, start, "m", smoothness=0.01, **settings)

    result = fit(bench())
    assert fitted(result).estimate.reduction.independent.size < 16
    proposal = design(result, n=15, ranges=RANGES)
    deviation = fit([bench(), kf.Dataset.of("new", drawn(result, proposal.points))]).trust.deviation["M"]
    np.testing.assert_array_equal(proposal.after["M"] > 0, deviation > 0)
    ratio = proposal.after["M"][deviation > 0] / deviation[deviation > 0]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-5)


@pytest.mark.parametrize("loss", ["huber", "soft_l1"])
def test_with_a_robust_loss_a_sample_counts_by_its_mean_slope(loss):
    result = fit(bench(400), loss=loss, scale=0.05, delta=0.5)
    proposal = design(result, n=15, ranges=RANGES)
    (group,), estimate = fitted(result).estimate.groups, fitted(result).estimate
    n, l = (np.array([point[name] for point in proposal.points]) for name in ("n", "l"))  # noqa: E741
    hats = [np.maximum(0, 1 - 3 * abs(values[:, None] - AXIS)) for values in (n, l)]
    rows = np.einsum("ki,kj->kij", *hats).reshape(-1, 16) / 0.05
    curvature = whole(estimate.data) + whole(estimate.smoothness) + group.slope * rows.T @ rows
    deviation = np.sqrt(estimate.dispersion * np.diagonal(np.linalg.inv(curvature)))
    assert group.slope < 0.8
    np.testing.assert_allclose(proposal.after["M"].ravel(), deviation, rtol=1e-6)


@pytest.mark.parametrize("noise_by_weight", [True, False])
def test_recordings_that_are_dropped_take_their_own_weights_with_them(noise_by_weight):
    random, recordings = np.random.default_rng(1), []
    for number in range(4):
        n, l = random.uniform(0, 1, (2, 100))  # noqa: E741
        w = np.where(n > 0.5, 25.0, 1.0) if number else np.full(100, 400.0)
        noise = random.normal(0, 0.05, 100) / (np.sqrt(w) if noise_by_weight else 1)
        columns = {"n": n, "l": l, "w": w, "m": surface(n, l) + noise}
        recordings.append(kf.Dataset.of(f"part {number}", columns, weight_channel="w"))
    result = fit(recordings)
    proposal = design(result, reduce=True, keep=2)
    kept = [recording for recording in recordings if recording.name not in proposal.drop]
    assert "part 0" not in proposal.drop
    ratio = proposal.after["M"] / fit(kept).trust.deviation["M"]
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=0.05)
    assert np.median(ratio) == pytest.approx(1, abs=0.1)


def test_further_data_have_the_weight_of_most_samples():
    small, large = bench(40, seed=1, weight=9.0), bench(160, weight=4.0)
    result = fit([small, large])
    assert fitted(result).weight == 4.0
    remarks = [str(finding) for finding in design(result, n=3, ranges=RANGES).findings]
    assert any("weights from 4 to 9. What is measured next is taken to have 4" in remark for remark in remarks)
