"""Fits of expansions with few centres to data or to a map, as a start for calibration."""

from typing import Literal

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate.gp_kernel import CANDIDATES, greedy, k_means
from kennfeld.surrogate.training_data import Scaling, check_points

Placing = Literal["greedy", "k-means"]

NEIGHBOURS = 2  # a width reaches to about so many neighbouring centres
OVERLAPS = (0.7, 1.0, 1.5, 2.0, 3.0)  # widths in units of the distance to them
RIDGES = 10.0 ** np.arange(-10.0, 3.0)
LENGTH = 1.0  # in spreads, by which greedy centres keep apart


def expand_data(x: Float, y: Float, centres: int = 20, *, placing: Placing = "k-means", seed: int = 0) -> Expansion:
    """Fit an expansion with few centres to points.

    Centres are placed by k-means, or greedily at the largest remaining variance; widths are proportional to the
    distance to the nearest other centres; weights over a plane come from ridge regression. The factor of the widths and
    the ridge are chosen by generalised cross-validation (G. H. Golub, M. Heath, G. Wahba, 1979).

    Args:
        x: points, Float[points, inputs].
        y: values, Float[points].
        centres: their number.
        placing: of the centres.
        seed: of the placing.

    Raises:
        ArgumentError: the points cannot be used, or there are fewer than centres.
    """
    points, values = check_points(x, y)
    if not 1 <= centres <= len(points):
        raise ArgumentError(
            f"centres={centres} of an expansion must be >= 1 and <= the number of points, {len(points)}"
        )
    if placing not in ("greedy", "k-means"):
        raise ArgumentError(f"placing={placing!r} of an expansion must be greedy or k-means")
    scaling = Scaling.of(points, values)
    inner = scaling.inward(points)
    if placing == "k-means":
        positions = k_means(inner, centres, seed)
    else:
        few = inner[np.random.default_rng(seed).permutation(len(inner))[:CANDIDATES]]
        positions = few[greedy(few, centres, np.full(inner.shape[1], LENGTH))]
    target = (values - scaling.level) / scaling.height
    spacing = np.repeat(_spacing(positions)[:, None], inner.shape[1], axis=1)
    fits = [_RidgeFit(inner, target, positions, overlap * spacing) for overlap in OVERLAPS]
    return min(fits, key=lambda fit: fit.score).expansion(scaling)


def compress_map(table: Parameter, centres: int = 20, *, seed: int = 0) -> Expansion:
    """Fit an expansion to a curve, map or cube: `expand_data` over its grid points.

    Args:
        table: the table.
        centres: maximum number of bells.
        seed: of the choice of their centres.

    Returns:
        An expansion whose inputs are the table's axes in their order, in their units.

    Raises:
        ArgumentError: the parameter has no axes.

    >>> from kennfeld import Curve
    >>> squared = compress_map(Curve("C", np.arange(11.0), np.arange(11.0) ** 2), centres=6)
    >>> bool(abs(squared(np.array([5.0])) - 25) < 0.5)
    True
    """
    if not table.axes:
        raise ArgumentError(f"{table.name} is a {table.kind}; only a curve, map or cube can be compressed")
    grid = np.meshgrid(*(axis.breakpoints for axis in table.axes), indexing="ij")
    points = np.stack([coordinate.reshape(-1) for coordinate in grid], axis=1)
    return expand_data(points, table.values.reshape(-1), min(centres, len(points)), seed=seed)


def _spacing(centres: Float) -> Float:
    """Return the mean distance of each centre to its nearest neighbours."""
    if len(centres) == 1:
        return np.ones(1)
    squared = np.sum((centres[:, None, :] - centres) ** 2, axis=2)
    near = np.sqrt(np.sort(squared, axis=1)[:, 1 : NEIGHBOURS + 1]).mean(axis=1)
    # centres that coincide would have widths of 0
    least: Float = np.maximum(near, 1e-3 * max(float(near.max()), 1e-3))
    return least


class _RidgeFit:
    """Ridge regression of the weights over a plane, at given centres and widths, in units of spread."""

    def __init__(self, x: Float, y: Float, centres: Float, widths: Float) -> None:
        self.x, self.y, self.centres, self.widths = x, y, centres, widths
        distance = (x[:, None, :] - centres) / widths
        self.near = np.exp(-0.5 * np.einsum("imd,imd->im", distance, distance))
        self.plane = np.column_stack([np.ones(len(x)), x])
        # the plane is fitted without a ridge: it is projected out of basis functions and target
        basis = np.linalg.qr(self.plane)[0]
        u, self.s, self.v = np.linalg.svd(self.near - basis @ (basis.T @ self.near), full_matrices=False)
        target = y - basis @ (basis.T @ y)
        self.coordinates = u.T @ target
        self.rest = max(float(target @ target - self.coordinates @ self.coordinates), 0.0)
        self.free = y.size - basis.shape[1]
        self.score, self.ridge = min((self._score(ridge), float(ridge)) for ridge in RIDGES)

    def _score(self, ridge: float) -> float:
        # filter factors of the ridge; their sum is the trace of the smoother
        shares = self.s**2 / (self.s**2 + ridge)
        return float(
            (self.rest + np.sum(((1 - shares) * self.coordinates) ** 2)) / max(self.free - shares.sum(), 1e-9) ** 2
        )

    def expansion(self, scaling: Scaling) -> Expansion:
        weights = self.v.T @ (self.s / (self.s**2 + self.ridge) * self.coordinates)
        # the weights are of functions without their plane, which this fit puts back
        flat: Float = np.asarray(np.linalg.lstsq(self.plane, self.y - self.near @ weights, rcond=None)[0], np.float64)
        return scaling.expansion(float(flat[0]), flat[1:], weights, self.centres, self.widths)
