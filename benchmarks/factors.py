"""Topic `factors`: the Cholesky factor of the normal equations of one map, beside LAPACK and QDLDL.

All of them start from the blocks in which the sums over samples are stored. What depends on the non-zeros only, such as
the order of the values, is computed before.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.table import Table, seconds

__all__ = ["measure", "run"]

POINTS = (22, 40, 60)  # along each axis
SAMPLES, SMOOTHNESS, RIDGE = 20_000, 1e-2, 1e-6
RUNS = 25
COLUMNS = ("values", "bandwidth", "Kennfeld", "LAPACK pbtrf", "QDLDL", "inverse of Kennfeld", "dense inverse")


def run() -> list[Table]:
    """All sizes, on one core."""
    table = Table("factors: the normal equations of one map with smoothness", COLUMNS)
    for points in POINTS:
        outcome = apart("benchmarks.factors:measure", cores=1, points=points)
        if "error" in outcome:
            table.add(f"{points**2}", outcome["error"])
            continue
        times = (seconds(outcome[name]) for name in ("own", "pbtrf", "qdldl", "selected", "dense"))
        table.add(f"{points**2}", f"{outcome['bandwidth']}", *times)
    table.notes = [
        "CPU time from the blocks of the matrix to its factor, the shortest of several. `scipy.linalg.cholesky_banded` "
        "has the values in reverse Cuthill-McKee order; QDLDL has analysed the non-zeros before.",
        "Inverse of Kennfeld: factor and the entries of the inverse within its envelope, which give the deviations. "
        f"Load at the end {load()}.",
    ]
    return [table]


def measure(points: int) -> dict[str, Any]:
    """Durations in s, in a process of its own."""
    from kennfeld.native.cholesky import Cholesky
    from kennfeld.native.selected_inverse import SparseFactor
    from kennfeld.native.symmetric import scaled

    matrix = normal_matrix(points)
    size = matrix.shape[0]
    blocks, cholesky, none = scaled(matrix, np.ones(size)), Cholesky(size), np.zeros(size)
    factor = cholesky.factor(blocks, none)
    assert factor is not None
    right = np.random.default_rng(0).standard_normal(size)
    check(matrix, right, factor.solve(right))
    dense = matrix.toarray()
    pbtrf, bandwidth = banded(matrix, blocks)
    return {
        "bandwidth": bandwidth,
        "own": shortest(lambda: cholesky.factor(blocks, none)),
        "pbtrf": shortest(pbtrf),
        "qdldl": shortest(update_of_qdldl(matrix, blocks, right)) if installed("qdldl") else None,
        "selected": shortest(lambda: SparseFactor(matrix).diagonal, 5),
        "dense": shortest(lambda: np.linalg.inv(dense), 3),
    }


def normal_matrix(points: int) -> Any:
    """J'J of bilinear lookups in a map, with second differences along both axes; a scipy.sparse array."""
    from scipy.sparse import csr_array, diags_array, eye_array, kron, vstack

    x, y = np.random.default_rng(0).uniform(0, points - 1, (2, SAMPLES))
    i, j = np.minimum(x.astype(int), points - 2), np.minimum(y.astype(int), points - 2)
    u, v = x - i, y - j
    weights = np.concatenate([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v])
    first = i * points + j
    columns = np.concatenate([first, first + 1, first + points, first + points + 1])
    rows = np.tile(np.arange(SAMPLES), 4)
    jacobian = csr_array((weights, (rows, columns)), shape=(SAMPLES, points**2))
    difference, same = diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(points - 2, points)), eye_array(points)
    rough = vstack([kron(difference, same), kron(same, difference)])
    return csr_array(jacobian.T @ jacobian + SMOOTHNESS * rough.T @ rough + RIDGE * eye_array(points**2))


def banded(matrix: Any, blocks: Any) -> tuple[Callable[[], object], int]:
    """A factorisation by LAPACK from the blocks, and the bandwidth."""
    from scipy.linalg import cholesky_banded
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    size = matrix.shape[0]
    place = np.empty(size, dtype=np.int64)
    place[reverse_cuthill_mckee(matrix, symmetric_mode=True)] = np.arange(size)
    rows, columns, _ = blocks.nonzeros()
    low, high = np.sort([place[rows], place[columns]], axis=0)
    bandwidth, stored = int((high - low).max()), stored_entries(blocks)

    def factor() -> object:
        band = np.zeros((bandwidth + 1, size), order="F")
        band[high - low, low] = blocks.storage.blocks.ravel()[stored]
        return cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)

    return factor, bandwidth


def update_of_qdldl(matrix: Any, blocks: Any, right: NDArray[np.float64]) -> Callable[[], object]:
    """A factorisation by QDLDL from the blocks, after it has analysed the non-zeros."""
    import qdldl
    from scipy.sparse import csc_array, csc_matrix, triu

    upper = csc_array(triu(matrix))
    upper.sort_indices()
    rows, columns, values = blocks.nonzeros()
    numbered = csc_array((np.arange(1.0, values.size + 1), (columns, rows)), shape=matrix.shape)
    numbered.sort_indices()
    stored = stored_entries(blocks)[numbered.data.astype(np.int64) - 1]
    assert np.array_equal(numbered.indices, upper.indices)
    work = csc_matrix((upper.data.copy(), upper.indices, upper.indptr), shape=upper.shape)
    solver = qdldl.Solver(work, upper=True)

    def factor() -> None:
        work.data[:] = blocks.storage.blocks.ravel()[stored]
        solver.update(work, upper=True)

    factor()
    check(matrix, right, solver.solve(right))
    return factor


def stored_entries(blocks: Any) -> NDArray[np.int64]:
    """Where the non-zeros lie in the blocks, in the order of `nonzeros`."""
    numbers, inside = np.nonzero(blocks.storage.blocks[: blocks.storage.count])
    return np.asarray(numbers * blocks.storage.blocks.shape[1] + inside)


def check(matrix: Any, right: NDArray[np.float64], solution: NDArray[np.float64]) -> None:
    """Check a solution by its residual."""
    np.testing.assert_allclose(matrix @ solution, right, rtol=0, atol=1e-8 * np.abs(right).max())


def shortest(work: Callable[[], object], runs: int = RUNS) -> float:
    """The shortest CPU time of several calls, in s."""
    durations = []
    for _ in range(runs + 1):
        began = time.process_time()
        work()
        durations.append(time.process_time() - began)
    return min(durations[1:])
