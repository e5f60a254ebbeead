import numpy as np

from kennfeld import Criterion, Curve, Dataset, Limit, Map, ParameterSet, Scalar, formula
from kennfeld.analysis.limit_margins import active_constraints, output_ranges
from kennfeld.domain.constraints import Equality, Shape, Term
from kennfeld.optimize import Problem


def problem_of(text, parameters, data, **more):
    model = formula(text, parameters=[p.name for p in parameters])
    return Problem(model, (data,), ParameterSet(parameters), (Criterion("y", "m"),), **more)


DATA = Dataset.of("d", {"x": [0.5, 1.5, 2.5, np.nan], "m": [1.0, 2.0, 3.0, 4.0]})


def test_rows_that_hold_with_equality_press():
    curve = Curve("C", [0, 1, 2, 4], [0.0, 3.0, 3.0, 3.0 + 1e-12])
    problem = problem_of("y = C(x)", [curve], DATA, constraints=(Shape("C", 0, "slope", lower=0.0, upper=3.0),))
    (constraint,) = active_constraints(problem, problem.parameters)
    assert constraint.rows == 3
    assert constraint.active == (
        "slope of C along x between 0 and 1",
        "slope of C along x between 1 and 2",
        "slope of C along x between 2 and 4",
    )


def test_rows_with_room_do_not():
    table = Map("M", [0, 1, 2], [0, 1], [[0, 1], [1, 2], [3, 4.0]])
    problem = problem_of(
        "y = M(x, x) + k",
        [Scalar("k", 2.0), table],
        DATA,
        constraints=(Shape("M", 0, "curvature", lower=0.5), Equality([Term("k"), Term("M", (2, 1))], 6.0)),
    )
    convex, equal = active_constraints(problem, problem.parameters)
    assert (convex.rows, convex.active) == (2, ())
    assert len(equal.active) == 1


def test_outputs_are_judged_where_their_limit_counts():
    limits = (Limit("abs(y - z)", upper=2.0, where="x > 1"), Limit("y", lower=1.0))
    data = DATA.with_channels(*Dataset.of("e", {"z": [9.0, 0.0, 0.0, 0.0]}).channels)
    problem = problem_of("y = a * x", [Scalar("a", 1.0)], data, limits=limits)
    near, low = output_ranges(problem, problem.parameters)
    assert (near.samples, near.beyond, near.least, near.greatest) == (2, 1, 1.5, 2.5)
    assert (low.samples, low.beyond, low.least, low.greatest) == (3, 1, 0.5, 2.5)


def test_a_limit_met_but_for_rounding_is_kept():
    problem = problem_of(
        "y = a * x", [Scalar("a", 1.0)], DATA, limits=(Limit("y", 0.5 * (1 + 1e-9), 2.5 * (1 - 1e-9)),)
    )
    assert output_ranges(problem, problem.parameters)[0].beyond == 0


def test_test_data_are_not_judged():
    problem = problem_of("y = a * x", [Scalar("a", 1.0)], DATA, limits=(Limit("y", upper=0.0),))
    fresh = Dataset.of("f", {"x": [100.0], "m": [1.0]}, use="test")
    both = Problem(problem.model, (DATA, fresh), problem.parameters, problem.criteria, limits=problem.limits)
    assert output_ranges(both, both.parameters) == output_ranges(problem, problem.parameters)
