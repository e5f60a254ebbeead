import json

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld import Criterion, Dataset, ParameterSet, Scalar, Settling, formula
from kennfeld.analysis.extrapolation import find_extrapolation
from kennfeld.domain.rbf import Expansion
from kennfeld.optimize import Problem
from kennfeld.optimize.quality import quality as scoring_module
from kennfeld.optimize.quality import surrogate_calls as calls_module
from kennfeld.surrogate import DynamicSurrogate, StaticSurrogate, Validity
from tests.draws import few_or_many

CORNERS = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
TRAINED = np.vstack([CORNERS, np.random.default_rng(0).uniform(0, 1, (200, 2))])


def plane(inputs):
    return Expansion(0.1, 0.3 * np.ones(inputs) / inputs, np.zeros(0), np.zeros((0, inputs)), np.zeros((0, inputs)))


def static(validity=True, name="F"):
    trained = Validity.around(TRAINED, np.ones(2)) if validity else None
    return StaticSurrogate(name, ("x", "z"), "y", (), plane(2), trained)


def engine():
    trained = np.random.default_rng(1).uniform(-1, 1, (400, 4))
    return DynamicSurrogate(
        *("engine", ("a", "b"), ((0,), (1, 2)), "n", (1,), 0.02, plane(4)), Validity.around(trained, np.ones(4))
    )


def problem_of(text, surrogate, *datasets, **scalars):
    model = formula(f"{text}\n" + "".join(f"scalar {name}\n" for name in scalars), surrogates=[surrogate])
    own = ParameterSet([Scalar(name, value) for name, value in scalars.items()])
    return Problem(model, datasets, model.carried.merged(own), (Criterion("y", 0.0),))


def extrapolation_of(text, surrogate, *datasets, **scalars):
    problem = problem_of(text, surrogate, *datasets, **scalars)
    return find_extrapolation(problem, problem.parameters)


def test_a_model_without_surrogates_leaves_nothing():
    model = formula("y = a * x", parameters=["a"])
    data = Dataset.of("d", {"x": [1.0]})
    problem = Problem(model, (data,), ParameterSet([Scalar("a", 1.0)]), (Criterion("y", 0.0),))
    assert find_extrapolation(problem, problem.parameters) == ()


def test_it_names_the_input_that_is_farthest_out_and_where():
    data = Dataset.of("set values", {"x": [0.5, 0.5, 3.0, 0.5], "z": [0.5, 1.9, 0.5, 0.5]}, time=0.1 * np.arange(4))
    (row,) = extrapolation_of("y = F(x, z)", static(), data)
    assert (row.name, row.dataset, row.use, row.samples, row.outside) == ("F", "set values", "training", 4, 2)
    assert str(row) == (
        "F is used outside its training data at 2 of 4 samples of set values (50 %), "
        "worst at 0.2 s, where x is 3, above 1"
    )
    assert row.as_json() == {
        **{"name": "F", "dataset": "set values", "use": "training", "samples": 4, "outside": 2},
        "worst": {
            **{"sample": 3, "piece": 1, "time": 0.2, "input": "x", "value": 3.0, "end": 1.0},
            "sentence": "x is 3, above 1",
        },
    }


def test_values_below_the_range_count_and_test_data_are_judged():
    fresh = Dataset.of("fresh", {"x": [0.5, -1.5], "z": [0.5, 0.5]}, use="test")
    inside = Dataset.of("bench", {"x": [0.2, 0.8], "z": [0.3, 0.6]})
    bench, test = extrapolation_of("y = F(x, z)", static(), inside, fresh)
    assert (bench.outside, bench.worst) == (0, None)
    assert str(bench) == "F stays within its training data over 2 samples of bench"
    assert test.use == "test"
    assert str(test).endswith("worst at sample 2, where x is -1.5, below 0")


def test_parameters_and_memories_decide_where_it_is_looked_up():
    data = Dataset.of("d", {"x": [0.1, 0.4, 0.2], "z": [0.5, 0.5, 0.5]}, time=np.arange(3.0))
    problem = problem_of("y = F(k * x, prev(k * x, 0))", static(), data, k=1.0)
    assert find_extrapolation(problem, problem.parameters)[0].outside == 0
    (row,) = find_extrapolation(problem, problem.parameters.merged(ParameterSet([Scalar("k", 10.0)])))
    assert (row.outside, row.worst.input, row.worst.value, row.worst.sample) == (2, "x", 4.0, 2)


def test_a_sample_with_several_calls_counts_once():
    data = Dataset.of("d", {"x": [0.5, 2.0, 0.5], "z": [0.5, 0.5, 5.0]})
    (row,) = extrapolation_of("y = F(x, z) + F(2 * x, z)", static(), data)
    assert row.outside == 2
    assert (row.worst.input, row.worst.value, row.worst.sample) == ("z", 5.0, 3)


def test_inputs_that_never_occurred_together_are_reported():
    along = np.linspace(0, 1, 200)
    narrow = StaticSurrogate(
        "F", ("x", "z"), "y", (), plane(2), Validity.around(np.array([along, along]).T, np.ones(2))
    )
    (row,) = extrapolation_of("y = F(x, z)", narrow, Dataset.of("d", {"x": [0.5, 1.0], "z": [0.5, 0.0]}))
    assert row.outside == 1
    assert (row.worst.input, row.worst.sample) == ("", 2)
    assert str(row).endswith(
        "where each input is within its range, but their combination is far from the training data"
    )
    json.dumps(row.as_json(), allow_nan=False)


