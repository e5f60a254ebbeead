"""The torque problem written down a second time, in numpy: residuals, sparse Jacobian, bounds.

Nothing here comes from Kennfeld but the data and the start. The pin eta(0) = 1 is an eliminated value: `free` are all
values but that one. Residuals are those of the 2812 points, then those of the roughness, so that the cost is their sum
of squares.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from kennfeld.domain.axis import Axis
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.project.demo import torque

__all__ = ["NAMES", "PIN", "Cells", "TorqueProblem", "problem"]

Float = NDArray[np.float64]
NAMES = ("MapOptTorque", "MapOptIgnition", "CurveEtaDeltaSpark", "MapDragTorque")
PIN = ("CurveEtaDeltaSpark", (0.0,), 1.0)


def bracket(axis: Float, x: Float) -> tuple[NDArray[np.int64], Float, Float]:
    """Left grid point, share of the right one, and slope of that share; clipped at the ends."""
    left = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, axis.size - 2)
    share = (x - axis[left]) / (axis[left + 1] - axis[left])
    inside = (share >= 0) & (share <= 1)
    return left, np.clip(share, 0.0, 1.0), inside / (axis[left + 1] - axis[left])


@dataclass(frozen=True)
class Cells:
    """Four grid points and their weights for each point of a bilinear map."""

    index: NDArray[np.int64]  # Int[points, 4]
    weight: Float  # Float[points, 4]
    size: int

    @classmethod
    def of(cls, x_axis: Float, y_axis: Float, x: Float, y: Float) -> "Cells":
        """The cells around the points (x, y)."""
        (i, u, _), (j, v, _) = bracket(x_axis, x), bracket(y_axis, y)
        corner = i * y_axis.size + j
        index = np.stack([corner, corner + 1, corner + y_axis.size, corner + y_axis.size + 1], axis=1)
        weight = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v], axis=1)
        return cls(index, weight, x_axis.size * y_axis.size)

    def __call__(self, values: Float) -> Float:
        """The map's value at each point."""
        interpolated: Float = np.einsum("ij,ij->i", values[self.index], self.weight)
        return interpolated

    @property
    def matrix(self) -> sparse.csr_array:
        """The same as a matrix, (points, grid points)."""
        rows = np.repeat(np.arange(len(self.index)), 4)
        return sparse.csr_array((self.weight.ravel(), (rows, self.index.ravel())), (len(self.index), self.size))


@dataclass(frozen=True)
class Points:
    """Data of a dataset, located in the three maps."""

    maps: dict[str, Cells]
    ignition: Float
    torque: Float

    @classmethod
    def of(cls, data: Dataset, parameters: ParameterSet) -> "Points":
        """The points of a dataset."""
        speed, air = data["Speed"].values, data["Rel_Airmass"].values
        maps = {
            name: Cells.of(*(axis.breakpoints for axis in parameters[name].axes), speed, air)
            for name in NAMES
            if len(parameters[name].axes) == 2
        }
        return cls(maps, data["Ignition"].values, data["Torque"].values)


def second_differences(axis: Axis) -> Float:
    """Rows of d over one line: z1 - 2 z2 + z3 on the even axes of this problem."""
    steps = np.diff(axis.breakpoints)
    assert np.allclose(steps, steps[0])
    return np.diff(np.eye(len(axis)), n=2, axis=0)


