"""The solvers of topic `sets`: each takes a problem and one tolerance for every test it has, and returns its values."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.set_problem import CountedProblem

__all__ = ["CAP", "SOLVERS"]

Float = NDArray[np.float64]
CAP = 1000  # calls of the residual function
SMALL_VALUES = 64


class _Sum:
    """A problem as Kennfeld's solver sees it; see `kennfeld.optimize.solver.levenberg_marquardt.Objective`."""

    def __init__(self, problem: CountedProblem) -> None:
        self._given = problem
        self.uses_qr = self.supports_acceleration = problem.start.size <= SMALL_VALUES
        self.supports_secant = True
        self.target_squares = 0.0  # residuals without targets

    def cost(self, values: Float) -> float:
        residual = self._given.residual(values)
        return float(residual @ residual)

    def residual(self, values: Float) -> Float:
        return self._given.residual(values)

    def rows(self, values: Float) -> tuple[Float, Float]:
        return self._given.residual(values), self._given.jacobian(values)

    def normal(self, values: Float) -> tuple[Float, Float]:
        residual, jacobian = self.rows(values)
        return jacobian.T @ residual, jacobian.T @ jacobian

    def mean_curvature(self, diagonal: Float) -> Float:
        return np.zeros_like(diagonal)

    def cholesky(self, size: int) -> Any:
        from kennfeld.native import Cholesky

        return Cholesky(size)


def _kennfeld(problem: CountedProblem, tolerance: float) -> Float:
    from kennfeld.optimize.solver.levenberg_marquardt import SolverSettings, levenberg_marquardt
    from kennfeld.optimize.solver.linear_constraints import LinearLimits

    settings = SolverSettings(max_iterations=CAP, tolerance=tolerance)
    return levenberg_marquardt(_Sum(problem), problem.start, LinearLimits.none(problem.start.size), settings).values


def _trf(problem: CountedProblem, tolerance: float) -> Float:
    return _least_squares(problem, tolerance, method="trf")


def _trf_scaled(problem: CountedProblem, tolerance: float) -> Float:
    return _least_squares(problem, tolerance, method="trf", x_scale="jac")


def _lm(problem: CountedProblem, tolerance: float) -> Float:
    return _least_squares(problem, tolerance, method="lm")


def _least_squares(problem: CountedProblem, tolerance: float, **options: Any) -> Float:
    from scipy.optimize import least_squares

    same = {"ftol": tolerance, "xtol": tolerance, "gtol": tolerance, "max_nfev": CAP}
    return np.asarray(least_squares(problem.residual, problem.start, jac=problem.jacobian, **same, **options).x)


def _optimistix(problem: CountedProblem, tolerance: float) -> Float:
    import jax
    import jax.numpy as jnp
    import optimistix

    jax.config.update("jax_enable_x64", True)
    start = jnp.asarray(problem.start)
    count, size = problem.residual(problem.start).size, problem.start.size

    @jax.custom_jvp
    def residual(values: Any) -> Any:
        shape = jax.ShapeDtypeStruct((count,), jnp.float64)
        return jax.pure_callback(lambda x: problem.residual(np.asarray(x)), shape, values)

    @residual.defjvp
    def derivative(primal: Any, tangent: Any) -> Any:
        shape = jax.ShapeDtypeStruct((count, size), jnp.float64)
        jacobian = jax.pure_callback(lambda x: problem.jacobian(np.asarray(x)), shape, *primal)
        return residual(*primal), jacobian @ tangent[0]

    solver = optimistix.LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    solution = optimistix.least_squares(lambda x, _: residual(x), solver, start, max_steps=CAP, throw=False)
    return np.asarray(solution.value)


def _ceres(problem: CountedProblem, tolerance: float) -> Float:
    import pyceres

    class Cost(pyceres.CostFunction):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self.set_num_residuals(problem.residual(problem.start).size)
            self.set_parameter_block_sizes([problem.start.size])

        def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:  # noqa: N802
            residuals[:] = problem.residual(parameters[0])
            if jacobians is not None and jacobians[0] is not None:
                jacobians[0][:] = problem.jacobian(parameters[0]).ravel()
            return bool(np.all(np.isfinite(residuals)))

    values = problem.start.copy()
    cost, problem = Cost(), pyceres.Problem()
    problem.add_residual_block(cost, None, [values])
    options = pyceres.SolverOptions()
    options.function_tolerance = options.gradient_tolerance = options.parameter_tolerance = tolerance
    options.max_num_iterations, options.num_threads = CAP, 1
    options.linear_solver_type = pyceres.LinearSolverType.DENSE_QR
    options.logging_type = pyceres.LoggingType.SILENT
    pyceres.solve(options, problem, pyceres.SolverSummary())
    return values


SOLVERS = {
    "kennfeld": _kennfeld,
    "trf": _trf,
    "trf_scaled": _trf_scaled,
    "lm": _lm,
    "optimistix": _optimistix,
    "ceres": _ceres,
}
