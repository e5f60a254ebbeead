"""What the second derivatives of the residuals add to the Gauss-Newton matrix, learnt from gradients along the way.

J. Dennis, D. Gay, R. Welsch: An adaptive nonlinear least-squares algorithm, 1981. Where residuals stay large, the
Gauss-Newton matrix alone misses most of the curvature, and only heavy damping keeps its steps short enough.
"""

import numpy as np

from kennfeld.arrays import Float

__all__ = ["Secant"]


class Secant:
    """A symmetric matrix that follows the descent; zero at first."""

    def __init__(self, size: int) -> None:
        self.matrix = np.zeros((size, size))

    def bend(self, step: Float) -> float:
        """By how much it lowers the predicted gain of a step."""
        return float(step @ self.matrix @ step)

    def learn(self, step: Float, change: Float, explained: Float) -> None:
        """Take in how the (halved) gradient changed over a step, and how much of it the Gauss-Newton matrix explains.

        The matrix is first shrunk to the size of what is left to explain (ibid., equation 3.5), so that curvature
        learnt where the residuals were large is forgotten where they are small.
        """
        along = float(change @ step)
        left = change - explained
        if not (np.isfinite(along) and along > 0 and np.all(np.isfinite(left))):
            return
        known = self.bend(step)
        share = min(1.0, abs(float(step @ left)) / abs(known)) if known else 1.0
        missing = left - share * (self.matrix @ step)
        with np.errstate(over="ignore", invalid="ignore"):
            direction = change / along
            crossed = np.outer(missing, direction)
            matrix = share * self.matrix + crossed + crossed.T
            matrix -= float(step @ missing) * np.outer(direction, direction)
        if np.all(np.isfinite(matrix)):
            self.matrix = matrix
