"""Analysis of an information matrix: elimination of active constraints, inverse, null space and weak directions.

Bases of null spaces and of repeated eigenvalues are chosen so that they do not depend on the eigenvalue routine.
"""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int, Sparse
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import blas_threads
from kennfeld.native.selected_inverse import SparseFactor
from kennfeld.optimize.trust.inverse import DenseInverse, Inverse, SparseInverse
from kennfeld.optimize.trust.matrices import Matrix, part, rescale, whole

REDUNDANT = 1e-10  # of a row's largest coefficient: what remains of a row that follows from others

TIE = 1e-2  # relative preference of the first value to the last, so that rounding errors break no tie
RANK_TOLERANCE = 1e-10  # of a unit diagonal: what a value must add to be no combination of the others

NOTHING = 1e-12  # share of the largest eigenvalue, or singular value, that is rounding
SOUND = 1e10  # largest variance of a value, in units of that it has alone, up to which an inverse is taken as it is
PART = 1e-8  # share of a value in undetermined directions, squared, that is not rounding
ALIKE = 1e-6  # relative difference up to which eigenvalues are one
WEAKEST = 20  # how many directions are looked at
LARGE, BLOCK = 1000, 256  # values from which an inverse is worth another library; rows at a time
SHIFT = 1e-11  # of the diagonal, so that a matrix with open directions has an inverse
MANY = 4  # share of values, one in so many, up to which open directions are looked for one by one
ROUNDS = 8  # of subspace iteration: what is ten times weaker than the rest is then exact


@dataclass(frozen=True)
class ConstraintElimination:
    """Values p of which some are fixed, and others follow the `independent` ones through linear equalities.

    A change q of the independent values changes the `dependent` ones by `follow @ q`, and the fixed ones not at all.

    >>> reduction = ConstraintElimination.of(np.array([False, False, True]), np.array([[1.0, 2.0, 0.0]]))
    >>> reduction.independent, reduction.expand(np.array([2.0]))
    (array([0]), array([ 2., -1.,  0.]))
    """

    size: int
    independent: Int
    dependent: Int
    follow: Float  # Float[dependent, independent]

    @classmethod
    def of(cls, fixed: Bool, rows: Float) -> "ConstraintElimination":
        """Eliminate one value per row, Float[rows, values], that of the largest coefficient; drop redundant rows."""
        moving = np.flatnonzero(~fixed)
        work = np.array(rows[:, moving], dtype=np.float64)
        # of the rows as they were: what elimination leaves is compared with it
        typical = np.abs(work).max(axis=1, initial=0.0)
        pivots: list[int] = []
        used: list[int] = []
        for _ in range(len(work) if work.size else 0):
            # Gauss-Jordan elimination by the largest share of any row, so that redundant rows are left as rounding
            shares = np.abs(work) / np.where(typical > 0, typical, 1.0)[:, None]
            shares[used] = 0.0
            row, column = np.unravel_index(int(shares.argmax()), shares.shape)
            if shares[row, column] <= REDUNDANT:
                break
            work[row] /= work[row, column]
            others = np.arange(len(work)) != row
            work[others] -= np.outer(work[others, column], work[row])
            used.append(int(row))
            pivots.append(int(column))
        rest = np.setdiff1d(np.arange(moving.size), pivots)
        return cls(fixed.size, moving[rest], moving[pivots], -work[used][:, rest])

    @property
    def fixed(self) -> Bool:
        """Mask of the values that never change, Bool[values]."""
        fixed = np.ones(self.size, dtype=bool)
        fixed[self.independent] = False
        fixed[self.dependent] = ~self.follow.any(axis=1)
        return fixed

    def expand(self, changes: Float) -> Float:
        """Expand changes of the independent values, Float[..., independent], to changes of all, Float[..., values]."""
        full = np.zeros((*changes.shape[:-1], self.size))
        full[..., self.independent] = changes
        full[..., self.dependent] = changes @ self.follow.T
        return full

    def matrix(self, matrix: Matrix) -> Matrix:
        """Reduce M, [values, values], to Z'MZ with the Z of `expand`; M itself if all values are independent."""
        own = part(matrix, self.independent)
        if not self.dependent.size:
            return own
        follow = self.follow
        if not isinstance(matrix, np.ndarray):
            from scipy.sparse import csr_array

            follow = csr_array(follow)
        # Z = [1; F] over independent and dependent values: M_ii + F'M_di + M_id F + F'M_dd F
        cross = follow.T @ matrix[self.dependent][:, self.independent]
        return own + cross + cross.T + follow.T @ part(matrix, self.dependent) @ follow

    def vector(self, vector: Float) -> Float:
        """Reduce a gradient v, Float[values], to Z'v, Float[independent]."""
        return vector[self.independent] + self.follow.T @ vector[self.dependent]

    def rows(self, rows: Float) -> Float:
        """Convert rows over all values, Float[rows, values], to rows over the independent ones."""
        return rows[:, self.independent] + rows[:, self.dependent] @ self.follow


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

    # slightly more weight for earlier values decides ties
    weight = (1.0 - TIE * np.arange(size) / size) * (1.0 if preference is None else preference)
    order: Int = qr((basis * weight[:, None]).T, mode="r", pivoting=True)[1]
    return order[:dimension].astype(np.int64)


