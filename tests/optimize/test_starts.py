import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.starts import distance, draw_start

X, Y = np.array([700.0, 1000.0, 2000.0, 4000.0, 6000.0]), np.linspace(0, 100, 7)


def problem(*parameters, free=("*",)):
    calls = {0: "{}", 1: "{}(x)", 2: "{}(x, y)"}
    text = "m = " + " + ".join(calls[len(p.axes)].format(p.name) for p in parameters)
    members = kf.ParameterSet(parameters)
    data = kf.Dataset.of("d", {"x": X, "y": X, "z": X})
    return Problem(kf.formula(text, parameters=list(members)), (data,), members, (kf.Criterion("m", "z"),), free)


def starts(*parameters, count=33, seed=0, spread=0.5):
    posed = problem(*parameters)
    return [draw_start(posed, number, seed, spread) for number in range(1, count + 1)]


def test_the_first_start_is_the_initial_one():
    table = kf.Map("M", X, Y, np.add.outer(X, Y))
    assert starts(table, count=1)[0]["M"].tolist() == table.values.tolist()


def test_a_bounded_scalar_is_drawn_evenly_between_its_bounds():
    drawn = [float(start["k"]) for start in starts(kf.Scalar("k", 3.0, lower=-1.0, upper=7.0))[1:]]
    assert sorted(np.floor((np.array(drawn) + 1) / 8 * 32).astype(int)) == list(range(32))


def test_an_unbounded_value_is_drawn_within_the_spread_around_the_start():
    drawn = np.array([float(start["k"]) for start in starts(kf.Scalar("k", -4.0), spread=0.25)[1:]])
    assert np.all(np.abs(drawn + 4.0) <= 1.0)
    assert np.ptp(drawn) > 1.8


def test_a_value_of_zero_is_drawn_around_zero_within_the_spread():
    drawn = np.array([float(start["k"]) for start in starts(kf.Scalar("k", 0.0))[1:]])
    assert np.all(np.abs(drawn) <= 0.5)
    assert drawn.min() < -0.4 < 0.4 < drawn.max()


@pytest.mark.parametrize("bounds", [{}, {"lower": 0.0, "upper": 400.0}])
def test_a_table_changes_smoothly_and_in_its_shape(bounds):
    table = kf.Map("M", np.linspace(0, 1, 21), np.linspace(0, 1, 31), np.full((21, 31), 200.0), **bounds)
    for start in starts(table)[1:]:
        change = start["M"] - 200.0
        assert np.ptp(change) > 1.0
        inside = change[(start["M"] > 0) & (start["M"] < 400)]
        for axis in (0, 1):
            steps = np.abs(np.diff(change, axis=axis))
            assert steps.max() < 0.5 * max(np.abs(inside).max(), np.ptp(change))


def test_a_parameter_that_affects_no_criterion_stays_at_every_start():
    parameters = kf.ParameterSet([kf.Scalar("k", 1.0), kf.Scalar("gain", 2.0), kf.Scalar("idle", 5.0)])
    data = kf.Dataset.of("d", {"x": X, "z": X})
    model = kf.formula("m = k * prev(w, 0) * x\nw = gain * x\nother = idle * x", parameters=list(parameters))
    posed = Problem(model, (data,), parameters, (kf.Criterion("m", "z"),))
    drawn = [draw_start(posed, number, 0, 0.5) for number in range(2, 6)]
    assert [float(start["idle"]) for start in drawn] == [5.0] * 4
    assert all(start["k"] != 1.0 and start["gain"] != 2.0 for start in drawn)  # gain by way of a memory


def test_locked_values_and_parameters_that_are_not_free_stay():
    locked = np.zeros((5, 7), bool)
    locked[1:3] = True
    table = kf.Map("M", X, Y, np.add.outer(X, Y), locked=locked)
    posed = problem(table, kf.Scalar("k", 1.0), free=("M",))
    start = draw_start(posed, 5, 0, 0.5)
    assert list(start) == ["M"]
    assert np.array_equal(start["M"][locked], table.values[locked])
    assert np.all(start["M"][~locked] != table.values[~locked])


@settings(deadline=None, max_examples=25)
@given(
    st.integers(0, 50),
    st.integers(2, 40),
    st.floats(-100, 100),
    st.floats(0, 300),
    st.sampled_from(["both", "lower", "upper", "some"]),
)
def test_starts_stay_within_their_bounds(seed, number, low, width, kind):
    lower, upper = np.full((5, 7), low), np.full((5, 7), low + width)
    if kind in ("lower", "some"):
        upper[1 if kind == "some" else slice(None)] = np.inf
    if kind == "upper":
        lower[:] = -np.inf
    table = kf.Map("M", X, Y, np.clip(np.full((5, 7), 10.0), lower, upper), lower=lower, upper=upper)
    values = draw_start(problem(table), number, seed, 0.5)["M"]
    assert np.all(np.isfinite(values))
    assert np.all((values >= lower) & (values <= upper))


def test_a_start_depends_on_its_number_and_seed_alone():
    tables = [kf.Curve("C", X, X), kf.Scalar("k", 1.0)]
    few, many = starts(*tables, count=3), starts(*tables, count=9)
    assert all(np.array_equal(few[2][name], many[2][name]) for name in ("C", "k"))
    assert not np.array_equal(few[2]["C"], starts(*tables, count=3, seed=1)[2]["C"])


def test_the_distance_is_relative_and_counts_parameters_alike():
    best = {"M": np.full((10, 10), 200.0), "k": np.array(2.0)}
    assert distance(best, best) == 0
    assert distance({"M": best["M"] * 1.01, "k": best["k"] * 1.01}, best) == pytest.approx(0.01)
    nearby, other = ({**best, name: best[name] * 1.1} for name in best)
    assert distance(nearby, best) == pytest.approx(distance(other, best))
    assert distance({"k": np.array(0.5)}, {"k": np.array(0.0)}) == 0.5
