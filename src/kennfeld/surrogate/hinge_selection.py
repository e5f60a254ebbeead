"""Forward selection of hinges: kinks of a plane along single inputs.

Hinges are selected one after another, each the one that lowers the squared residuals most, as in J. H. Friedman:
Multivariate Adaptive Regression Splines, 1991, without products. Their number is the one with the smallest residuals of
groups of points left out, for each of which the selection is repeated.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.rbf import Hinge
from kennfeld.surrogate.gp_kernel import RANK, Plane
from kennfeld.surrogate.training_points import TrainingPoints

MOST = 10  # hinges
LEVELS = np.linspace(0.02, 0.98, 9)  # quantiles of an input at which a kink may be
STEPS = 6  # places, evenly over the range of an input, at which a kink may be as well
FEWEST = 10  # points on each side of a kink
COLLINEAR = 1e-4  # share of a hinge's square below which those selected before explain it


@dataclass(frozen=True, eq=False)
class HingeChoice:
    """Selected hinges, in units of spread, and the residuals of the kinked plane that they make.

    Attributes:
        hinges: with heights of least squares over all points; none if they do not lower the residuals.
        left_out: residual at each point, of hinges selected without its group, Float[points].
    """

    hinges: tuple[Hinge, ...]
    left_out: Float


def select_hinges(points: TrainingPoints, groups: Sequence[Int]) -> HingeChoice:
    """Select the hinges of points in units of spread; `groups` are the numbers of points that are left out together."""
    residuals = np.empty((MOST + 1, len(points)))
    everything = np.arange(len(points))
    for group in groups:
        kept = points.part(np.setdiff1d(everything, group))
        for count, hinges in enumerate(_paths(kept)):
            # from this count on, in case the selection of this group ends before the others
            residuals[count:, group] = points.y[group] - _kinked(kept, hinges, points.x[group])
    # a point counts once for each of its measurements
    count = int(np.argmin((1 + points.repeats) @ (residuals**2).T))
    *_, hinges = _paths(points, count)
    # after offset and slopes
    heights = _coefficients(points, hinges)[1 + points.x.shape[1] :]
    chosen = (Hinge(hinge.input, hinge.position, float(height)) for hinge, height in zip(hinges, heights, strict=True))
    return HingeChoice(tuple(chosen), residuals[len(hinges)])


def _paths(points: TrainingPoints, most: int = MOST) -> list[list[Hinge]]:
    """Return the first 0, 1, ... of at most so many hinges, in the order of their selection."""
    roots = np.sqrt(points.weights)
    candidates = _candidates(points.x)
    plane = Plane.over(points.x, points.weights)
    columns = _columns(candidates, points.x) * roots[:, None]
    size = np.einsum("ij,ij->j", columns, columns)
    # from here on, columns and residual are orthogonal to the plane and to all hinges that were selected (Gram-Schmidt)
    columns = plane.without(columns)
    rest = plane.without(points.y * roots)
    paths: list[list[Hinge]] = [[]]
    for _ in range(most if candidates else 0):
        unexplained = np.einsum("ij,ij->j", columns, columns)
        # by how much a column lowers the squared residual on its own: (c'r)^2 / c'c
        explains = (columns.T @ rest) ** 2 / np.maximum(unexplained, 1e-300)
        gain = np.where(unexplained > COLLINEAR * size, explains, 0.0)
        best = int(np.argmax(gain))
        if not gain[best] > 0:
            break
        direction = columns[:, best] / np.sqrt(unexplained[best])
        rest = rest - direction * (direction @ rest)
        columns = columns - np.outer(direction, direction @ columns)
        paths.append([*paths[-1], candidates[best]])
    return paths


def _candidates(x: Float) -> list[Hinge]:
    """Return hinges of height 1 at quantiles of each input, and evenly over its range."""
    result = []
    for d, values in enumerate(x.T):
        even = np.linspace(values.min(), values.max(), STEPS + 2)[1:-1]
        for position in np.unique(np.concatenate([np.quantile(values, LEVELS), even])).tolist():
            beyond = np.count_nonzero(values > position)
            if min(beyond, len(values) - beyond) >= FEWEST:
                result.append(Hinge(d, position, 1.0))
    return result


def _columns(hinges: Sequence[Hinge], x: Float) -> Float:
    """Return the hinges with height 1 at each point, Float[points, hinges]."""
    along = [hinge.input for hinge in hinges]
    columns: Float = np.maximum(x[:, along] - np.array([hinge.position for hinge in hinges]), 0.0)
    return columns


def _kinked(points: TrainingPoints, hinges: Sequence[Hinge], x: Float) -> Float:
    """Return the kinked plane of least squares through points, at `x`."""
    design = np.column_stack([np.ones(len(x)), x, _columns(hinges, x)])
    return np.asarray(design @ _coefficients(points, hinges), dtype=np.float64)


def _coefficients(points: TrainingPoints, hinges: Sequence[Hinge]) -> Float:
    """Return offset, slopes and heights of least squares."""
    roots = np.sqrt(points.weights)
    design = np.column_stack([np.ones(len(points)), points.x, _columns(hinges, points.x)]) * roots[:, None]
    return np.asarray(np.linalg.lstsq(design, points.y * roots, rcond=RANK)[0], dtype=np.float64)
