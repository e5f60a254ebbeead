"""Variable projection on the exhaust problem: only the ten time constants are searched.

For given time constants the map's basis functions are filtered through the lag, and the map that fits best is a linear
problem, solved by Cholesky. The time constants are searched by scipy's trust region reflective with the Jacobian of the
projected residuals in the approximation of L. Kaufman (A variable projection method for solving separable nonlinear
least squares problems, BIT 15, 1975). It knows no bounds of the map's values.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.exhaust_problem import MAP, ExhaustProblem, problem
from benchmarks.peers.recorder import Recorder

__all__ = ["solve"]

Float = NDArray[np.float64]


class _Projected:
    """Residuals and Jacobian as functions of the time constants alone."""

    def __init__(self, task: ExhaustProblem) -> None:
        self.given = task
        self.first = int(np.argmax(task.drive.scored))  # the scored samples are all from here on
        rough = task.roughness[np.any(task.roughness[:, :MAP] != 0, axis=1)][:, :MAP]
        self.penalty = rough.T @ rough
        self.at: Float | None = None

    def solved(self, curve: Float) -> Float:
        """All values, with the map that fits best to these time constants."""
        from scipy.linalg import cho_factor, cho_solve

        if self.at is None or not np.array_equal(self.at, curve):
            drive = self.given.drive
            self.basis = drive.basis_filtered(curve)[self.first :]
            self.factor = cho_factor(self.basis.T @ self.basis + self.penalty, overwrite_a=True, check_finite=False)
            self.map = cho_solve(self.factor, self.basis.T @ drive.measured[self.first :])
            self.at = curve.copy()
        return np.concatenate([self.map, curve])

    def residual(self, curve: Float) -> Float:
        """All residuals of the whole problem, with the best map."""
        values = self.solved(curve)
        drive = self.given.drive
        data = self.basis @ self.map - drive.measured[self.first :]
        return np.concatenate([data, self.given.roughness @ values])

    def jacobian(self, curve: Float) -> Float:
        """Kaufman's: the sensitivities without what a change of the map takes up."""
        from scipy.linalg import cho_solve

        values = self.solved(curve)
        direct = self.given.drive.sensitivity(values)[self.first :]
        taken = cho_solve(self.factor, self.basis.T @ direct)
        data = direct - self.basis @ taken
        return np.concatenate([data, self.given.roughness @ np.concatenate([-taken, np.eye(curve.size)])])


def solve(cap: float, scaled: bool) -> dict[str, Any]:
    """Solve; what is reported are all values."""
    from scipy.optimize import least_squares

    task = problem()
    projected = _Projected(task)
    lower, upper = task.bounds
    begin = task.start[MAP:]
    projected.given.drive.basis, projected.given.drive.slopes  # noqa: B018  # data alone, made before the clock starts
    recorder = Recorder(projected.residual, begin, cap)
    outcome = recorder.run(
        lambda: least_squares(
            recorder,
            begin,
            jac=projected.jacobian,
            bounds=(lower[MAP:], upper[MAP:]),
            x_scale="jac" if scaled else 1.0,
        )
    )
    values = projected.solved(np.array(outcome["values"]))
    outside = int(np.sum((values < lower) | (values > upper)))
    notes = [*([outcome["note"]] if outcome["note"] else []), *([f"{outside} values outside"] if outside else [])]
    return outcome | {"values": values.tolist(), "note": "; ".join(notes)}
