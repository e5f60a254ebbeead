"""The exhaust problem written down a second time, in numpy: residuals, Jacobian, and their linear part.

Nothing here comes from Kennfeld but the data and the start. A lag of first order is a bidiagonal system, which LAPACK
solves for many inputs at once. Residuals are those of the scored samples, then those of the roughness, so that the cost
is their sum of squares. The values are those of the map, a row for each speed, then those of the curve.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from benchmarks.torque_problem import Cells, bracket
from kennfeld.domain.dataset import Dataset
from kennfeld.project.demo import exhaust

__all__ = ["MAP", "WARMUP", "Drive", "ExhaustProblem", "problem"]

Float = NDArray[np.float64]
NAMES = ("MapSettled", "CurveTimeConstant")
MAP = 144  # values of the map, the linear ones
WARMUP = 10.0  # s


class Drive:
    """A drive's samples, located in the map and the curve."""

    def __init__(self, data: Dataset) -> None:
        assert data.time is not None
        parameters = exhaust.start()
        speed, injection = (axis.breakpoints for axis in parameters[NAMES[0]].axes)
        air = parameters[NAMES[1]].axes[0].breakpoints
        self.cells = Cells.of(speed, injection, data["Speed"].values, data["Injection"].values)
        self.left, self.share, _ = bracket(air, data["AirMass"].values)
        self.step = float(np.median(np.diff(data.time)))
        self.measured = data["Temperature"].values
        self.scored = data.time - data.time[0] >= WARMUP

    @cached_property
    def basis(self) -> Float:
        """Contribution of each value of the map to the settled temperature, shape (samples, values)."""
        return self.cells.matrix.toarray()

    @cached_property
    def slopes(self) -> Float:
        """Contribution of each value of the curve to the time constant, shape (samples, values)."""
        slopes = np.zeros((self.left.size, exhaust.start()[NAMES[1]].size))
        at = np.arange(self.left.size)
        slopes[at, self.left], slopes[at, self.left + 1] = 1 - self.share, self.share
        return slopes

    def parts(self, curve: Float) -> Float:
        """Share of the way to its input that the lag covers in each step."""
        constant = curve[self.left] * (1 - self.share) + curve[self.left + 1] * self.share
        result: Float = self.step / (constant + self.step)
        result[0] = 1.0  # it begins at its input
        return result

    def filtered(self, parts: Float, forced: Float) -> Float:
        """Solve y_k = (1 - part_k) y_{k-1} + forced_k for each column of `forced`, which is overwritten."""
        from scipy.linalg.lapack import dtbtrs

        bands = np.ones((2, parts.size))
        bands[1, :-1] = parts[1:] - 1
        solved, info = dtbtrs(bands, np.asfortranarray(forced), uplo="L", diag="U", overwrite_b=1)
        assert info == 0
        return np.asarray(solved, dtype=np.float64)

    def predict(self, values: Float) -> Float:
        """The model's temperature at each sample."""
        parts = self.parts(values[MAP:])
        return self.filtered(parts, (parts * self.cells(values[:MAP]))[:, None])[:, 0]

    def basis_filtered(self, curve: Float) -> Float:
        """The temperature that each value of the map adds, shape (samples, values)."""
        parts = self.parts(curve)
        return self.filtered(parts, parts[:, None] * self.basis)

    def sensitivity(self, values: Float) -> Float:
        """Derivatives of the temperature by the values of the curve, shape (samples, values)."""
        parts = self.parts(values[MAP:])
        settled = self.cells(values[:MAP])
        y = self.filtered(parts, (parts * settled)[:, None])[:, 0]
        slope = -(parts**2) / self.step
        slope[0] = 0.0
        forced = slope * (settled - np.concatenate([settled[:1], y[:-1]]))
        return self.filtered(parts, forced[:, None] * self.slopes)


def second_slopes(axis: Float) -> Float:
    """Rows of d over one line: 2 [(z3 - z2)/(x3 - x2) - (z2 - z1)/(x2 - x1)] / (x3 - x1), x in mean spacings."""
    x = (axis - axis[0]) / ((axis[-1] - axis[0]) / (axis.size - 1))
    rows = np.zeros((axis.size - 2, axis.size))
    for i in range(axis.size - 2):
        before, after, whole = x[i + 1] - x[i], x[i + 2] - x[i + 1], x[i + 2] - x[i]
        rows[i, i : i + 3] = 2 / whole * np.array([1 / before, -1 / before - 1 / after, 1 / after])
    return rows


class ExhaustProblem:
    """Residuals and Jacobian over all values."""

    def __init__(self, seed: int = 0) -> None:
        self.parameters = exhaust.start()
        self.drive = Drive(exhaust.training(seed))
        self.start = np.concatenate([self.parameters[name].values.ravel() for name in NAMES])
        sides = [np.repeat(exhaust.BOUNDS[name], self.parameters[name].size).reshape(2, -1) for name in NAMES]
        lower, upper = np.concatenate(sides, axis=1)
        self.bounds: tuple[Float, Float] = (lower, upper)

    @cached_property
    def roughness(self) -> Float:
        """Rows whose squares are the penalty."""
        blocks = []
        for name in NAMES:
            axes = [axis.breakpoints for axis in self.parameters[name].axes]
            rows = []
            for which, axis in enumerate(axes):
                sides = [np.eye(other.size) for other in axes]
                sides[which] = np.sqrt(exhaust.SMOOTHNESS[name] / axis.size) * second_slopes(axis)
                rows.append(sides[0] if len(sides) == 1 else np.kron(*sides))
            blocks.append(np.concatenate(rows))
        first, second = blocks
        return np.block(
            [
                [first, np.zeros((len(first), second.shape[1]))],
                [np.zeros((len(second), first.shape[1])), second],
            ]
        )

    def random(self, seed: int = 7) -> Float:
        """A point within the bounds, far from the start."""
        noise = np.random.default_rng(seed).normal(0.0, 0.3, self.start.size)
        return np.clip(self.start * (1 + noise), *self.bounds)

    def residual(self, values: Float) -> Float:
        """All residuals."""
        drive = self.drive
        data = (drive.predict(values) - drive.measured)[drive.scored]
        return np.concatenate([data, self.roughness @ values])

    def jacobian(self, values: Float) -> Float:
        """All rows of the Jacobian."""
        drive = self.drive
        data = np.concatenate([drive.basis_filtered(values[MAP:]), drive.sensitivity(values)], axis=1)
        return np.concatenate([data[drive.scored], self.roughness])

    def cost(self, values: Float) -> float:
        """Sum of squares."""
        return float(np.sum(np.square(self.residual(values))))

    def test_rmse(self, values: Float) -> float:
        """RMSE on the drive that no fit has seen."""
        other = Drive(exhaust.another())
        return float(np.sqrt(np.mean(np.square((other.predict(values) - other.measured)[other.scored]))))


def problem() -> ExhaustProblem:
    """The demo's problem."""
    return ExhaustProblem()
