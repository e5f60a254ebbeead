"""The error on data held back: what it is, and that nothing of them is seen."""

import json
from dataclasses import replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.analysis.validation_result import CrossValidation, FoldQuality
from kennfeld.optimize.problem.setup import ProblemSetup


def line(samples=60, noise=0.1, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 1, samples)
    return {"x": x, "y": 1 + 2 * x + noise * rng.normal(size=samples)}


START = {"a": 0.0, "b": 0.0}
LINE = "m = a + b * x"


def test_it_is_the_fit_of_the_rest_scored_on_the_part():
    """By hand: least squares without the fold."""
    data = line()
    validation = kf.cross_validate(LINE, data, START, target="y", folds=4, kind="blocks")
    assert [row.samples for row in validation.folds] == [15] * 4
    for row in validation.folds:
        test_mask = np.zeros(60, dtype=bool)
        test_mask[15 * (row.fold - 1) : 15 * row.fold] = True
        slope, offset = np.polyfit(data["x"][~test_mask], data["y"][~test_mask], 1)
        errors = offset + slope * data["x"] - data["y"]
        assert row.rmse_held == pytest.approx(np.sqrt(np.mean(errors[test_mask] ** 2)), rel=1e-6)
        assert row.rmse_training == pytest.approx(np.sqrt(np.mean(errors[~test_mask] ** 2)), rel=1e-6)
    test_mask = [row.rmse_held for row in validation.folds]
    assert validation.mean("m") == pytest.approx(np.mean(test_mask))
    assert validation.spread("m") == pytest.approx(np.std(test_mask, ddof=1))


@pytest.mark.slow
def test_a_curve_that_follows_noise_is_detected():
    data = line(40, 0.3)
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 1, 25), np.zeros(25))])

    def validated(smoothness):
        return kf.cross_validate("m = C(x)", data, start, target="y", smoothness=smoothness)

    rough, smooth = validated(1e-6), validated(10.0)
    assert rough.training("m") < smooth.training("m")
    assert rough.mean("m") > 1.5 * smooth.mean("m")


def drive(samples=400, seed=0, name="drive"):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0, 1, samples // 20), 20)
    data = kf.Dataset.of(name, {"u": u}, time=np.arange(samples) * 0.1)
    clean = kf.simulate("y = PT1(g * u, T)", data, {"g": 3.0, "T": 0.8})["y"].values
    return data.with_channels(kf.Channel("wanted", clean))


def test_states_run_through_what_is_held_back():
    validation = kf.cross_validate("y = PT1(g * u, T)", drive(), {"g": 1.0, "T": 0.3}, target="wanted", folds=4)
    assert [row.held for row in validation.folds] == [f"block {i}" for i in range(1, 5)]
    assert max(row.rmse_held for row in validation.folds) < 1e-5


def test_files_are_held_back_where_there_are_enough():
    data = [drive(200, seed, f"drive {seed}") for seed in range(3)]
    validation = kf.cross_validate("y = PT1(g * u, T)", data, {"g": 1.0, "T": 0.3}, target="wanted", folds=3)
    assert [row.held for row in validation.folds] == ["drive 0", "drive 1", "drive 2"]


@pytest.mark.parametrize("kind", ["blocks", "random"])
def test_targets_held_back_are_not_seen(kind):
    """Wild targets in one fold change nothing of what is fitted for it."""
    data = line()
    problem = ProblemSetup(LINE, data, START, target="y").problem()
    first = kf.cross_validate(problem, folds=3, kind=kind).folds[0]
    from kennfeld.analysis.cross_validation import folds_of

    test_mask = folds_of(problem.datasets, 3, kind, memory=False)[0].held[0]
    wild = replace(problem, datasets=(kf.Dataset.of("training", data | {"y": np.where(test_mask, 1e6, data["y"])}),))
    again = kf.cross_validate(wild, folds=3, kind=kind).folds[0]
    assert again.rmse_training == first.rmse_training
    assert again.rmse_held > 1e5


