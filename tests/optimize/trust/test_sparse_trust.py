"""The trust of many values, from sparse matrices, is that from dense ones."""

import numpy as np
import pytest
from scipy.sparse import csr_array, eye_array

import kennfeld as kf
from kennfeld.domain.constraints import Limit, Shape
from kennfeld.optimize import Problem, run
from kennfeld.optimize.trust import matrices
from kennfeld.optimize.trust.information_matrix import Spectrum, nullity
from kennfeld.optimize.trust.inverse import DenseInverse, SparseInverse
from tests.draws import mostly_slow
from tests.optimize.trust.sparse_matrices import curvature, lookups

PLAIN = kf.Options(continuation="off")


def open_matrix(dimension, seed=0):
    """A curvature with so many directions open: so many rows of a map that a further value of each shifts as well."""
    jacobian = lookups(20, 21, 3000, seed)
    tied = jacobian.reshape(-1, 20, 21).sum(axis=2)[:, :dimension]
    return curvature(np.hstack([jacobian, tied]))


@pytest.mark.parametrize("dimension", mostly_slow([0, 1, 9], [0, 9]))
@pytest.mark.parametrize("unit", mostly_slow([1.0, 1e6], [1e6]))
def test_a_sparse_spectrum_is_the_dense_one(dimension, unit):
    matrix = open_matrix(dimension)
    units = unit ** np.random.default_rng(3).uniform(-1, 1, len(matrix))
    matrix = matrix * units * units[:, None]
    dense, sparse = Spectrum.of_matrix(matrix), Spectrum.of_sparse(csr_array(matrix), csr_array(matrix))
    assert isinstance(dense.inverse, DenseInverse)
    assert isinstance(sparse.inverse, SparseInverse)
    assert sparse.null.shape[1] == dense.null.shape[1] == dimension
    np.testing.assert_allclose(sparse.null @ sparse.null.T, dense.null @ dense.null.T, atol=1e-9)
    np.testing.assert_allclose(sparse.weakness, dense.weakness, rtol=0.05)  # only what stands out is exact
    np.testing.assert_array_equal(sparse.loose, dense.loose)
    np.testing.assert_allclose(sparse.inverse.diagonal, dense.inverse.diagonal, rtol=1e-7)
    assert sparse.inverse.trace(csr_array(matrix)) == pytest.approx(len(matrix) - dimension)
    part = 0.3 * matrix
    np.testing.assert_allclose(sparse.inverse.sandwich(csr_array(part)), dense.inverse.sandwich(part), rtol=1e-7)
    rows = np.random.default_rng(4).normal(size=(5, len(matrix))) * units
    np.testing.assert_allclose(sparse.inverse.times(rows) * units, dense.inverse.times(rows) * units, atol=1e-6)
    assert sparse.inverse.times(rows[0]).shape == units.shape


@pytest.mark.parametrize("dimension", mostly_slow([0, 2], [2]))
def test_weak_directions_are_those_of_all_eigenvectors(dimension):
    matrix = open_matrix(dimension)
    nearly = np.zeros((len(matrix), len(matrix)))
    nearly[50:60, 50:60] = 1.0  # what ten values have in common is known 1e4 times better than their differences
    matrix[50:60, :] *= 1e-4
    matrix[:, 50:60] *= 1e-4
    matrix += nearly
    dense, sparse = Spectrum.of_matrix(matrix), Spectrum.of_sparse(csr_array(matrix), csr_array(matrix))
    assert dense.weakness[8] < 1e-6 < 1e-2 < dense.weakness[9]
    np.testing.assert_allclose(sparse.weakness[:9], dense.weakness[:9], rtol=1e-6)
    weak = [each.weak[:, :9] @ each.weak[:, :9].T for each in (dense, sparse)]
    np.testing.assert_allclose(*weak, atol=1e-6)


def test_all_eigenvalues_are_computed_if_most_directions_are_undetermined():
    matrix = curvature(lookups(9, 11, 30))
    where = np.diag(matrix) > 0
    matrix = matrix[np.ix_(where, where)]
    spectrum = Spectrum.of_sparse(csr_array(matrix), csr_array(matrix))
    assert isinstance(spectrum.inverse, DenseInverse)
    assert spectrum.null.shape[1] == Spectrum.of_matrix(matrix).null.shape[1] > len(matrix) // 4


@pytest.mark.parametrize("dimension", mostly_slow([0, 1, 9], [0, 9]))
def test_undetermined_directions_are_counted_in_a_sparse_matrix(dimension):
    matrix = open_matrix(dimension)
    assert nullity(csr_array(matrix)) == nullity(matrix) == dimension


def test_only_large_matrices_of_few_entries_are_sparse():
    assert not matrices.should_be_sparse(np.eye(1000))
    assert matrices.should_be_sparse(np.eye(1001), np.eye(1001))
    assert not matrices.should_be_sparse(np.ones((1001, 1001)))


def test_parts_and_units_are_those_of_the_dense_matrix():
    matrix = curvature(lookups(4, 5, 100))
    which = np.arange(20) % 3 > 0
    for index in (which, np.flatnonzero(which)):
        np.testing.assert_array_equal(
            matrices.whole(matrices.part(csr_array(matrix), index)), matrices.part(matrix, index)
        )
    units = np.arange(1.0, 21.0)
    np.testing.assert_allclose(
        matrices.whole(matrices.rescale(csr_array(matrix), units)), matrices.rescale(matrix, units)
    )
    assert matrices.part(matrix, np.arange(20)) is matrix
    assert (eye_array(3).tocsr() != csr_array(matrices.whole(np.eye(3)))).nnz == 0


