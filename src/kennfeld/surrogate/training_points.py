"""Points that a Gaussian process is trained on: repeated rows merged, each with its weight."""

import numpy as np

from kennfeld.base.arrays import Float, Int
from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True, eq=False)
class TrainingPoints:
    """Distinct points, the mean of the values at each, and the weight of that mean.

    Rows with the same inputs differ by noise alone. Their likelihood is that of their mean, whose noise has the
    variance s^2 eta / weight, times one of their scatter about it, which has `repeats` degrees of freedom: see
    M. Binois, R. B. Gramacy, M. Ludkovski: Practical heteroscedastic Gaussian process modeling for large simulation
    experiments, 2018, section 3.1. Rows whose values are equal as well are copies of one measurement, and count once. A
    measurement with a large error has a weight below 1.

    Attributes:
        x: Float[points, inputs].
        y: mean value of the rows of each point, Float[points].
        weights: sum of the weights of its measurements, Float[points].
        scatter: weighted sum of squared deviations from the mean, Float[points].
        repeats: number of measurements beyond the first, Float[points].
        point: number of the point of each row, Int[rows].
    """

    x: Float
    y: Float
    weights: Float
    scatter: Float
    repeats: Float
    point: Int

    @classmethod
    def of(cls, x: Float, y: Float, weights: Float | None = None) -> "TrainingPoints":
        """Merge the rows `x` Float[rows, inputs] that are equal; the points keep the order of their first rows.

        >>> points = TrainingPoints.of(np.array([[1.0], [2.0], [1.0]]), np.array([3.0, 5.0, 4.0]))
        >>> points.y, points.weights
        (array([3.5, 5. ]), array([2., 1.]))
        """
        _, firsts, inverse = np.unique(x, axis=0, return_index=True, return_inverse=True)
        # np.unique sorts the points; ranks bring them back into the order of their first rows
        order = np.argsort(firsts)
        rank = np.empty(len(order), dtype=np.int64)
        rank[order] = np.arange(len(order))
        point = rank[inverse.reshape(-1)]
        if len(order) == len(y):
            return cls(x, y, np.ones(len(y)) if weights is None else weights, np.zeros(len(y)), np.zeros(len(y)), point)
        first = np.unique(np.column_stack([point, y]), axis=0, return_index=True)[1]
        measured, values = point[first], y[first]
        shares = np.ones(len(first)) if weights is None else weights[first]
        total: Float = np.bincount(measured, shares).astype(np.float64)
        mean: Float = np.bincount(measured, shares * values) / total
        scatter: Float = np.bincount(measured, shares * (values - mean[measured]) ** 2).astype(np.float64)
        return cls(x[np.sort(firsts)], mean, total, scatter, np.bincount(measured).astype(np.float64) - 1, point)

    def part(self, chosen: Int) -> "TrainingPoints":
        """Return some of the points; their rows are not known by number."""
        weights, scatter, repeats = self.weights[chosen], self.scatter[chosen], self.repeats[chosen]
        return TrainingPoints(self.x[chosen], self.y[chosen], weights, scatter, repeats, np.empty(0, dtype=np.int64))

    def draw(self, most: int, rng: np.random.Generator) -> "TrainingPoints":
        """Return at most so many points, drawn without replacement."""
        if len(self) <= most:
            return self
        return self.part(np.sort(rng.choice(len(self), most, replace=False)))

    def __len__(self) -> int:
        return len(self.y)
