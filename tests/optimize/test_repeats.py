"""Training samples that occur twice."""

import numpy as np
import pytest

import kennfeld as kf

RANDOM = np.random.default_rng(0)
X = RANDOM.uniform(0, 5, 200)
Y = 2 * X + RANDOM.normal(size=200)


def warnings(*datasets):
    result = kf.calibrate("y = a*x", list(datasets), {"a": 1.0}, target="m")
    return [f"{w.location}: {w.message}" for w in result.warnings if "same inputs" in w.message]


def steady(name, x=X, y=Y, **settings):
    return kf.Dataset.of(name, {"x": x, "m": y}, **settings)


def recording(name, x, y):
    return kf.Dataset.of(name, {"x": x, "m": y}, time=0.1 * np.arange(x.size))


def test_a_dataset_and_its_copy_are_named_for_any_order_of_the_samples():
    assert warnings(steady("bench"), steady("copy", X[::-1], Y[::-1])) == [
        "dataset copy: all training samples of copy have the same inputs and targets as samples of bench"
    ]


def test_rows_that_occur_twice_in_a_dataset_are_reported():
    assert warnings(steady("bench", np.tile(X, 2), np.tile(Y, 2))) == [
        "dataset bench: 50 % of the training samples of bench have the same inputs and targets as others of the dataset"
    ]


def test_datasets_with_equal_samples_are_named_in_their_order():
    parts = [steady(f"part {i}", X[10 * i : 10 * i + 10], Y[10 * i : 10 * i + 10]) for i in range(20)]
    repeated = np.r_[120:125, 120:125, 31:37, 5]  # 5 samples of part 12 twice, 6 of part 3, and by chance one of part 0
    (warning,) = warnings(*parts, steady("both", X[repeated], Y[repeated]))
    assert warning.endswith("of both have the same inputs and targets as samples of part 3, part 12")


def test_a_recording_that_is_part_of_another_is_named():
    (warning,) = warnings(recording("long", X, Y), recording("part", X[50:120], Y[50:120]))
    assert warning.startswith("dataset part: all training samples of part have")


@pytest.mark.parametrize(
    "datasets",
    [
        (steady("a"), steady("b", X, Y + RANDOM.normal(size=200))),
        (steady("a", np.round(X), np.round(Y)), steady("b", np.round(X), np.round(Y))),
        (steady("a"), steady("b", weight=0.0)),
        (recording("a", np.r_[np.zeros(500), X], np.r_[np.zeros(500), Y]), recording("b", np.zeros(90), np.zeros(90))),
        (steady("a"), steady("b", X[:1], Y[:1])),
    ],
    ids=["measured again", "coarse", "without a weight", "standstill", "a single sample"],
)
def test_occasional_equal_samples_are_not_copies(datasets):
    assert warnings(*datasets) == []