def bench(text, members, smoothness=0.0, pins=(), constraints=(), criteria=None, weights=(1.0,), outputs=()):
    random = np.random.default_rng(5)
    start = kf.ParameterSet(members)
    model = kf.formula(text, parameters=list(start))
    data = []
    for number, weight in enumerate(weights):
        x, z = (random.uniform(0, axis.breakpoints[-1], 10 * members[0].size) for axis in members[0].axes)
        y = np.sin(x / 2) * z + 0.1 * (number + 1) * random.normal(size=x.size)
        data.append(kf.Dataset.of(f"bench {number}", {"x": x, "z": z, "y": y}, weight=weight))
    return Problem(
        model,
        tuple(data),
        start,
        criteria or (kf.Criterion("m", "y"),),
        smoothness=dict.fromkeys(start, smoothness),
        pins=tuple(pins),
        constraints=tuple(constraints),
        limits=tuple(outputs),
    )


def table(rows=10, columns=9, locked=False):
    return kf.Map("A", np.arange(1.0 * rows), np.arange(1.0 * columns), np.zeros((rows, columns)), locked=locked)


OPEN = [table(18, 16), kf.Curve("B", np.arange(18.0), np.ones(18))]  # so large that not most directions are open
CORNER = np.add.outer(np.arange(10), np.arange(9)) < 4
PROBLEMS = {
    "smooth": bench("m = A(x, z)", [table()], 0.1),
    "plain": bench("m = A(x, z)", [table()]),
    "open": bench("m = A(x, z) + B(x)", OPEN),
    "open and smooth": bench("m = A(x, z) + B(x)", OPEN, 0.1),
    "product": bench("m = A(x, z) * B(x)", [table(), kf.Curve("B", np.arange(10.0), np.ones(10))], 0.01),
    "datasets of two weights": bench("m = A(x, z)", [table()], 0.1, weights=(1.0, 4.0)),
    "robust": bench("m = A(x, z)", [table()], 0.1, criteria=(kf.Criterion("m", "y", loss="huber", delta=0.1),)),
    "pins": bench("m = A(x, z)", [table()], 0.1, pins=[kf.Pin("A", (0.5, 3.5), 2.0), kf.Pin("A", (4.0, 2.0), 1.0)]),
    "locks": bench("m = A(x, z)", [table(locked=CORNER)], 0.1),
    "rising": bench("m = A(x, z)", [table()], 0.1, constraints=[Shape("A", 1, "slope", lower=0.0)]),
    "output": bench("m = A(x, z)", [table()], 0.1, outputs=[Limit("m", upper=7.2)]),
}


@pytest.mark.parametrize("name", mostly_slow(PROBLEMS, ["open and smooth", "datasets of two weights"]))
def test_the_trust_equals_that_of_dense_matrices(name, monkeypatch):
    expected = run(PROBLEMS[name], PLAIN).trust
    monkeypatch.setattr(matrices, "LARGE", 10)
    monkeypatch.setattr(matrices, "FEW", 1.0)
    trust = run(PROBLEMS[name], PLAIN).trust
    assert not isinstance(trust.estimate.data, np.ndarray)
    assert isinstance(trust.estimate.spectrum.inverse, SparseInverse)
    assert trust.freedom == pytest.approx(expected.freedom, rel=1e-6)
    assert trust.noise == pytest.approx(expected.noise, rel=1e-6)
    assert str(trust) == str(expected)
    assert trust.null_space.as_json() == expected.null_space.as_json()
    slack = 1e-3 if name == "output" else 1e-7  # samples that touch a limit tell nearly the same, and rounding chooses
    for which in ("deviation", "scatter", "leverage"):
        for table_name, values in getattr(expected, which).items():
            np.testing.assert_allclose(getattr(trust, which)[table_name], values, rtol=1e-5, atol=slack, err_msg=which)
    covariance = expected.covariance()
    largest = np.abs(covariance[np.isfinite(covariance)]).max(initial=0.0)
    np.testing.assert_allclose(
        trust.covariance(), covariance, rtol=1e-5, atol=max(1e-6, 10 * slack if name == "output" else slack) * largest
    )


@pytest.mark.parametrize("seed", range(30))
def test_directions_without_curvature_are_counted_by_the_signs_of_pivots(seed):
    """Many values are shared by few rows each, so that pivots of determined values may be small."""
    random = np.random.default_rng(seed)
    size, missing = int(random.integers(30, 200)), int(random.integers(0, 8))
    jacobian = np.zeros((size - missing, size))
    for row in jacobian:
        first = random.integers(0, size - 4)
        row[first : first + 4] = random.normal(size=4)
    jacobian = jacobian[:, np.any(jacobian, axis=0)] * 10.0 ** random.uniform(-3, 3, np.any(jacobian, axis=0).sum())
    matrix = jacobian.T @ jacobian
    units = matrix / np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
    assert nullity(csr_array(matrix)) == np.count_nonzero(np.linalg.eigvalsh(units) < 1e-10)
