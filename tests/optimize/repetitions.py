"""One measurement repeated many times: the same problem with other noise, compiled once."""

import numpy as np
import pytest
import scipy

from kennfeld.base.threads import blas_threads
from kennfeld.native import Samples
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.limits.projection import project
from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.optimize.sums.objective import LeastSquaresObjective


def repeated(problem, truth, noise, count, seed=0):
    """Values found from so many measurements of the true model, shape (count, values), in the order of the parameters.

    `noise(rng, samples)` draws what is added to the model's output.
    """
    compiled = CompiledProblem(problem)
    targets = own_targets(compiled)
    objective, limits = LeastSquaresObjective(compiled), linear_limits(problem, compiled.values)
    full, free = compiled.values.pack(truth), compiled.values.free
    visits = slice(None) if compiled.samples.order is None else compiled.samples.order
    clean = outputs(compiled, full)
    start, _ = project(full[:free].copy(), limits)
    rng = np.random.default_rng(seed)
    ends = []
    with blas_threads(free):
        for _ in range(count):
            targets[:, visits] = clean + noise(rng, clean.shape[1])
            compiled.samples.wanted.reread()
            ends.append(levenberg_marquardt(objective, start, limits, SolverSettings(tolerance=1e-6)).values)
    order = [compiled.values.offsets[name] + np.arange(truth[name].size) for name in problem.free_names]
    return np.array(ends)[:, np.concatenate(order)]


def own_targets(compiled):
    """Targets of 0 that the compiled problem reads from now on, shape (outputs, samples)."""
    samples = compiled.samples
    targets = np.zeros((len(compiled.problem.criteria), samples.wanted.count))
    compiled.samples = Samples(samples.inputs.parts, targets, samples.pieces, samples.order)
    compiled.sums = compiled.sums_over(compiled.samples)
    return targets


def outputs(compiled, full):
    """Outputs of the model at each visit: its residual against targets of 0, which no weight changes."""
    assert all(c.weight == c.scale == 1.0 and c.loss == "square" for c in compiled.problem.criteria)
    residual, _ = compiled.sums.rows(full)
    return residual.reshape(-1, len(compiled.problem.criteria)).T.copy()


FEW, MANY = 30, 200
counts = pytest.mark.parametrize(
    "count", [pytest.param(FEW, id="few"), pytest.param(MANY, id="many", marks=pytest.mark.slow)]
)


def agree(covariance, ends):
    """Check that values scatter with a covariance, as closely as so many of them tell; return how many scatter."""
    return (_agree_closely if len(ends) >= 200 else _agree_roughly)(covariance, ends)


def _agree_roughly(covariance, ends):
    """Each variance, and the sum over all mixtures of values, within the bounds of chi-square.

    With 25 refits, a variance may be between 0.26 and 2.6 times what is said. The sum over 35 mixtures has 840 degrees
    of freedom: it leaves the bounds if deviations are 10 % too large or too small.
    """
    units = np.sqrt(np.diag(covariance))
    moving = units > 0
    assert np.std(ends[:, ~moving], axis=0) == pytest.approx(0.0, abs=1e-6)
    units, freedom = units[moving], len(ends) - 1
    away = (ends[:, moving] - ends[:, moving].mean(axis=0)) / units
    squares = np.sum(away**2, axis=0)
    assert np.all((squares > scipy.stats.chi2.ppf(1e-4, freedom)) & (squares < scipy.stats.chi2.isf(1e-4, freedom))), (
        squares / freedom
    )
    values, vectors = np.linalg.eigh(covariance[np.ix_(moving, moving)] / np.outer(units, units))
    significant = values > 1e-9 * values[-1]
    whole, freedoms = (
        np.sum((away @ vectors[:, significant]) ** 2 / values[significant]),
        freedom * int(significant.sum()),
    )
    assert scipy.stats.chi2.ppf(1e-4, freedoms) < whole < scipy.stats.chi2.isf(1e-4, freedoms), whole / freedoms
    return int(moving.sum())


def _agree_closely(covariance, ends):
    """Each variance, and all mixtures of values, within sampling error."""
    deviation = np.sqrt(np.diag(covariance))
    moving = deviation > 0
    assert np.std(ends[:, ~moving], axis=0) == pytest.approx(0.0, abs=1e-6)
    count, size = len(ends), int(moving.sum())
    units = deviation[moving]
    ratio = np.var(ends[:, moving], axis=0, ddof=1) / units**2
    spread = np.sqrt(2 / count)
    assert ratio.mean() == pytest.approx(1.0, abs=0.08)
    assert np.all(np.abs(ratio - 1) < 4.5 * spread), ratio
    values, vectors = np.linalg.eigh(covariance[np.ix_(moving, moving)] / np.outer(units, units))
    significant = values > 1e-9 * values[-1]
    mixtures = (ends[:, moving] / units) @ (vectors[:, significant] / np.sqrt(values[significant]))
    eigenvalues = np.linalg.eigvalsh(np.cov(mixtures.T))
    edge = np.sqrt(significant.sum() / count)  # of Marchenko and Pastur
    assert (1 - edge) ** 2 * 0.8 < eigenvalues[0]
    assert eigenvalues[-1] < (1 + edge) ** 2 * 1.2
    return size