@pytest.mark.slow
def test_smoothness_and_shifts_are_chosen_anew_in_each_fold(monkeypatch):
    monkeypatch.setattr("kennfeld.optimize.tuning.shift_estimation.WINDOW", 4)
    rng = np.random.default_rng(2)
    x = np.cumsum(rng.normal(0, 0.6, 300)) % 6
    data = {"x": x, "y": np.roll(np.sin(x), 1) + 0.05 * rng.normal(size=300)}
    start = kf.ParameterSet([kf.Curve("C", np.linspace(0, 6, 13), np.zeros(13))])
    arguments = {"target": "y", "smoothness": "auto", "folds": 2, "kind": "blocks"}
    blurred = kf.cross_validate("m = C(x)", data, start, **arguments)
    validation = kf.cross_validate("m = C(x)", data, start, shift={"y": "auto"}, **arguments)
    assert validation.mean("m") < 0.08 < blurred.mean("m")


def test_scored_samples_alone_count():
    data = kf.Dataset.of("d", line(), scored=np.arange(60) % 2 == 0)
    validation = kf.cross_validate(LINE, data, START, target="y", folds=3, kind="blocks")
    assert [row.samples for row in validation.folds] == [10, 10, 10]


def test_two_criteria_have_a_row_each():
    criteria = [kf.Criterion("m", "y"), kf.Criterion("double", "y")]
    text = f"{LINE}\ndouble = c * x"
    validation = kf.cross_validate(text, line(), START | {"c": 0.0}, criteria=criteria, folds=2)
    assert [(row.fold, row.criterion) for row in validation.folds] == [(1, "m"), (1, "double"), (2, "m"), (2, "double")]


def test_stopping_ends_with_the_folds_so_far():
    def stop(line):
        assert line.stage.startswith("fold 1 ")
        raise kf.Stop

    validation = kf.cross_validate(LINE, line(), START, target="y", progress=stop)
    assert [row.status for row in validation.folds] == ["stopped"]


def test_a_problem_accepts_no_further_data():
    problem = ProblemSetup(LINE, line(), START, target="y").problem()
    assert isinstance(kf.cross_validate(problem, folds=2), CrossValidation)
    with pytest.raises(kf.KennfeldError, match="takes no data: the problem states them"):
        kf.cross_validate(problem, line(), folds=2)


def test_it_shows_itself_and_is_json():
    validation = kf.cross_validate(LINE, line(), START, target="y", folds=2)
    assert "m: RMSE" in str(validation)
    content = json.loads(json.dumps(validation.as_json(), allow_nan=False))
    assert content["summary"][0]["rmse_held"] == validation.mean("m")
    assert list(content["folds"][0]) == [
        *("fold", "held", "criterion", "samples", "rmse_training", "rmse_held", "status"),
    ]


def validation_of(*errors, status="converged"):
    """Return a cross-validation with these errors on held-out data; those in training are 1."""
    return CrossValidation(
        tuple(FoldQuality(n, f"drive {n}", "y", 10, 1.0, error, status) for n, error in enumerate(errors, 1))
    )


@pytest.mark.parametrize(
    ("errors", "conclusion"),
    [
        ((1.1, 1.2, 1.0), "1.1 times that in training: no sign of overfitting."),
        ((2.0, 3.0, 1.5), "2.17 times that in training: the fit follows its training data more than they can support."),
        ((1.0, 1.1, 4.0), "2.03 times that in training, because of fold 3 (drive 3) alone: the other folds do not"),
        ((np.nan, 1.0), "do not compare with those in training."),
    ],
)
def test_conclusions_on_overfitting(errors, conclusion):
    assert conclusion in validation_of(*errors).conclusions()[0]


def test_folds_that_did_not_converge_are_a_conclusion():
    assert validation_of(1.0, 1.0, status="stopped").conclusions()[1].startswith("Not converged: fold 1 (stopped), 2 (")


def test_a_stored_cross_validation_is_the_same():
    validation = validation_of(1.0, np.nan)
    again = CrossValidation.from_json(json.loads(json.dumps(validation.as_json(), allow_nan=False)))
    assert again.as_json() == validation.as_json()
    assert again.conclusions() == validation.conclusions()