def test_a_point_with_nan_is_outside():
    (row,) = extrapolation_of("y = F(log(x), z)", static(), Dataset.of("d", {"x": [1.5, -1.0], "z": [0.5, 0.5]}))
    assert row.outside == 1
    assert str(row).endswith("where x is not finite")
    assert row.as_json()["worst"]["value"] is None
    json.dumps(row.as_json(), allow_nan=False)


def test_a_surrogate_without_a_validity_range_is_reported():
    (row,) = extrapolation_of("y = F(x, z)", static(validity=False), Dataset.of("d", {"x": [9.0], "z": [0.5]}))
    assert (row.outside, row.worst, row.share) == (None, None, 0.0)
    assert str(row) == "F has no validity range"


def test_missing_inputs_do_not_count_as_samples():
    (row,) = extrapolation_of("y = F(x, z)", static(), Dataset.of("d", {"x": [np.nan, 0.5, 7.0], "z": [0.5, 0.5, 0.5]}))
    assert (row.samples, row.outside, row.worst.sample) == (2, 1, 3)


def test_pieces_are_named_where_time_starts_anew():
    data = Dataset.of(
        "d", {"x": [0.5, 0.5, 0.5, 3.0], "z": 4 * [0.5]}, time=np.array([0, 1, 0, 1.0]), piece_starts=np.array([0, 2])
    )
    (row,) = extrapolation_of("y = F(x, z)", static(), data)
    assert (row.worst.piece, row.place) == (2, "1 s of piece 2")


def test_held_points_count_once_and_when_they_have_settled():
    settling = Settling(5.0, average=1.0, step=0.1)
    data = Dataset.of("d", {"x": [0.5, 2.0, 0.6], "z": [0.5, 0.5, 0.5]}, settling=settling)
    (row,) = extrapolation_of("y = F(PT1(x, 0.2, 5), z)", static(), data)
    assert (row.samples, row.outside, row.worst.sample, row.place) == (3, 1, 2, "sample 2")


def test_a_dynamic_one_is_judged_at_the_points_of_its_own_run():
    surrogate = engine()
    u = np.random.default_rng(2).uniform(-1.3, 1.3, (300, 2))
    data = Dataset.of("d", {"a": u[:, 0], "b": u[:, 1]}, time=0.02 * np.arange(300))
    (row,) = extrapolation_of("y = engine(a, b)", surrogate, data)
    n = surrogate.simulate(u)
    expected = surrogate.outside(u, n)
    expected[0] = surrogate.validity.outside(np.array([surrogate.start, u[0, 0], u[0, 1], u[0, 1]]))
    assert 0 < row.outside < 300
    assert row.outside == expected.sum()


def test_past_values_are_named_with_their_lag():
    u = np.zeros((20, 2))
    u[7, 1] = 30.0
    data = Dataset.of("d", {"a": u[:, 0], "b": u[:, 1]}, time=0.02 * np.arange(20))
    (row,) = extrapolation_of("y = engine(a, b)", engine(), data)
    assert row.worst.input == "b 1 sample before"
    assert row.worst.sample == 9
    u[:, 1], u[7, 1] = -40.0, 0.0
    shifted = Dataset.of("d", {"a": u[:, 0], "b": u[:, 1]}, time=0.02 * np.arange(20))
    assert extrapolation_of("y = engine(a, b)", engine(), shifted)[0].outside == 20


@pytest.mark.parametrize("text", ["y = F(x, z)", "y = F(2 * x, z)", "y = F(prev(x, x), z)"])
def test_blocks_change_nothing(text, monkeypatch):
    rng = np.random.default_rng(5)
    data = Dataset.of(
        *("d", {"x": rng.uniform(-0.2, 1.2, 100), "z": rng.uniform(-0.2, 1.2, 100)}),
        time=np.arange(100.0) % 50,
        piece_starts=np.array([0, 50]),
    )
    whole = extrapolation_of(text, static(), data)
    monkeypatch.setattr(calls_module, "SAMPLES_PER_BLOCK", 7)
    monkeypatch.setattr(scoring_module, "SAMPLES_PER_BLOCK", 7)
    assert extrapolation_of(text, static(), data) == whole
    assert whole[0].outside


@few_or_many(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=40), few=25, many=200)
def test_the_count_is_that_of_the_surrogate_and_the_worst_is_one_of_them(points):
    x = np.array(points)
    surrogate = SURROGATE
    problem = Problem(MODEL, (Dataset.of("d", {"x": x[:, 0], "z": x[:, 1]}),), MODEL.carried, (Criterion("y", 0.0),))
    (row,) = find_extrapolation(problem, problem.parameters)
    outside = surrogate.outside(x)
    assert row.outside == outside.sum()
    assert (row.worst is None) == (not outside.any())
    if row.worst is not None:
        assert outside[row.worst.sample - 1]
        excess = np.maximum(-x, x - 1).max(axis=1)[outside]
        farthest = np.maximum(-x, x - 1)[row.worst.sample - 1].max()
        assert farthest == pytest.approx(excess.max(), abs=0.2)  # the lengths of the two inputs are not quite alike


SURROGATE = static()
MODEL = formula("y = F(x, z)", surrogates=[SURROGATE])
