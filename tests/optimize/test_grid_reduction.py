from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.domain.axis import Axis
from kennfeld.domain.constraints import Equality, Term
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Map
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.table_penalties import Roughness
from kennfeld.optimize.search.step_problem import (
    kept_breakpoints,
    penalty_ratio,
    reduce_problem,
    reduce_table,
    refine_table,
)
from tests.draws import few_or_many


class Packed:
    """Offset of the values of a single free table."""

    def __init__(self, table):
        self.offsets, self.free = {table.name: 0}, table.size


def penalty(table, factors):
    roughness = Roughness.of(ParameterSet([table]), Packed(table), {table.name: factors})
    return roughness.cost(table.values.ravel())


gaps = st.lists(st.floats(0.2, 5.0), min_size=2, max_size=12).map(lambda g: np.cumsum([0.0, *g]))
coefficients = st.lists(st.floats(-3, 3), min_size=5, max_size=5)
factors = st.integers(1, 4)


def test_a_map_of_ten_by_six_becomes_one_of_five_by_three():
    table = Map("M", np.arange(10), np.arange(6), np.zeros((10, 6)))
    assert reduce_table(table, (2, 2)).values.shape == (5, 3)


@given(st.integers(1, 60), st.integers(1, 70))
def test_the_ends_remain_and_the_others_are_spread_evenly(count, factor):
    remaining = kept_breakpoints(count, factor)
    assert remaining[0] == 0
    assert remaining[-1] == count - 1
    assert remaining.size == min(count, max(2, -(-count // factor)))
    assert remaining.size < 3 or np.ptp(np.diff(remaining)) <= 1


@few_or_many(gaps, gaps, coefficients, factors, factors, few=25, many=200)
def test_a_surface_of_even_curvature_keeps_its_penalty(x, y, c, along_x, along_y):
    def surface(x, y):
        u, v = x[:, None], y[None, :]
        return c[0] * u**2 + c[1] * v**2 + c[2] * u * v + c[3] * u + c[4]

    full = Map("M", x, y, surface(x, y))
    coarse = reduce_table(full, (along_x, along_y))
    for axis, curvature in ((0, c[0]), (1, c[1])):
        only = [0.0, 0.0]
        only[axis] = 7.0
        before = penalty(full, only)
        rescaled = [s / penalty_ratio(full, coarse, axis) for s in only]
        expected = before if len(coarse.axes[axis]) > 2 else 0.0
        scale = 7.0 * curvature**2 * full.size + 1.0
        assert penalty(coarse, rescaled) == pytest.approx(expected, rel=1e-6, abs=1e-9 * scale)


def test_half_the_points_of_a_long_curve_make_the_roughness_about_sixteen_times_larger():
    full = kf.Curve("C", np.linspace(0, 1, 81), np.zeros(81))
    assert penalty_ratio(full, reduce_table(full, (2,)), 0) == pytest.approx(15.6, abs=0.1)


@few_or_many(gaps, gaps, factors, factors, st.integers(0, 99), few=8, many=40)
def test_a_refined_surface_is_the_coarse_one_everywhere(x, y, along_x, along_y, seed):
    random = np.random.default_rng(seed)
    full = Map("M", x, y, random.standard_normal((x.size, y.size)))
    coarse = reduce_table(full, (along_x, along_y))
    again = refine_table(coarse, full)
    places = [
        np.flatnonzero(np.isin(a.breakpoints, b.breakpoints)) for a, b in zip(full.axes, coarse.axes, strict=True)
    ]
    assert np.array_equal(again.values[np.ix_(*places)], coarse.values)
    data = {"u": random.uniform(x[0], x[-1], 40), "v": random.uniform(y[0], y[-1], 40)}
    outputs = [kf.simulate("m = M(u, v)", data, ParameterSet([t]))["m"].values for t in (again, coarse)]
    np.testing.assert_allclose(*outputs, atol=1e-9)


def test_locked_values_stay_bit_for_bit_and_bounds_hold():
    locked = np.arange(9) == 3
    full = kf.Curve("C", np.arange(9), np.linspace(0, 0.8, 9) ** 0.3, locked=locked, upper=np.linspace(1, 0.5, 9))
    coarse = reduce_table(full, (2,)).with_values([1.0, 0.9, 0.8, 0.7, 0.5])
    again = refine_table(coarse, full)
    assert again.values[3] == full.values[3]
    assert np.all(again.values <= full.upper)


def test_bounds_and_locks_follow_their_grid_points():
    full = kf.Curve("C", np.arange(5), np.arange(5), locked=np.arange(5) == 2, upper=10 + np.arange(5))
    coarse = reduce_table(full, (2,))
    assert coarse.locked.tolist() == [False, True, False]
    assert coarse.upper.tolist() == [10, 12, 14]


def test_tables_of_one_group_axis_can_be_reduced_apart():
    axis = Axis(np.arange(6.0), input="x", name="AxisX")
    tables = [kf.Curve("A", axis, np.zeros(6)), kf.Curve("B", axis, np.zeros(6))]
    problem = Problem(
        kf.formula("m = A(x) + B(x)"),
        (kf.Dataset.of("d", {"x": [1.0], "y": [1.0]}),),
        ParameterSet(tables),
        (kf.Criterion("m", "y"),),
        smoothness={"A": 2.0, "B": 2.0},
    )
    small = reduce_problem(problem, {"A": (2,), "B": (1,)})
    assert [small.parameters[name].size for name in "AB"] == [3, 6]
    assert small.parameters["A"].axes[0].input == "x"
    assert small.factors("A")[0] < small.factors("B")[0] == 2.0


def test_breakpoints_around_a_pin_are_kept_and_summed_tables_stay():
    table = kf.Curve("C", np.arange(13.0), np.zeros(13))
    base = Problem(
        kf.formula("m = C(x)"),
        (kf.Dataset.of("d", {"x": [1.0], "y": [1.0]}),),
        ParameterSet([table]),
        (kf.Criterion("m", "y"),),
        pins=(kf.Pin("C", (5.5,), 1.0), kf.Pin("C", (1.0,), 1.0)),
    )
    points = reduce_problem(base, {"C": (4,)}).parameters["C"].axes[0].breakpoints
    assert points.tolist() == [0, 1, 4, 5, 6, 8, 12]
    summed = replace(base, constraints=(Equality([Term("C")], 3.0),))
    assert reduce_problem(summed, {"C": (4,)}) is summed


def test_a_table_too_small_to_be_reduced_stays_as_it_is():
    table = kf.Curve("C", [0.0, 1.0], [1.0, 2.0])
    assert reduce_table(table, (4,)) is table
