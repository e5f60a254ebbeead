"""The error predicted for held-out data: its value by brute force, its derivatives by differences, its minimum."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

import kennfeld as kf
from kennfeld.models.formula import formula
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.problem.table_penalties import Roughness
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.tuning import prediction_error
from kennfeld.optimize.tuning.holdout_blocks import HoldoutBlock
from kennfeld.optimize.tuning.prediction_error import (
    GAMMA,
    HOLDOUT_SHARE,
    SPREAD,
    Linearised,
    Prediction,
    balanced_factor,
    minimise_prediction,
)
from tests.draws import mostly_slow

AXES = {"M": 2, "C": 1}


@pytest.fixture(scope="module")
def compiled():
    """A map and a curve, whose linearised fit is exact."""
    rng = np.random.default_rng(0)
    x, y, z = rng.uniform(0, 10, 200), rng.uniform(0, 4, 200), rng.uniform(0, 3, 200)
    target = np.sin(x) + y + z**2 + 0.1 * rng.normal(size=200)
    breakpoints = [0.0, 0.8, 2.5, 5.0, 8.0, 10.0]
    parameters = kf.ParameterSet(
        [kf.Map("M", breakpoints, np.arange(5.0), rng.normal(size=(6, 5))), kf.Curve("C", range(4), [0, 1, 4, 9])]
    )
    data = kf.Dataset.of("d", {"x": x, "y": y, "z": z, "wanted": target})
    model = formula("model = M(x, y) + C(z)", parameters=list(parameters))
    return CompiledProblem(Problem(model, (data,), parameters, (kf.Criterion("model", "wanted"),)))


def unit(compiled, name, axis):
    factors = [float(i == axis) for i in range(AXES[name])]
    return Roughness.of(compiled.problem.parameters, compiled.values, {name: factors})


def parts(compiled, count=4):
    """The contributions of every fourth row each."""
    residual, jacobian = compiled.sums.rows(compiled.start)
    picked = [(residual[i::count], jacobian[i::count]) for i in range(count)]
    return [HoldoutBlock(float(r @ r), j.T @ r, j.T @ j, r.size / residual.size) for r, j in picked]


def linearised(compiled, fixed=(), rows=(), blocks=()):
    values = compiled.start[: compiled.values.free]
    normal = compiled.sums.normal(compiled.start)
    movable = np.ones(values.size, dtype=bool)
    movable[list(fixed)] = False
    equalities = np.zeros((len(rows), values.size))
    for row, columns in enumerate(rows):
        equalities[row, list(columns)] = (0.3, 0.7)
    cost = compiled.sums.cost(compiled.start)
    return Linearised(
        values, cost, normal.gradient.copy(), normal.matrix.copy(), movable, equalities, 200.0, tuple(blocks)
    )


@pytest.fixture(
    scope="module", params=mostly_slow(["free", "held", "pulled", "held with blocks", "free with blocks"], 4)
)
def prediction(compiled, request):
    limits = {"free": ((), ()), "pulled": ((), ()), "held": ((3, 4, 11), ((7, 8), (32, 33)))}[request.param.split()[0]]
    limits = (*limits, parts(compiled) if "blocks" in request.param else ())
    blocks = [unit(compiled, "M", 0), unit(compiled, "M", 1)]
    fit = linearised(compiled, *limits)
    if request.param == "pulled":
        rng = np.random.default_rng(1)
        fit = replace(fit, pull=rng.uniform(0, 3, fit.values.size), toward=rng.normal(size=fit.values.size))
    return Prediction(fit, blocks, [unit(compiled, "C", 0)])


POINTS = [np.array([1.0, -2.0]), np.array([-6.0, 3.0]), np.array([8.0, 0.0])]


@pytest.mark.parametrize("at", POINTS)
def test_slopes_and_curvatures_are_those_of_differences(prediction, at):
    point, step = prediction.at(at), 1e-2
    for i, direction in enumerate(np.eye(2) * step):
        ahead, behind = prediction.at(at + direction), prediction.at(at - direction)
        assert (ahead.value - behind.value) / (2 * step) == pytest.approx(point.slope[i], rel=1e-3, abs=2e-3)
        assert (ahead.slope - behind.slope) / (2 * step) == pytest.approx(point.curvature[i], rel=1e-3, abs=2e-3)


def test_the_value_is_misfit_over_the_squared_residual_freedom(compiled):
    """By brute force, from the influence matrix of a fit of rows."""
    blocks = [unit(compiled, "M", 0), unit(compiled, "M", 1), unit(compiled, "C", 0)]
    factors = np.array([0.5, 20.0, 3.0])
    residual, jacobian = compiled.sums.rows(compiled.start)
    values = compiled.start[: compiled.values.free]
    penalty = sum(f * block.rows(values)[1].T @ block.rows(values)[1] for f, block in zip(factors, blocks, strict=True))
    influence = jacobian @ np.linalg.pinv(jacobian.T @ jacobian + penalty, rcond=1e-12) @ jacobian.T
    measured = jacobian @ values - residual
    misfit = np.sum((measured - influence @ measured) ** 2)
    expected = 200 * np.log(misfit / (1 - GAMMA * np.trace(influence) / 200) ** 2)
    criterion = Prediction(linearised(compiled), blocks)
    assert criterion.at(np.log(factors)).value == pytest.approx(expected, rel=1e-7)
    assert criterion.freedom(np.log(factors)) == pytest.approx(np.trace(influence), rel=1e-6)


def test_a_pull_counts_as_additional_rows_of_the_penalty(compiled):
    """By brute force, from one fit of the rows of data, roughness and pull."""
    block, factor = unit(compiled, "M", 0), 5.0
    residual, jacobian = compiled.sums.rows(compiled.start)
    values = compiled.start[: compiled.values.free]
    pull, toward = np.linspace(0.1, 2, values.size), np.linspace(-1, 1, values.size)
    rough, rows = block.rows(values)
    parts = [residual, factor**0.5 * rough, pull**0.5 * (values - toward)]
    system = np.vstack([jacobian, factor**0.5 * rows, np.diag(pull**0.5)])
    step = np.linalg.lstsq(system, -np.concatenate(parts), rcond=None)[0]
    misfit = np.sum((residual + jacobian @ step) ** 2)
    prediction = Prediction(replace(linearised(compiled), pull=pull, toward=toward), [block])
    freedom = prediction.freedom(np.log([factor]))
    expected = 200 * np.log(misfit / (1 - GAMMA * freedom / 200) ** 2)
    assert prediction.at(np.log([factor])).value == pytest.approx(expected, rel=1e-7)


def test_the_error_of_held_out_samples_is_that_of_a_fit_to_the_others(compiled):
    """By brute force, from a fit of the rows that are left."""
    blocks = [unit(compiled, "M", 0), unit(compiled, "M", 1), unit(compiled, "C", 0)]
    factors = np.array([0.5, 20.0, 3.0])
    residual, jacobian = compiled.sums.rows(compiled.start)
    values = compiled.start[: compiled.values.free]
    rough = np.vstack([f**0.5 * block.rows(values)[1] for f, block in zip(factors, blocks, strict=True)])
    logarithms = []
    for i in range(4):
        rest = np.arange(residual.size) % 4 != i
        rows = np.vstack([jacobian[rest], rough])
        step = np.linalg.lstsq(rows, -np.concatenate([residual[rest], rough @ values]), rcond=None)[0]
        error = residual[~rest] + jacobian[~rest] @ step
        logarithms.append(np.log(error @ error))
    alone = Prediction(linearised(compiled), blocks).at(np.log(factors)).value
    both = Prediction(linearised(compiled, blocks=parts(compiled)), blocks).at(np.log(factors)).value
    balanced = [balanced_factor(block, linearised(compiled).matrix.diagonal()) for block in blocks]
    both -= np.sum((np.log(factors / balanced) / SPREAD) ** 2)
    assert (both - (1 - HOLDOUT_SHARE) * alone) / HOLDOUT_SHARE == pytest.approx(200 * np.mean(logarithms), rel=1e-6)


def test_a_sparse_matrix_gives_the_same_prediction(compiled):
    blocks, fit = [unit(compiled, "M", 0), unit(compiled, "M", 1)], linearised(compiled)
    dense, sparse = (Prediction(replace(fit, matrix=matrix), blocks) for matrix in (fit.matrix, csr_array(fit.matrix)))
    for at in POINTS:
        agree(sparse.at(at), dense.at(at), rel=1e-9)


def test_traces_by_probes_are_those_of_the_whole_inverse(compiled, monkeypatch):
    blocks, fit = [unit(compiled, "M", 0), unit(compiled, "M", 1)], linearised(compiled)
    whole = Prediction(fit, blocks)
    monkeypatch.setattr(prediction_error, "MAX_EXPLICIT", 0)
    probed = Prediction(fit, blocks)
    monkeypatch.setattr(prediction_error, "MAX_UNIT_PROBES", 0)
    monkeypatch.setattr(prediction_error, "RANDOM_PROBES", 4000)
    estimated = Prediction(fit, blocks)
    for at in POINTS:
        agree(probed.at(at), whole.at(at), rel=1e-9)
        assert estimated.freedom(at) == pytest.approx(whole.freedom(at), rel=0.02)


def in_units(fit, blocks, units):
    """The same linearised fit for values in other units."""
    matrix = fit.matrix * np.outer(units, units)
    other = replace(fit, values=fit.values / units, gradient=fit.gradient * units, matrix=matrix)
    return other, [Roughness(units.size, block.columns, block.coefficients * units[block.columns]) for block in blocks]


@pytest.mark.parametrize("decades", [0, 3])
def test_the_estimated_trace_has_the_error_that_its_probes_promise_in_all_units(compiled, monkeypatch, decades):
    """Its variance is at most 2 F / probes; signs on both sides of V H have no bound."""
    blocks, fit = [unit(compiled, "M", 0), unit(compiled, "M", 1)], linearised(compiled)
    whole = Prediction(fit, blocks)
    monkeypatch.setattr(prediction_error, "MAX_EXPLICIT", 0)
    monkeypatch.setattr(prediction_error, "MAX_UNIT_PROBES", 0)
    units = 10.0 ** np.random.default_rng(1).uniform(-decades, decades, fit.values.size)
    estimated = Prediction(*in_units(fit, blocks, units))
    for at in POINTS:
        exact = whole.freedom(at)
        assert abs(estimated.freedom(at) - exact) <= 3 * (2 * exact / prediction_error.RANDOM_PROBES) ** 0.5


def agree(point, other, rel):
    assert point.value == pytest.approx(other.value, rel=rel)
    assert point.slope == pytest.approx(other.slope, rel=rel, abs=1e-6)
    assert point.curvature == pytest.approx(other.curvature, rel=rel, abs=1e-6)


@pytest.mark.parametrize("count", [9, pytest.param(25, marks=pytest.mark.slow)])
def test_the_minimum_is_that_of_a_grid(prediction, count):
    bounds = np.full(2, -12.0), np.full(2, 12.0)
    minimum = minimise_prediction(prediction, np.zeros(2), *bounds)
    line = np.linspace(-12, 12, count)
    least = min(prediction.at(np.array([x, y])).value for x in line for y in line)
    assert prediction.at(minimum).value <= least + 0.05