class TorqueProblem:
    """Residuals and Jacobian over the free values."""

    def __init__(self, training: Dataset, parameters: ParameterSet) -> None:
        self.parameters = parameters
        self.training = Points.of(training, parameters)
        self.eta_axis = parameters["CurveEtaDeltaSpark"].axes[0].breakpoints
        sizes = [parameters[name].size for name in NAMES]
        self.offsets = dict(zip(NAMES, np.concatenate([[0], np.cumsum(sizes)[:-1]]).tolist(), strict=True))
        self.sizes = dict(zip(NAMES, sizes, strict=True))
        self.total = sum(sizes)
        self.pinned = self.offsets["CurveEtaDeltaSpark"] + int(np.flatnonzero(self.eta_axis == 0.0)[0])
        self.kept = np.delete(np.arange(self.total), self.pinned)

    def flat(self, parameters: ParameterSet) -> Float:
        """All values of a parameter set, the eliminated one included."""
        return np.concatenate([parameters[name].values.ravel() for name in NAMES])

    @cached_property
    def start(self) -> Float:
        """The free values at the start."""
        return self.flat(self.parameters)[self.kept]

    @cached_property
    def bounds(self) -> tuple[Float, Float]:
        """Lower and upper bounds of the free values."""
        sides = ("lower", "upper")
        lower, upper = (
            np.concatenate([np.ravel(getattr(self.parameters[n], side)) for n in NAMES])[self.kept] for side in sides
        )
        return lower, upper

    def random(self, seed: int = 7) -> Float:
        """A point within the bounds, far from the start."""
        lower, upper = self.bounds
        noise = np.random.default_rng(seed).normal(0.0, 0.2, self.start.size)
        return np.clip(self.start * (1 + noise), lower, upper)

    def whole(self, free: Float) -> Float:
        """All values, with the eliminated one put in its place."""
        values = np.ones(self.total)
        values[self.kept] = free
        return values

    def part(self, values: Float, name: str) -> Float:
        """The values of one parameter."""
        at = self.offsets[name]
        return values[at : at + self.sizes[name]]

    def predict(self, free: Float, points: Points) -> Float:
        """The model's torque."""
        values = self.whole(free)
        best, spark, drag = (points.maps[n](self.part(values, n)) for n in points.maps)
        left, share, _ = bracket(self.eta_axis, spark - points.ignition)
        eta = self.part(values, "CurveEtaDeltaSpark")
        result: Float = best * (eta[left] * (1 - share) + eta[left + 1] * share) - drag
        return result

    @cached_property
    def roughness(self) -> sparse.csr_array:
        """Rows whose squares are the penalty, over all values."""
        blocks = []
        for name in NAMES:
            axes, blocks_of = self.parameters[name].axes, []
            for which, axis in enumerate(axes):
                factor = np.sqrt(torque.SMOOTHNESS[name] / len(axis))
                sides = [np.eye(len(other)) for other in axes]
                sides[which] = factor * second_differences(axis)
                rows = sides[0]
                for side in sides[1:]:
                    rows = np.kron(rows, side)
                blocks_of.append(rows)
            blocks.append(np.concatenate(blocks_of))
        return sparse.csr_array(sparse.block_diag(blocks, format="csr"))

    @cached_property
    def _rough(self) -> tuple[sparse.csr_array, Float]:
        """The roughness over the free values, and what the eliminated one adds."""
        return sparse.csr_array(self.roughness[:, self.kept]), self.roughness[:, [self.pinned]].toarray().ravel()

    def residual(self, free: Float) -> Float:
        """All residuals."""
        rows, rest = self._rough
        return np.concatenate([self.predict(free, self.training) - self.training.torque, rows @ free + rest])

    def cost(self, free: Float) -> float:
        """Sum of squares."""
        return float(np.sum(np.square(self.residual(free))))

    def jacobian(self, free: Float) -> sparse.csr_array:
        """All rows of the Jacobian, sparse."""
        values, points = self.whole(free), self.training
        (best_cells, spark_cells, drag_cells), (best, spark, _) = (
            points.maps.values(),
            (points.maps[n](self.part(values, n)) for n in points.maps),
        )
        left, share, slope = bracket(self.eta_axis, spark - points.ignition)
        eta = self.part(values, "CurveEtaDeltaSpark")
        efficiency = eta[left] * (1 - share) + eta[left + 1] * share
        steep = best * (eta[left + 1] - eta[left]) * slope
        data = np.concatenate(
            [
                efficiency[:, None] * best_cells.weight,
                steep[:, None] * spark_cells.weight,
                (best * (1 - share))[:, None],
                (best * share)[:, None],
                -drag_cells.weight,
            ],
            axis=1,
        )
        columns = np.concatenate(
            [
                best_cells.index + self.offsets["MapOptTorque"],
                spark_cells.index + self.offsets["MapOptIgnition"],
                (left + self.offsets["CurveEtaDeltaSpark"])[:, None],
                (left + self.offsets["CurveEtaDeltaSpark"] + 1)[:, None],
                drag_cells.index + self.offsets["MapDragTorque"],
            ],
            axis=1,
        )
        rows, _ = self._rough
        data[columns == self.pinned] = 0.0
        columns -= columns > self.pinned
        entries = data.shape[1]
        return sparse.csr_array(
            (
                np.concatenate([data.ravel(), rows.data]),
                np.concatenate([columns.ravel(), rows.indices]),
                np.concatenate([np.arange(0, data.size, entries), data.size + rows.indptr]),
            ),
            (len(data) + rows.shape[0], free.size),
        )

    def fresh_rmse(self, free: Float) -> float:
        """RMSE on points that no fit has seen."""
        points = Points.of(torque.fresh(), self.parameters)
        return float(np.sqrt(np.mean(np.square(self.predict(free, points) - points.torque))))


def problem(seed: int = 0) -> TorqueProblem:
    """The demo's problem; another seed draws other noise."""
    return TorqueProblem(torque.bench(seed), torque.start())
