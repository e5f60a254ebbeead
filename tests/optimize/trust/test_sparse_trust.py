"""The trust of many values, from sparse matrices, is that from dense ones."""

import numpy as np
import pytest
from scipy.sparse import csr_array, eye_array

import kennfeld as kf
from kennfeld.domain.constraints import Limit, Shape
from kennfeld.optimize import Problem, run
from kennfeld.optimize.trust import matrices
from kennfeld.optimize.trust.block_factor import BLOCK, BlockFactor
from kennfeld.optimize.trust.information_matrix import Spectrum, nullity
from kennfeld.optimize.trust.inverse import DenseInverse, SparseInverse
from tests.draws import mostly_slow

PLAIN = kf.Options(continuation="off")


def lookups(rows, columns, count, seed=0, shared=0):
    """Random bilinear lookups in a map, as the rows of a Jacobian; all samples touch `shared` more values."""
    random = np.random.default_rng(seed)
    x, y = random.uniform(0, rows - 1, count), random.uniform(0, columns - 1, count)
    jacobian = np.zeros((count, rows * columns + shared))
    i, j = np.minimum(x.astype(int), rows - 2), np.minimum(y.astype(int), columns - 2)
    u, v = x - i, y - j
    for a, b, weight in ((0, 0, (1 - u) * (1 - v)), (0, 1, (1 - u) * v), (1, 0, u * (1 - v)), (1, 1, u * v)):
        jacobian[np.arange(count), (i + a) * columns + j + b] = weight
    jacobian[:, rows * columns :] = random.normal(size=(count, shared))
    return jacobian


def curvature(jacobian):
    return jacobian.T @ jacobian


@pytest.fixture(params=[(1, 20), (9, 11), (13, 20)], ids=str)
def matrix(request):
    rows, columns = request.param
    jacobian = lookups(max(rows, 2), columns, 40 * rows * columns, shared=2)
    return curvature(jacobian) + 0.01 * np.eye(jacobian.shape[1])


def test_a_factor_solves_and_gives_entries_of_the_inverse(matrix):
    factor, inverse = BlockFactor(csr_array(matrix)), np.linalg.inv(matrix)
    right = np.random.default_rng(1).normal(size=(len(matrix), 3))
    assert factor.negative == 0
    np.testing.assert_allclose(factor.solve(right), inverse @ right, rtol=1e-9, atol=1e-9)
    assert factor.solve(right[:, :0]).shape == (len(matrix), 0)
    np.testing.assert_allclose(factor.diagonal, np.diag(inverse), rtol=1e-9)


def test_the_trace_and_the_diagonal_of_products_with_the_inverse(matrix):
    inverse = np.linalg.inv(matrix)
    other = matrix * (np.random.default_rng(2).uniform(size=matrix.shape) < 0.5)
    other = other + other.T
    factor = BlockFactor(csr_array(matrix))
    assert factor.trace(csr_array(other)) == pytest.approx(np.trace(inverse @ other), rel=1e-9)
    expected = np.diag(inverse @ other @ inverse)
    np.testing.assert_allclose(factor.sandwich(csr_array(other)), expected, atol=1e-9 * np.abs(expected).max())


def test_a_pattern_makes_room_for_matrices_with_other_zeros():
    tied = np.diag([2.0, 2.0, 2.0]) + 0.5
    factor = BlockFactor(csr_array(np.diag([1.0, 2.0, 4.0])), csr_array(tied))
    assert factor.trace(csr_array(tied)) == pytest.approx(2.5 * 1.75)
    np.testing.assert_allclose(factor.sandwich(csr_array(tied)), 2.5 / np.array([1.0, 4.0, 16.0]))


@pytest.mark.parametrize("size", [1, BLOCK - 1, BLOCK, BLOCK + 1, 3 * BLOCK])
def test_any_size_fills_whole_blocks(size):
    random = np.random.default_rng(size)
    matrix = np.diag(random.uniform(1, 2, size))
    if size > 1:
        matrix += np.diag(np.full(size - 1, 0.3), 1) + np.diag(np.full(size - 1, 0.3), -1)
    factor = BlockFactor(csr_array(matrix))
    np.testing.assert_allclose(factor.diagonal, np.diag(np.linalg.inv(matrix)), rtol=1e-12)


def test_the_signs_of_a_factor_count_eigenvalues_that_are_not_positive():
    matrix = curvature(lookups(8, 12, 4000))
    scale = np.sqrt(np.diag(matrix))
    matrix = matrix / scale / scale[:, None]
    values = np.linalg.eigvalsh(matrix)
    for count in (0, 1, 5, 50):
        shift = 0.5 * (values[count - 1] + values[count]) if count else 0.5 * values[0]
        assert BlockFactor(csr_array(matrix - shift * np.eye(len(matrix)))).negative == count


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


def test_where_most_directions_are_open_all_eigenvalues_are_taken():
    matrix = curvature(lookups(9, 11, 30))
    where = np.diag(matrix) > 0
    matrix = matrix[np.ix_(where, where)]
    spectrum = Spectrum.of_sparse(csr_array(matrix), csr_array(matrix))
    assert isinstance(spectrum.inverse, DenseInverse)
    assert spectrum.null.shape[1] == Spectrum.of_matrix(matrix).null.shape[1] > len(matrix) // 4


@pytest.mark.parametrize("dimension", mostly_slow([0, 1, 9], [0, 9]))
def test_open_directions_are_counted_in_a_sparse_matrix(dimension):
    matrix = open_matrix(dimension)
    assert nullity(csr_array(matrix)) == nullity(matrix) == dimension


def test_sparse_is_for_large_matrices_of_few_entries():
    assert not matrices.should_be_sparse(np.eye(1000))
    assert matrices.should_be_sparse(np.eye(1001), np.eye(1001))
    assert not matrices.should_be_sparse(np.ones((1001, 1001)))


def test_parts_and_units_are_those_of_the_dense_matrix():
    matrix = curvature(lookups(4, 5, 100))
    which = np.arange(20) % 3 > 0
    for given in (which, np.flatnonzero(which)):
        np.testing.assert_array_equal(
            matrices.whole(matrices.part(csr_array(matrix), given)), matrices.part(matrix, given)
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
def test_what_is_said_of_a_fit_is_what_dense_matrices_say(name, monkeypatch):
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