def echelon(basis: Float, pivots: Int, most: int | None = None) -> Float:
    """Combine columns, Float[values, dimension], to those that change one of the first `most` pivots by 1, others by 0.

    >>> echelon(np.array([[0.6], [0.8]]), np.array([0])).round(3).tolist()
    [[1.0], [1.333]]
    """
    count = pivots.size if most is None else min(most, pivots.size)
    return basis @ np.linalg.solve(basis[pivots], np.eye(pivots.size)[:, :count])


def nullity(matrix: Matrix) -> int:
    """Count the directions in which a positive semidefinite matrix is zero, relative to its diagonal, which is > 0.

    >>> nullity(np.array([[1.0, 2.0], [2.0, 4.0]]))
    1
    """
    units = rescale(matrix, 1 / np.sqrt(matrix.diagonal()))
    if not isinstance(units, np.ndarray):
        from scipy.sparse import csr_array, eye_array

        shifted = csr_array(units - RANK_TOLERANCE * eye_array(units.shape[0]))
        return 0 if SparseFactor(shifted).is_definite else _count_negative(shifted)
    try:
        np.linalg.cholesky(units - RANK_TOLERANCE * np.eye(len(units)))
    except np.linalg.LinAlgError:
        from scipy.linalg.lapack import dpstrf

        # pivoted Cholesky factorisation, which ends at the rank; loaded only if the plain one fails
        return len(units) - int(dpstrf(units, tol=RANK_TOLERANCE, lower=1)[2])
    return 0


def _count_negative(matrix: Sparse) -> int:
    """Count the negative eigenvalues of a sparse symmetric matrix.

    By Sylvester's law of inertia, they are as many as the negative pivots of L D L'. SuperLU computes these as those of
    L U if it takes them from the diagonal in the order of the columns, which it leaves only where one vanishes.
    """
    from scipy.sparse import csc_array, eye_array
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    for shift in (0.0, 1e-3, 3e-3):  # a pivot that vanishes does so for one shift only
        shifted = csc_array(matrix - shift * RANK_TOLERANCE * eye_array(matrix.shape[0]))
        with suppress(RuntimeError):  # singular
            factor = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
            if np.array_equal(factor.perm_r, factor.perm_c):
                return int(np.count_nonzero(factor.U.diagonal() < 0))
    return int(np.count_nonzero(np.linalg.eigvalsh(matrix.toarray()) < 0))


