from dataclasses import dataclass, field

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.constraints import Limit
from kennfeld.domain.criteria import Criterion
from kennfeld.optimize import Problem, run
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from tests.draws import mostly_slow

GRID = np.linspace(0, 10, 6)
START = kf.ParameterSet([kf.Curve("C", GRID, 2 * GRID)])


def dataset(name, count, seed, missing=0):
    random = np.random.default_rng(seed)
    u = random.uniform(0, 10, count)
    y = 2 * u + random.normal(0, 1, count)
    u[:missing] = np.nan
    return kf.Dataset.of(name, {"u": u, "y": y})


def several(missing):
    return dataset("a", 9000, 0, missing), dataset("b", 3000, 1), dataset("c", 10, 2, missing // 10)


@dataclass(frozen=True)
class Aimed(Problem):
    """A problem whose targets are arrays of its own."""

    arrays: dict = field(default_factory=dict)

    def target(self, criterion, bound):
        return self.arrays.setdefault(bound.dataset.name, super().target(criterion, bound).copy())


def doubled_samples(compiled):
    return compiled.samples.reweighted(np.array([2.0]))


@pytest.mark.parametrize("text", ["m = C(u)", "m = prev(C(u), 0) + u"], ids=["steady", "with memory"])
@pytest.mark.parametrize("missing", [0, 50])
def test_targets_that_are_changed_in_place_are_read_again(text, missing):
    model = kf.formula(text, parameters=["C"])
    aimed = Aimed(model, several(missing), START, (Criterion("m", "y"),))
    compiled = CompiledProblem(aimed)
    doubled = compiled.over_selection(doubled_samples)
    for values in aimed.arrays.values():
        values += np.sin(np.arange(values.size))
    compiled.samples.wanted.reread()
    expected = LeastSquaresObjective(CompiledProblem(aimed)).cost(compiled.start)
    assert LeastSquaresObjective(compiled).cost(compiled.start) == expected
    assert LeastSquaresObjective(doubled).cost(compiled.start) == pytest.approx(2 * expected, rel=1e-14)


@pytest.mark.parametrize("missing", mostly_slow([0, 50], [50]))
def test_a_limit_holds_over_several_datasets_with_dropped_points(missing):
    problem = Problem(
        kf.formula("m = C(u)", parameters=["C"]),
        several(missing),
        START,
        (Criterion("m", "y"),),
        limits=(Limit("m", upper=12.0),),
    )
    result = run(problem, Options())
    assert result.status == "converged"
    np.testing.assert_allclose(result.parameters["C"].values[3:], 12.0, rtol=1e-5)
