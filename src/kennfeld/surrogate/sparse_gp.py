"""Sparse Gaussian process: thousands of points represented by a few hundred inducing inputs.

The collapsed bound of M. K. Titsias: Variational Learning of Inducing Variables in Sparse Gaussian Processes, 2009,
with s^2 in closed form and the plane projected out of the output and of the kernel columns C (with a vague prior of the
plane, the noise across it is unchanged):

    M = eta Kzz + C~'C~,  w = M^-1 C~'y~,  q = (y~'(y~ - C~w) + c) / eta,  s^2 = q / (N - rank)
    -2 F = (N - rank) log s^2 + log|M| - log|Kzz| + (N - rank - m) log eta + (sum of weights - tr(Kzz^-1 C'C)) / eta

Rows of C, of the plane and of y are multiplied by the root of the weight of their point; c is the scatter of the rows
that were merged into points, N the number of rows (see `training_points`).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Kernel
from kennfeld.surrogate.gp_kernel import LEAST_VARIANCE, Plane, factor, kernel_matrix, scaled_second_moment
from kennfeld.surrogate.training_points import TrainingPoints

BLOCK = 4096


def sparse_bound(values: Float, points: TrainingPoints, z: Float, plane: Plane, kernel: Kernel) -> tuple[float, Float]:
    """Compute the bound F and its gradient, by the logarithms of the lengths and of eta, the last.

    `values` and the gradient are Float[inputs + 1]. The points and the inducing inputs `z` Float[centres, inputs] are
    in units of spread; `plane` is weighted. Raises `LinAlgError` if a matrix is not positive definite.
    """
    from scipy.linalg import cho_solve, solve_triangular

    x, lengths, noise = points.x, np.exp(values[:-1]), float(np.exp(values[-1]))
    roots = np.sqrt(points.weights)
    count = _rows(points) - plane.rank
    inner, inner_declines = kernel_matrix(z, z, lengths, kernel)
    columns, declines = (part * roots[:, None] for part in kernel_matrix(x, z, lengths, kernel))
    root = factor(inner)
    # C~ and y~
    flat, target = plane.without(columns), plane.without(points.y * roots)
    across = columns.T @ columns
    # Whitened before they are squared: the other way round, digits of M below eta are lost.
    features = solve_triangular(root, flat.T, lower=True)
    whitened = features @ features.T
    whitened.flat[:: len(z) + 1] += noise
    outer = np.linalg.cholesky(whitened)
    unwhiten = solve_triangular(root, np.eye(len(z)), lower=True)
    half = solve_triangular(outer, unwhiten, lower=True)
    inverse = half.T @ half  # M^-1
    weights = inverse @ (flat.T @ target)
    rest = target - flat @ weights
    misfit = max((float(target @ rest) + float(points.scatter.sum())) / noise, count * LEAST_VARIANCE)
    variance = misfit / count
    inside = cho_solve((root, True), np.eye(len(z)))  # Kzz^-1
    unexplained = float(points.weights.sum()) - float(np.sum(inside * across))
    logarithm = 2 * np.sum(np.log(np.diag(outer))) + (count - len(z)) * np.log(noise)
    bound = -0.5 * (count * np.log(variance) + logarithm + unexplained / noise)

    # dF/dC, then dF/dKzz; the declines of the kernel turn them into derivatives by the lengths
    by_columns = np.outer(rest, weights / (noise * variance)) - flat @ inverse + columns @ (inside / noise)
    trace_slope = inside @ across @ inside / noise
    by_inner = -0.5 * (noise * inverse - inside + np.outer(weights, weights / variance) + trace_slope)
    by_lengths = scaled_second_moment(by_columns * declines, x, z, lengths)
    by_lengths += scaled_second_moment(by_inner * inner_declines, z, z, lengths)
    steeper = (weights @ inner @ weights - misfit) / (noise * variance)
    by_noise = -0.5 * (float(np.sum(inverse * inner)) + (count - len(z)) / noise + steeper - unexplained / noise**2)
    return float(bound), np.append(by_lengths, noise * by_noise)


def _rows(points: TrainingPoints) -> float:
    """Return the number of rows that the points stand for."""
    return len(points) + float(points.repeats.sum())


@dataclass(frozen=True, eq=False)
class _DataSums:
    """The weighted data in the whitened basis L^-1 k(z, x): enough for any eta."""

    root: Float  # L, lower Cholesky factor of Kzz
    whitened: Float  # L^-1 C~'C~ L^-T
    right_side: Float  # L^-1 C~'y~
    square: float  # y~'y~ + c
    explained: float  # tr(Kzz^-1 C'C)
    coupling: Float  # basis'C L^-T
    on_plane: Float  # basis'y


def _sum_data(points: TrainingPoints, z: Float, lengths: Float, plane: Plane, kernel: Kernel) -> _DataSums:
    """Return one pass over the data, block by block."""
    root = factor(kernel_matrix(z, z, lengths, kernel)[0])
    coupling = np.zeros((plane.rank, len(z)))
    for part, features in _features(points, z, lengths, root, kernel):
        coupling += plane.basis[part].T @ features.T
    whitened, right_side, explained = np.zeros((len(z), len(z))), np.zeros(len(z)), 0.0
    y = points.y * np.sqrt(points.weights)
    target = plane.without(y)
    for part, features in _features(points, z, lengths, root, kernel):
        explained += float(np.sum(features**2))
        # a second pass, as the projection on the plane needs the whole columns first
        features -= coupling.T @ plane.basis[part].T
        whitened += features @ features.T
        right_side += features @ target[part]
    square = float(target @ target) + float(points.scatter.sum())
    return _DataSums(root, whitened, right_side, square, explained, coupling, plane.basis.T @ y)


def _features(
    points: TrainingPoints, z: Float, lengths: Float, root: Float, kernel: Kernel
) -> Iterator[tuple[slice, Float]]:
    """Yield, by block, L^-1 k(z, x) times the root of the weight of x: Float[centres, points]."""
    from scipy.linalg import solve_triangular

    roots = np.sqrt(points.weights)
    for first in range(0, len(points), BLOCK):
        part = slice(first, first + BLOCK)
        columns = kernel_matrix(points.x[part], z, lengths, kernel)[0] * roots[part, None]
        yield part, solve_triangular(root, columns.T, lower=True)


def best_noise(sums: _DataSums, free: float, total: float, start: float) -> float:
    """Return the eta of the highest bound at given lengths and inducing inputs, near `start`.

    `free` are the degrees of freedom N - rank, `total` is the sum of the weights.
    """
    from scipy.optimize import minimize_scalar

    # in the eigenvectors of L^-1 C~'C~ L^-T the bound is a sum over numbers for any eta
    roots, directions = np.linalg.eigh(sums.whitened)
    roots, squares = np.maximum(roots, 0.0), (directions.T @ sums.right_side) ** 2

    def negative(logarithm: float) -> float:
        noise = np.exp(logarithm)
        misfit = max((sums.square - np.sum(squares / (roots + noise))) / noise, 1e-300)
        grown = np.sum(np.log(roots + noise)) + (free - roots.size) * logarithm
        return float(free * np.log(misfit / free) + grown + max(total - sums.explained, 0.0) / noise)

    middle = np.log(start)
    best = minimize_scalar(negative, bounds=(middle - 7, middle + 7), method="bounded", options={"xatol": 1e-3})
    return float(np.exp(best.x))


@dataclass(frozen=True, eq=False)
class Sparse:
    """A sparse process at given inducing inputs, length scales and eta, in units of spread."""

    points: TrainingPoints
    z: Float
    plane: Plane  # weighted
    lengths: Float
    noise: float
    kernel: Kernel
    variance: float  # s^2
    root: Float  # L of Kzz
    outer: Float  # lower Cholesky factor of eta I + L^-1 C~'C~ L^-T
    whitened_weights: Float
    coupling: Float  # basis'C L^-T
    level: Float  # coefficients of the plane

    @classmethod
    def at(
        cls,
        points: TrainingPoints,
        z: Float,
        lengths: Float,
        noise: float,
        kernel: Kernel = "gaussian",
        *,
        refine: bool = True,
    ) -> "Sparse":
        """Return the process through points; with `refine`, eta is moved to where the bound is highest."""
        from scipy.linalg import cho_solve

        plane = Plane.over(points.x, points.weights)
        sums = _sum_data(points, z, lengths, plane, kernel)
        free = max(_rows(points) - plane.rank, 1.0)
        if refine:
            noise = best_noise(sums, free, float(points.weights.sum()), noise)
        outer: Float = np.asarray(np.linalg.cholesky(sums.whitened + noise * np.eye(len(z))), dtype=np.float64)
        weights = cho_solve((outer, True), sums.right_side)
        level = sums.on_plane - sums.coupling @ weights
        variance = max((sums.square - float(sums.right_side @ weights)) / (noise * free), LEAST_VARIANCE)
        return cls(points, z, plane, lengths, noise, kernel, variance, sums.root, outer, weights, sums.coupling, level)

    def terms(self) -> tuple[float, Float, Float, Float]:
        """Return offset, slopes, weights and centres of the mean."""
        from scipy.linalg import solve_triangular

        flat = self.plane.back @ self.level
        weights = solve_triangular(self.root.T, self.whitened_weights, lower=False)
        return float(flat[0]), flat[1:], weights, self.z

    def left_out(self, blocks: Sequence[Int] | None = None) -> Float:
        """Compute the residual at each point of the process without its block, with fixed lengths and inducing inputs.

        `blocks` are the numbers of points that are left out together; by default each point is left out alone. With
        H = rows rows' of the rows of `_projections`, the residual is (I - H_BB)^-1 (y - mean)_B.
        """
        residual = np.empty(len(self.points))
        if blocks is None:
            for part, rows, rest in self._projections(self.points):
                residual[part] = rest / np.maximum(1 - np.einsum("ij,ij->i", rows, rows), 1e-12)
        for block in blocks or ():
            points = self.points.part(block)
            moment, right_side = np.eye(len(self.z) + self.plane.rank), np.zeros(len(self.z) + self.plane.rank)
            for _, rows, rest in self._projections(points):
                moment -= rows.T @ rows
                right_side += rows.T @ rest
            # Woodbury: (I - R R')^-1 r = r + R (I - R'R)^-1 R'r
            # a block that alone determines a direction would make it singular
            moment.flat[:: len(moment) + 1] += 1e-12
            change = np.linalg.solve(moment, right_side)
            for part, rows, rest in self._projections(points):
                residual[block[part]] = rest + rows @ change
        return residual / np.sqrt(self.points.weights)

    def _projections(self, points: TrainingPoints) -> Iterator[tuple[slice, Float, Float]]:
        """Yield, by block of points, rows whose products are the smoother's matrix H, and y - mean; both weighted.

        The features of a point are phi = [L^-1 k; basis], and H = phi'(Phi'Phi + diag(eta, 0))^-1 phi.
        """
        from scipy.linalg import solve_triangular

        roots = np.sqrt(points.weights)
        for part, near in _features(points, self.z, self.lengths, self.root, self.kernel):
            x = points.x[part]
            basis = np.column_stack([np.ones(len(x)), x]) @ self.plane.back * roots[part, None]
            rest = points.y[part] * roots[part] - self.whitened_weights @ near - basis @ self.level
            half = solve_triangular(self.outer, near - self.coupling.T @ basis.T, lower=True)
            yield part, np.concatenate([half.T, basis], axis=1), rest
