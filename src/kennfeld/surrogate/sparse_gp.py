"""Sparse Gaussian process: thousands of points represented by a few hundred inducing inputs.

The collapsed bound of M. K. Titsias: Variational Learning of Inducing Variables in Sparse Gaussian Processes, 2009,
with s^2 in closed form and the plane projected out of the output and of the kernel columns C (with a vague prior of the
plane, the noise across it is unchanged):

    M = eta Kzz + C~'C~,  w = M^-1 C~'y~,  q = y~'(y~ - C~w) / eta,  s^2 = q / (n - rank)
    -2 F = (n - rank) log s^2 + log|M| - log|Kzz| + (n - rank - m) log eta + (n - tr(Kzz^-1 C'C)) / eta
"""

from collections.abc import Iterator

import numpy as np

from kennfeld.arrays import Float
from kennfeld.lazy_dataclass import dataclass
from kennfeld.surrogate.gp_kernel import Plane, bells, factor, scaled_second_moment

BLOCK = 4096


def sparse_bound(values: Float, x: Float, y: Float, z: Float, plane: Plane) -> tuple[float, Float]:
    """Return the bound F and its gradient, by the logarithms of the lengths and of eta, the last.

    `x` Float[points, inputs], `y` Float[points] and the inducing inputs `z` Float[centres, inputs] are in units of
    spread. Raises `LinAlgError` if a matrix is not positive definite.
    """
    from scipy.linalg import cho_solve, solve_triangular

    lengths, noise = np.exp(values[:-1]), float(np.exp(values[-1]))
    count = len(y) - plane.rank
    inner, columns = bells(z, z, lengths), bells(x, z, lengths)
    root = factor(inner)
    flat, target = plane.without(columns), plane.without(y)
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
    misfit = max(float(target @ rest) / noise, 1e-300)
    variance = misfit / count
    inside = cho_solve((root, True), np.eye(len(z)))  # Kzz^-1
    left = len(x) - float(np.sum(inside * across))
    logarithm = 2 * np.sum(np.log(np.diag(outer))) + (count - len(z)) * np.log(noise)
    bound = -0.5 * (count * np.log(variance) + logarithm + left / noise)

    by_columns = np.outer(rest, weights / (noise * variance)) - flat @ inverse + columns @ (inside / noise)
    spent = inside @ across @ inside / noise
    by_inner = -0.5 * (noise * inverse - inside + np.outer(weights, weights / variance) + spent)
    by_lengths = scaled_second_moment(by_columns * columns, x, z, lengths)
    by_lengths += scaled_second_moment(by_inner * inner, z, z, lengths)
    steeper = (weights @ inner @ weights - misfit) / (noise * variance)
    by_noise = -0.5 * (float(np.sum(inverse * inner)) + (count - len(z)) / noise + steeper - left / noise**2)
    return float(bound), np.append(by_lengths, noise * by_noise)


@dataclass(frozen=True, eq=False)
class _DataSums:
    """The data in the whitened basis L^-1 k(z, x): enough for any eta."""

    root: Float  # L, lower Cholesky factor of Kzz
    whitened: Float  # L^-1 C~'C~ L^-T
    aimed: Float  # L^-1 C~'y~
    square: float  # y~'y~
    explained: float  # tr(Kzz^-1 C'C)
    crossed: Float  # basis'C L^-T
    based: Float  # basis'y


def _sum_data(x: Float, y: Float, z: Float, lengths: Float, plane: Plane) -> _DataSums:
    """Return one pass over the data, block by block."""
    root = factor(bells(z, z, lengths))
    crossed = np.zeros((plane.rank, len(z)))
    for part, features in _features(x, z, lengths, root):
        crossed += plane.basis[part].T @ features.T
    whitened, aimed, explained = np.zeros((len(z), len(z))), np.zeros(len(z)), 0.0
    target = plane.without(y)
    for part, features in _features(x, z, lengths, root):
        explained += float(np.sum(features**2))
        features -= crossed.T @ plane.basis[part].T
        whitened += features @ features.T
        aimed += features @ target[part]
    return _DataSums(root, whitened, aimed, float(target @ target), explained, crossed, plane.basis.T @ y)


