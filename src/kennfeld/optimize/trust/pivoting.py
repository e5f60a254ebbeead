"""Bases of a space of changes that do not depend on how an eigenvalue routine happens to turn and sign them."""

import numpy as np

from kennfeld.arrays import Float, Int
from kennfeld.optimize.trust.block_factor import BlockFactor
from kennfeld.optimize.trust.matrices import Matrix, scaled

__all__ = ["echelon", "nullity", "pivots"]

TIE = 1e-2  # relative preference of the first value to the last, so that rounding errors break no tie
SOUND = 1e-10  # of a unit diagonal: what a value must add to be no combination of the others


def pivots(basis: Float, preference: Float | None = None) -> Int:
    """Choose as many values as there are columns, such that no change in the space leaves all of them as they are.

    Pivoted QR picks the value that takes most part in what the values before it leave. As the parts are norms over all
    columns, any other orthonormal basis of the space gives the same choice.

    Args:
        basis: orthonormal columns, shape (values, dimension).
        preference: factor on the part of each value; by default all count alike. Shape (values,).

    Returns:
        The numbers of the values, the first choice first; shape (dimension,).

    >>> pivots(np.array([[0.6], [0.8]])), pivots(np.array([[0.6], [0.8]]), np.array([1.0, 0.1]))
    (array([1]), array([0]))
    """
    size, dimension = basis.shape
    if not dimension:
        return np.zeros(0, dtype=np.int64)
    from scipy.linalg import qr

    weight = 1.0 - TIE * np.arange(size) / size
    if preference is not None:
        weight = weight * preference
    _, order = qr((basis * weight[:, None]).T, mode="r", pivoting=True)
    found: Int = order[:dimension].astype(np.int64)
    return found


def echelon(basis: Float, pivots: Int, most: int | None = None) -> Float:
    """Return the columns that change one pivot by 1 and the other pivots by 0, those of the first `most` pivots.

    >>> echelon(np.array([[0.6], [0.8]]), np.array([0])).round(3).tolist()
    [[1.0], [1.333]]
    """
    count = pivots.size if most is None else min(most, pivots.size)
    found: Float = basis @ np.linalg.solve(basis[pivots], np.eye(pivots.size)[:, :count])
    return found


def nullity(matrix: Matrix) -> int:
    """Count the directions in which a positive semidefinite matrix is zero, relative to its diagonal; that is > 0.

    >>> nullity(np.array([[1.0, 2.0], [2.0, 4.0]]))
    1
    """
    units = scaled(matrix, 1 / np.sqrt(matrix.diagonal()))
    if not isinstance(units, np.ndarray):
        from scipy.sparse import csr_array, eye_array

        return BlockFactor(csr_array(units - SOUND * eye_array(units.shape[0]))).negative
    try:
        np.linalg.cholesky(units - SOUND * np.eye(len(units)))
    except np.linalg.LinAlgError:
        from scipy.linalg.lapack import dpstrf

        return len(units) - int(dpstrf(units, tol=SOUND, lower=1)[2])
    return 0