@dataclass(frozen=True)
class Spectrum:
    """The inverse of H, and its weakest directions in units of `scale`, the root of its diagonal.

    `null` are orthonormal directions that H does not determine at all; the inverse is 0 along them.
    `weak` are the least determined eigenvectors among the others, with their eigenvalues `weakness`.
    """

    scale: Float  # Float[values]
    inverse: Inverse  # of H itself
    null: Float  # Float[values, undetermined]
    weak: Float  # Float[values, directions]
    weakness: Float  # Float[directions], ascending

    @classmethod
    def of_matrix(cls, matrix: Float) -> "Spectrum":
        """Analyse H, Float[values, values]; if nearly singular by its eigenvalues, which cost five times an inverse."""
        scale = np.sqrt(np.diag(matrix))
        units = rescale(matrix, 1 / scale)
        inverse = _sound_inverse(units)
        if inverse is None:
            values, vectors = np.linalg.eigh(units)
            return cls._of(scale, values, vectors, int(np.sum(values <= NOTHING * values[-1:])))
        weakness, weak = _weakest(lambda basis: inverse @ basis, scale.size)
        inverse /= scale
        inverse /= scale[:, None]
        return cls(scale, DenseInverse(inverse), np.zeros((scale.size, 0)), weak, weakness)

    @classmethod
    def of_sparse(cls, matrix: Sparse, pattern: Sparse) -> "Spectrum":
        """Analyse a sparse H, [values, values], by its factor.

        `pattern` has the non-zeros of H and of all matrices that will be multiplied with the inverse.
        """
        return cls._by_factor(matrix, pattern) or cls.of_matrix(whole(matrix))

    @classmethod
    @blas_threads(WEAKEST)
    def _by_factor(cls, matrix: Sparse, pattern: Sparse) -> "Spectrum | None":
        """Analyse a sparse H; None if so much is undetermined that its eigenvalues cost no more."""
        scale = np.sqrt(matrix.diagonal())
        none = np.zeros((scale.size, 0))
        inverse = SparseInverse(matrix, pattern, scale, none, np.zeros(0, dtype=np.int64))
        # mostly nothing is undetermined, and the first factor is all that is needed
        if inverse.factor.is_definite and bool(np.all(inverse.factor.diagonal < SOUND)):
            weakness, weak = _weakest(inverse.factor.solve, scale.size)
            return cls(scale, inverse, none, weak, weakness)
        lowest = _lowest(rescale(matrix, 1 / scale))
        if lowest is None:
            return None
        values, vectors, null = lowest
        # with as many values fixed as there are null directions, the rest is positive definite
        loose, weakest = vectors[:, :null], slice(null, null + WEAKEST)
        inverse = SparseInverse(matrix, pattern, scale, loose, pivots(loose))
        if not inverse.factor.is_definite:
            return None
        return cls(scale, inverse, loose, vectors[:, weakest], values[weakest])

    @classmethod
    def of_rows(cls, rows: Float, nothing: float = NOTHING) -> "Spectrum":
        """Analyse H = J'J from J, Float[rows, values], which avoids the loss of digits in the product.

        `nothing` is the singular value, relative to the largest, up to which a direction counts as undetermined.
        """
        scale = np.sqrt(np.einsum("ij,ij->j", rows, rows))
        # R has the singular values of J and as many rows as there are values at most
        triangle = np.linalg.qr(rows / scale, mode="r")
        missing = max(scale.size - len(triangle), 0)
        _, singular, turned = np.linalg.svd(np.vstack([triangle, np.zeros((missing, scale.size))]))
        null = int(np.sum(singular <= nothing * singular[:1]))
        # singular values fall, eigenvalues rise; fewer rows than values leave singular values of 0
        return cls._of(scale, singular[::-1] ** 2, turned[::-1].T, null)

    @classmethod
    def _of(cls, scale: Float, values: Float, vectors: Float, null: int) -> "Spectrum":
        # pseudo-inverse: without the null directions
        kept = vectors[:, null:] / scale[:, None]
        inverse = (kept / values[null:]) @ kept.T
        weak = slice(null, null + WEAKEST)
        return cls(scale, DenseInverse(inverse), vectors[:, :null], vectors[:, weak], values[weak])

    @property
    def loose(self) -> Bool:
        """Mask of the values that take part in an undetermined direction, Bool[values]."""
        shares: Float = np.sum(self.null**2, axis=1)
        return shares > PART

    @property
    def directions(self) -> Float:
        """The least determined directions, in units of the values, worst first; shape (directions, values).

        Undetermined ones come first, at most `WEAKEST`, each the only one with a part in some value.
        """
        return np.vstack([_separate(self.null, WEAKEST), _settle_equal(self.weak, self.weakness).T]) / self.scale


def _sound_inverse(matrix: Float) -> Float | None:
    """Return the inverse of a symmetric matrix with unit diagonal, None if it may be singular."""
    try:
        inverse = _inverse_by_factor(matrix) if len(matrix) > LARGE else _inverse(matrix)
    except np.linalg.LinAlgError:
        return None
    return inverse if np.all(np.abs(np.diag(inverse)) < SOUND) else None  # None for NaN, too