def _features(x: Float, z: Float, lengths: Float, root: Float) -> Iterator[tuple[slice, Float]]:
    """Yield, by block, L^-1 k(z, x): Float[centres, points]."""
    from scipy.linalg import solve_triangular

    for first in range(0, len(x), BLOCK):
        part = slice(first, first + BLOCK)
        yield part, solve_triangular(root, bells(x[part], z, lengths).T, lower=True)


def best_noise(sums: _DataSums, count: int, rank: int, start: float) -> float:
    """Return the eta of the highest bound at given lengths and inducing inputs, near `start`."""
    from scipy.optimize import minimize_scalar

    roots, directions = np.linalg.eigh(sums.whitened)
    roots, aimed = np.maximum(roots, 0.0), (directions.T @ sums.aimed) ** 2
    free = count - rank

    def negative(logarithm: float) -> float:
        noise = np.exp(logarithm)
        misfit = max((sums.square - np.sum(aimed / (roots + noise))) / noise, 1e-300)
        grown = np.sum(np.log(roots + noise)) + (free - roots.size) * logarithm
        return float(free * np.log(misfit / free) + grown + max(count - sums.explained, 0.0) / noise)

    middle = np.log(start)
    best = minimize_scalar(negative, bounds=(middle - 7, middle + 7), method="bounded", options={"xatol": 1e-3})
    return float(np.exp(best.x))


@dataclass(frozen=True, eq=False)
class Sparse:
    """A sparse process at given inducing inputs, length scales and eta, in units of spread."""

    x: Float
    y: Float
    z: Float
    plane: Plane
    lengths: Float
    noise: float
    root: Float  # L of Kzz
    outer: Float  # lower Cholesky factor of eta I + L^-1 C~'C~ L^-T
    whitened_weights: Float
    crossed: Float  # basis'C L^-T
    level: Float  # coefficients of the plane

    @classmethod
    def at(cls, x: Float, y: Float, z: Float, lengths: Float, noise: float, *, refine: bool = True) -> "Sparse":
        """Return the process through points and values; with `refine`, eta is moved to where the bound is highest."""
        from scipy.linalg import cho_solve

        plane = Plane.over(x)
        sums = _sum_data(x, y, z, lengths, plane)
        if refine:
            noise = best_noise(sums, len(y), plane.rank, noise)
        outer: Float = np.asarray(np.linalg.cholesky(sums.whitened + noise * np.eye(len(z))), dtype=np.float64)
        weights = cho_solve((outer, True), sums.aimed)
        level = sums.based - sums.crossed @ weights
        return cls(x, y, z, plane, lengths, noise, sums.root, outer, weights, sums.crossed, level)

    def terms(self) -> tuple[float, Float, Float, Float]:
        """Return offset, slopes, weights and centres of the mean."""
        from scipy.linalg import solve_triangular

        flat = self.plane.back @ self.level
        weights = solve_triangular(self.root.T, self.whitened_weights, lower=False)
        return float(flat[0]), flat[1:], weights, self.z

    def left_out(self) -> Float:
        """Return the residual at each point of the process without it, with fixed lengths and inducing inputs."""
        from scipy.linalg import solve_triangular

        residual = np.empty(len(self.y))
        for part, near in _features(self.x, self.z, self.lengths, self.root):
            basis = self.plane.basis[part]
            mean = self.whitened_weights @ near + basis @ self.level
            # phi'(Phi'Phi + diag(eta, 0))^-1 phi of the features phi = [L^-1 k; basis] of each point
            half = solve_triangular(self.outer, near - self.crossed.T @ basis.T, lower=True)
            leverage = np.sum(half**2, axis=0) + np.sum(basis**2, axis=1)
            residual[part] = (self.y[part] - mean) / np.maximum(1 - leverage, 1e-12)
        return residual
