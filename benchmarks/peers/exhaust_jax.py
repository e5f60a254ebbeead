"""scipy's trust region reflective on the exhaust problem, residuals and Jacobian from JAX: jit(jacfwd(scan))."""

import time
from typing import Any

import numpy as np

from benchmarks.exhaust_problem import MAP, ExhaustProblem, problem
from benchmarks.peers.recorder import Recorder

__all__ = ["cost_at", "solve"]


def _residual(task: ExhaustProblem) -> Any:
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    drive = task.drive
    index, weight = jnp.asarray(drive.cells.index), jnp.asarray(drive.cells.weight)
    left, share = jnp.asarray(drive.left), jnp.asarray(drive.share)
    measured, rough = jnp.asarray(drive.measured), jnp.asarray(task.roughness)
    kept = np.flatnonzero(drive.scored)

    def step(y: Any, now: tuple[Any, Any]) -> tuple[Any, Any]:
        x, constant = now
        y = y + drive.step / (constant + drive.step) * (x - y)
        return y, y

    def residual(values: Any) -> Any:
        settled = jnp.sum(values[:MAP][index] * weight, axis=1)
        curve = values[MAP:]
        constant = curve[left] * (1 - share) + curve[left + 1] * share
        _, temperature = jax.lax.scan(step, settled[0], (settled, constant))
        return jnp.concatenate([(temperature - measured)[kept], rough @ values])

    return residual


def cost_at(points: list[list[float]]) -> dict[str, list[float]]:
    """The cost at given values, to compare it with the other tools'."""
    import jax.numpy as jnp

    residual = _residual(problem())
    return {"costs": [float(jnp.sum(residual(jnp.asarray(point, dtype=jnp.float64)) ** 2)) for point in points]}


def solve(cap: float, scaled: bool) -> dict[str, Any]:
    """Solve; `setup` is the time to compile."""
    import jax
    from scipy.optimize import least_squares

    task = problem()
    plain = _residual(task)
    began = time.perf_counter()
    compiled, jacobian = jax.jit(plain), jax.jit(jax.jacfwd(plain))
    compiled(task.start).block_until_ready()
    jacobian(task.start).block_until_ready()
    ready = time.perf_counter()
    residual = Recorder(lambda values: np.asarray(compiled(values)), task.start, cap)
    temperature = residual.run(
        lambda: least_squares(
            residual,
            task.start,
            jac=lambda values: np.asarray(jacobian(values)),
            bounds=task.bounds,
            x_scale="jac" if scaled else 1.0,
        )
    )
    return temperature | {"setup": ready - began}
