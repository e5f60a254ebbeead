"""The search knows sums over samples by their protocol alone: another implementation gives the same results."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.native import Accumulator, Samples
from kennfeld.native.samples import Piece
from kennfeld.optimize import Problem, run
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.options import Options
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective
from kennfeld.optimize.sums.sums import Sums

TORQUE = "torque = MapOptimum(n, rl) * CurveIgnition(angle + MapBase(n, rl)) - CurveFriction(n)"
SMOOTHNESS = {"MapOptimum": (0.1, 0.1), "MapBase": (0.1, 0.1), "CurveIgnition": (0.1,), "CurveFriction": (0.1,)}


@dataclass
class Equations:
    gradient: np.ndarray
    matrix: np.ndarray


class TwoHalves:
    """Sums over the first and the second half of each piece, as two machines would compute them."""

    def __init__(self, kernel, samples):
        self.parts = [Accumulator(kernel, half) for half in halves(samples)]
        self.widths = np.zeros_like(self.parts[0].widths)
        self.stateful = self.parts[0].stateful
        self.calls = 0

    def _each(self):
        self.calls += 1
        for part in self.parts:
            part.widths[:] = self.widths
        return self.parts

    def prepare(self):
        for part in self.parts:
            part.prepare()

    def cost(self, values):
        return sum(part.cost(values) for part in self._each())

    def normal(self, values):
        first, second = (part.normal(values) for part in self._each())
        return Equations(first.gradient + second.gradient, first.matrix + second.matrix)

    def residual(self, values):
        return self.rows(values)[0]

    def rows(self, values):
        (residual, jacobian), (further, below) = (part.rows(values) for part in self._each())
        return residual + further, jacobian + below

    def rows_at(self, values, visits):
        return sum(part.rows_at(values, visits) for part in self._each())

    def squares(self, values, groups, count):
        return sum(part.squares(values, groups, count) for part in self._each())

    def touched(self, values, owners=None):
        return sum(part.touched(values, owners) for part in self._each())


def halves(samples):
    cuts = [(piece, (piece.first + piece.last) // 2) for piece in samples.pieces]
    first = [Piece(piece.first, middle, piece.scores) for piece, middle in cuts]
    second = [Piece(middle, piece.last, piece.scores) for piece, middle in cuts]
    return [Samples(samples.inputs.parts, samples.wanted.parts, pieces, samples.order) for pieces in (first, second)]


def torque_problem(count=600, size=4):
    random = np.random.default_rng(0)
    n, rl, angle = random.uniform(800, 6000, count), random.uniform(10, 100, count), random.uniform(-10, 40, count)
    ideal = 2 * rl * (1 - ((n - 3500) / 6000) ** 2)
    efficiency = 1 - ((angle - 20 + rl / 10) / 60) ** 2
    data = {"n": n, "rl": rl, "angle": angle, "Torque": ideal * efficiency - n / 200 + random.normal(0, 0.5, count)}
    speed, load = kf.Axis(np.linspace(800, 6000, size)), kf.Axis(np.linspace(10, 100, size))
    parameters = kf.ParameterSet(
        [
            kf.Map("MapOptimum", speed, load, np.full((size, size), 50.0)),
            kf.Map("MapBase", speed, load, np.zeros((size, size))),
            kf.Curve("CurveIgnition", np.linspace(-20, 50, 5), np.linspace(0.7, 1.0, 5)),
            kf.Curve("CurveFriction", np.linspace(800, 6000, size), np.linspace(4.0, 30.0, size)),
        ]
    )
    dataset = kf.Dataset.of("bench", data)
    criteria = (kf.Criterion("torque", "Torque"),)
    return Problem(kf.formula(TORQUE), (dataset,), parameters, criteria, smoothness=SMOOTHNESS)


def descend(compiled):
    objective, limits = LeastSquaresObjective(compiled), linear_limits(compiled.problem, compiled.values)
    return levenberg_marquardt(objective, objective.start, limits, SolverSettings())


def test_native_code_meets_the_protocol():
    compiled = CompiledProblem(torque_problem())
    sums: Sums = compiled.sums
    names = [name for name in vars(Sums) if not name.startswith("_")]
    expected = [
        "stateful",
        "prepare",
        "cost",
        "normal",
        "residual",
        "rows",
        "rows_at",
        "squares",
        "touched",
        "each_tape",
    ]
    assert sorted(names) == sorted(expected)
    assert all(hasattr(sums, name) for name in [*names, "widths"])


@pytest.mark.slow
@pytest.mark.parametrize("size", [pytest.param(3, id="rows"), pytest.param(7, id="normal equations")])
def test_another_implementation_fits_the_same_values(size):
    problem = torque_problem(size=size)
    created = []

    def divide(kernel, samples):
        created.append(TwoHalves(kernel, samples))
        return created[-1]

    native, divided = CompiledProblem(problem), CompiledProblem(problem, sums_of=divide)
    expected, end = descend(native), descend(divided)
    assert created[0].calls > 0
    assert end.status == expected.status == "converged"
    assert end.cost == pytest.approx(expected.cost, rel=1e-9)
    assert end.values == pytest.approx(expected.values, rel=1e-5, abs=1e-5)


def test_a_calibration_needs_only_the_protocol(monkeypatch):
    """Continuation, output limits and the uncertainty of the values are included."""
    limited = replace(torque_problem(count=150, size=3), limits=(kf.Limit("torque", upper=190.0),))
    expected = run(limited, Options(max_iterations=2))
    created = []
    monkeypatch.setattr(
        "kennfeld.optimize.sums.compiled.Accumulator", lambda *args: created.append(TwoHalves(*args)) or created[-1]
    )
    result = run(limited, Options(max_iterations=2))
    assert sum(sums.calls for sums in created) > result.iterations
    assert result.status == expected.status
    assert result.cost_after == pytest.approx(expected.cost_after, rel=1e-4)
    for name, deviation in expected.trust.deviation.items():
        assert result.trust.deviation[name] == pytest.approx(deviation, rel=0.05, abs=1e-3, nan_ok=True)


class Counted(Accumulator):
    """Sums that count how often they are computed."""

    normals = costs_computed = 0

    def normal(self, values):
        self.normals += 1
        return super().normal(values)

    def cost(self, values):
        self.costs_computed += 1
        return super().cost(values)


@pytest.fixture
def counted():
    """A compiled problem with many samples for few values, and its sums."""
    created = []

    def count(kernel, samples):
        created.append(Counted(kernel, samples))
        return created[-1]

    compiled = CompiledProblem(torque_problem(size=3), sums_of=count)
    assert 8 * compiled.samples.count > compiled.values.free**2
    compiled.sums.prepare()
    return compiled, created[0]


def test_sums_at_the_values_of_the_last_call_are_not_computed_again(counted):
    compiled, sums = counted
    first = compiled.sums.normal(compiled.start)
    gradient, matrix = first.gradient.copy(), first.matrix.copy()
    first.matrix[:] = 0.0  # callers add the roughness in place
    for _ in range(2):
        again = compiled.sums.normal(compiled.start.copy())
        np.testing.assert_array_equal(again.gradient, gradient)
        np.testing.assert_array_equal(again.matrix, matrix)
        again.matrix[:] = 1.0
    assert sums.normals == 1
    assert compiled.sums.cost(compiled.start) == compiled.sums.cost(compiled.start.copy())
    assert sums.costs_computed == 1


def test_sums_are_computed_again_for_other_values_and_targets(counted):
    compiled, sums = counted
    before = compiled.sums.cost(compiled.start)
    assert compiled.sums.cost(1.1 * compiled.start) != before
    target = compiled.samples.wanted.parts[0][0]
    target.setflags(write=True)
    target += 5.0
    compiled.samples.wanted.reread()
    assert compiled.sums.cost(compiled.start) != before
    compiled.sums.normal(compiled.start)
    compiled.samples.wanted.reread()
    compiled.sums.normal(compiled.start)
    assert sums.normals == 2
