"""Test samples that are training samples too."""

import numpy as np
import pytest

import kennfeld as kf

RANDOM = np.random.default_rng(1)
X = RANDOM.standard_normal(200)
BENCH = {"x": X, "z": 2 * X + 0.1 * RANDOM.standard_normal(200)}
FRESH = {"x": X, "z": 2 * X + 0.1 * RANDOM.standard_normal(200)}


def rows(data, samples):
    return {name: values[samples] for name, values in data.items()}


def joined(first, second):
    return {name: np.concatenate([first[name], second[name]]) for name in first}


def fit(training, test, **settings):
    return kf.calibrate("m = k * x", training, {"k": 1.0}, "z", test=test, **settings)


def warnings_of(training, test, **settings):
    """Return the warnings of a fit."""
    with pytest.warns(kf.InputWarning) as caught:
        assert fit(training, test, **settings).converged
    return [str(warning.message).partition(". Hold out other data")[0] for warning in caught]


def test_the_same_data_as_training_and_test_are_a_warning():
    expected = "dataset test: all 200 test samples have the same inputs and targets as samples of training"
    assert warnings_of(BENCH, BENCH) == [expected]


def test_samples_in_another_order_count_as_equal():
    assert "all 200 test samples" in warnings_of(BENCH, rows(BENCH, RANDOM.permutation(200)))[0]


def test_the_number_of_shared_samples_is_reported():
    [message] = warnings_of(BENCH, joined(rows(BENCH, slice(0, 30)), FRESH))
    assert message == "dataset test: 30 of 230 test samples have the same inputs and targets as samples of training"


def test_samples_shared_with_several_datasets_are_counted_once():
    training = [rows(BENCH, slice(0, 120)), rows(BENCH, slice(80, 200))]
    [message] = warnings_of(training, [FRESH, BENCH])
    assert (
        message
        == "dataset test1: all 200 test samples have the same inputs and targets as samples of training, training1"
    )


def test_equal_inputs_with_other_targets_are_different_samples():
    fit(BENCH, FRESH)


def test_a_sample_that_many_repeat_may_be_the_same_by_chance():
    """A car at standstill: one sample in a hundred and more of others."""
    still = {"x": np.zeros(500), "z": np.zeros(500)}
    fit(joined(BENCH, still), joined(FRESH, still))


def test_samples_that_do_not_count_are_not_compared():
    half = np.arange(200) < 100
    training, test = (kf.Dataset.of(name, BENCH, scored=mask) for name, mask in (("a", half), ("b", ~half)))
    fit(training, test)
    fit([kf.Dataset.of("a", BENCH, weight=0), rows(FRESH, slice(0, 99))], BENCH)
    missing = {"x": np.where(half, X, np.nan), "z": BENCH["z"]}
    assert "all 100 test samples" in warnings_of(BENCH, missing)[0]


def test_samples_that_differ_by_the_sign_of_a_zero_are_equal():
    zeros = {"x": np.array([0.0, 1.0, -0.0]), "z": np.array([-0.0, 2.0, 3.0])}
    assert "all 3 test samples" in warnings_of(zeros, {"x": -1 * -zeros["x"] + 0.0, "z": zeros["z"] + 0.0})[0]


def test_channels_of_other_names_are_compared():
    training, test = ({"n": data["x"], "z": data["z"]} for data in (BENCH, BENCH))
    assert "all 200" in warnings_of(training, test, channels={"x": "n"})[0]


def test_samples_are_not_compared_if_a_target_is_missing():
    fit(BENCH, {"x": X})
