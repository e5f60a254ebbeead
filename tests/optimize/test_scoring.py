import numpy as np
import pytest

import kennfeld as kf
from tests.draws import mostly_slow

TRAINING = {"x": [0.0, 1.0, 2.0, 3.0], "y": [0.0, 2.5, 3.5, 6.0]}
TEST = {"x": [1.0, 2.0, np.nan, 4.0], "y": [2.0, np.nan, 6.0, 9.0]}


def scored(test=TEST, **arguments):
    return kf.calibrate("m = k * x", TRAINING, {"k": 1.0}, target="y", test=test, **arguments)


def test_scores_are_rmse_r2_and_the_largest_error_in_the_unit_of_the_target():
    row = scored().quality[0]
    x, y = np.array(TRAINING["x"]), np.array(TRAINING["y"])
    error = (x @ y) / (x @ x) * x - y
    assert (row.criterion, row.use, row.samples) == ("m", "training", 4)
    assert row.rmse_before == pytest.approx(np.sqrt(np.mean((x - y) ** 2)))
    assert row.rmse_after == pytest.approx(np.sqrt(np.mean(error**2)))
    assert row.r2_after == pytest.approx(1 - np.sum(error**2) / np.sum((y - y.mean()) ** 2))
    assert row.max_abs_after == pytest.approx(np.abs(error).max())


def test_test_data_are_scored_and_never_fitted():
    with_test, without = scored(), scored(test=())
    assert with_test.parameters == without.parameters
    assert with_test.cost_after == without.cost_after
    row = with_test.quality[1]
    error = with_test.parameters["k"].value * np.array([1.0, 4.0]) - [2.0, 9.0]
    assert (row.use, row.samples) == ("test", 2)
    assert row.rmse_after == pytest.approx(np.sqrt(np.mean(error**2)))


def test_test_data_without_the_target_have_no_scores():
    row = scored({"x": [1.0, 2.0]}).quality[1]
    assert row.samples == 0
    assert np.isnan(row.rmse_after)


@pytest.mark.parametrize("test", [{"x": [], "y": []}, {"x": [np.nan], "y": [1.0]}], ids=["empty", "all missing"])
def test_test_data_without_remaining_samples_have_no_scores(test):
    row = scored(test).quality[1]
    assert row.samples == 0
    assert np.isnan(row.max_abs_after)


@pytest.mark.parametrize("value", [3.0, 0.1, 1e-9])
def test_a_constant_target_has_no_r2(value):
    assert np.isnan(scored({"x": np.arange(1000.0), "y": np.full(1000, value)}).quality[1].r2_after)


@pytest.mark.parametrize("text", ["m = k * x", "m = PT1(k * x, 0.3)"], ids=["steady", "with memory"])
def test_scores_do_not_depend_on_the_length_of_blocks(text, monkeypatch):
    random = np.random.default_rng(0)
    data = {name: random.uniform(1.0, 2.0, 100) for name in "xy"}
    data["x"][[30, 61]] = data["y"][::9] = np.nan
    dataset = kf.Dataset.of("d", data, time=0.1 * np.arange(100), piece_starts=[0, 10, 13, 60])

    def score():
        return kf.calibrate(text, dataset, {"k": 1.0}, "y", options=kf.Options(max_iterations=1)).quality[0]

    whole = score()
    for block in (1, 7, 45, 100):
        monkeypatch.setattr("kennfeld.optimize.quality.quality.SAMPLES_PER_BLOCK", block)
        cut = score()
        assert cut.samples == whole.samples == np.isfinite(data["x"] + data["y"]).sum()
        for name in ("rmse_before", "rmse_after", "r2_after", "max_abs_after"):
            assert getattr(cut, name) == pytest.approx(getattr(whole, name), rel=1e-12)


def test_scores_do_not_depend_on_weight_scale_and_loss():
    plain = scored(options=kf.Options(max_iterations=0)).quality
    criterion = kf.Criterion("m", "y", weight=7.0, loss="huber", delta=0.1, scale=3.0)
    other = kf.calibrate(
        "m = k * x", TRAINING, {"k": 1.0}, criteria=[criterion], test=TEST, options=kf.Options(max_iterations=0)
    ).quality
    assert plain == other


def test_overflowing_errors_do_not_warn():
    data = {"x": [1.0, 2.0], "y": [1e200, 2e200]}
    assert kf.calibrate("m = k * x", data, {"k": 1.0}, target="y").quality[0].samples == 2


def test_a_model_that_fails_at_test_samples_has_no_finite_score():
    result = kf.calibrate(
        "m = k * log(x)", {"x": [1.0, 2.0], "y": [0.0, 1.0]}, {"k": 0.0}, "y", test={"x": [-1.0], "y": [1.0]}
    )
    assert result.status == "converged"
    assert result.as_json()["quality"][1]["rmse_after"] is None


@pytest.mark.parametrize("value", mostly_slow([0.1, 0.3, 7.0, 1e9], [0.1]))
def test_a_table_notes_that_a_constant_target_has_no_r2(value):
    result = scored({"x": np.arange(1000.0), "y": np.full(1000, value)})
    assert [row[6] for row in result.table()][2] == "constant target"
    assert result.as_json()["quality"][1]["r2_after"] is None
    assert len(scored({"x": [1.0], "y": [np.nan]}).table()) == 2
