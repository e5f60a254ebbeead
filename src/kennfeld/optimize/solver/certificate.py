"""The distance of values from a stationary point, in numbers without units.

With the step d of the undamped model within the limits, J'J d = -g - A'm holds with the multipliers m of the active
limits A, so that -J'J d is what their forces leave of the gradient g. Two numbers follow:

- the largest cosine between the residuals and a column of J, |J'J d| / (|column| |r|). It is the test `gtol` of MINPACK
  (J. Moré: The Levenberg-Marquardt algorithm, 1978), with limits;
- the share of the cost by which the step lowers it, as the model predicts: the square of the relative offset of
  D. Bates, D. Watts: A relative offset orthogonality convergence criterion, 1981.

If part of the values affects part of the criteria only, both numbers are also those of that part, whose cost may be too
small to be seen beside the rest.

The model is that of these values alone: damping and scales from the way there would hide a gradient.
"""

from typing import NamedTuple

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.numeric import finite_or_none
from kennfeld.optimize.solver.gauss_newton_model import GaussNewtonModel


class Certificate(NamedTuple):
    """All numbers are 0 at a minimum within the limits."""

    gradient: float  # largest cosine between the residuals and a column of J
    predicted_decrease: float  # by the undamped step within the limits, as a share of the cost
    limits: float = 0.0  # largest violation of a limit, relative to its size

    @classmethod
    def of(cls, model: GaussNewtonModel, step: Float, cost: float) -> "Certificate":
        """Return how far a point is from stationary.

        Args:
            model: at the point.
            step: of the (almost) undamped model within the limits, Float[values].
            cost: at the point, r'r.
        """
        if not cost > 0:
            return cls(0.0, 0.0)
        with np.errstate(all="ignore"):
            # the roots apart, as their product may overflow where both are large
            lengths = np.sqrt(model.diagonal) * np.sqrt(cost)
            cosines = np.abs(model.hessian_product(step)) / np.where(lengths > 0, lengths, np.inf)
            gradient = float(np.max(cosines, initial=0.0))
            decrease = float(model.predicted_reduction(step) / cost)
        # a cosine, and a share that rounding may carry out of its range
        return cls(min(gradient, 1.0), min(max(decrease, 0.0), 1.0))

    def together(self, other: "Certificate | None") -> "Certificate":
        """Return the larger ones of the numbers of both."""
        return self if other is None else Certificate(*map(max, self, other))

    def as_json(self) -> dict[str, float | None]:
        """Return the entry `certificate` of `result.json`."""
        return {name: finite_or_none(number) for name, number in self._asdict().items()}