def _inverse(matrix: Float) -> Float:
    # raises an error if the matrix is not positive definite, which the inverse would not notice
    np.linalg.cholesky(matrix)
    inverse = np.linalg.inv(matrix)
    return 0.5 * (inverse + inverse.T)


def _inverse_by_factor(matrix: Float) -> Float:
    """Return the same as `_inverse` in half the time and memory, with LAPACK functions that take 0.1 s to load."""
    from scipy.linalg.lapack import dpotrf, dpotri

    # the transpose is in Fortran order, so that LAPACK needs no copy
    factor, failed = dpotrf(matrix.T, lower=1, clean=0)
    if not failed:
        transposed, failed = dpotri(factor, lower=1, overwrite_c=1)
    if failed:
        raise np.linalg.LinAlgError
    inverse: Float = transposed.T  # its upper triangle is right, the other one is filled below in blocks
    for first in range(0, len(inverse), BLOCK):
        block = slice(first, first + BLOCK)
        inverse[block, :first] = inverse[:first, block].T
        inverse[block, block] = np.triu(inverse[block, block]) + np.triu(inverse[block, block], 1).T
    return inverse


def _weakest(solve: Callable[[Float], Float], size: int) -> tuple[Float, Float]:
    """Return the smallest eigenvalues of a matrix and their eigenvectors, by subspace iteration with its inverse."""
    basis = _iterate_subspace(solve, size, WEAKEST)
    # Rayleigh-Ritz: the largest eigenvalues of the inverse are one over the smallest
    largest, turned = np.linalg.eigh(basis.T @ solve(basis))
    return 1 / largest[::-1], basis @ turned[:, ::-1]


def _iterate_subspace(solve: Callable[[Float], Float], size: int, count: int) -> Float:
    """Return an orthonormal basis that approximates the eigenvectors of the smallest eigenvalues."""
    # always the same start, so that results can be repeated
    basis = np.random.default_rng(0).standard_normal((size, min(count, size)))
    for _ in range(ROUNDS):
        basis, _ = np.linalg.qr(solve(basis))
    return basis


def _lowest(matrix: Sparse) -> tuple[Float, Float, int] | None:
    """Return the smallest eigenvalues of a sparse matrix with unit diagonal, their vectors, and the number of zeros.

    Uses subspace iteration with a shifted inverse. Returns None if there are so many zeros that a full eigenvalue
    decomposition costs no more.
    """
    from scipy.sparse import csr_array, eye_array

    size = matrix.shape[0]
    shifted = SparseFactor(csr_array(matrix + SHIFT * eye_array(size)))
    largest = float(abs(matrix).sum(axis=1).max())  # no eigenvalue is above it
    count = 2 * WEAKEST
    # the subspace doubles until all null directions and the weakest others fit in
    while shifted.is_definite and count <= size // MANY:
        basis = _iterate_subspace(shifted.solve, size, count)
        values, turned = np.linalg.eigh(basis.T @ (matrix @ basis))
        null = int(np.sum(values <= NOTHING * largest))
        if null + WEAKEST <= count:
            return values, basis @ turned, null
        count *= 2
    return None


def _separate(basis: Float, most: int) -> Float:
    """Return unit vectors of the space of orthonormal columns, as rows, each with a pivot value of its own."""
    rows = echelon(basis, pivots(basis), most).T
    rows[np.abs(rows) < PART] = 0.0
    # after rounding errors of pivots that others own are cut to 0
    length: Float = np.linalg.norm(rows, axis=1, keepdims=True)
    return rows / np.maximum(length, 1e-300)


def _settle_equal(vectors: Float, values: Float) -> Float:
    """Replace eigenvectors of equal eigenvalues by a basis of their space that is unique."""
    edges = np.flatnonzero(np.diff(values) > ALIKE * np.abs(values[1:])) + 1
    groups = np.split(np.arange(values.size), edges)
    parts = [vectors[:, g] if g.size == 1 else _separate(vectors[:, g], g.size).T for g in groups]
    return np.hstack(parts) if values.size else vectors


def root(matrix: Float) -> Float:
    """Compute the symmetric square root of a positive semidefinite matrix, Float[size, size]."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
