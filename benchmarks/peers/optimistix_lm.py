"""optimistix.LevenbergMarquardt on JAX in float64: the pin by elimination, no bounds, for it knows none."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.torque_problem import NAMES, TorqueProblem, problem

__all__ = ["cost_at", "solve"]


def _residual(task: TorqueProblem) -> Callable[[Any, Any], tuple[Any, None]]:
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    points, axis = task.training, jnp.asarray(task.eta_axis)
    rough = jnp.asarray(task.roughness.toarray())
    cells = [(jnp.asarray(c.index), jnp.asarray(c.weight)) for c in points.maps.values()]
    measured, ignition = jnp.asarray(points.torque), jnp.asarray(points.ignition)

    def residual(free: Any, _: Any) -> tuple[Any, None]:
        values = jnp.concatenate([free[: task.pinned], jnp.ones(1), free[task.pinned :]])
        part = {n: values[task.offsets[n] : task.offsets[n] + task.sizes[n]] for n in NAMES}
        best, spark, drag = (
            jnp.sum(part[name][index] * weight, axis=1)
            for name, (index, weight) in zip(points.maps, cells, strict=True)
        )
        efficiency = jnp.interp(spark - ignition, axis, part["CurveEtaDeltaSpark"])
        return jnp.concatenate([best * efficiency - drag - measured, rough @ values]), None

    return residual


def cost_at(points: list[list[float]]) -> dict[str, list[float]]:
    """The cost at given values, to compare it with the other tools'."""
    import jax.numpy as jnp

    residual = _residual(problem())
    return {
        "costs": [float(jnp.sum(residual(jnp.asarray(point, dtype=jnp.float64), None)[0] ** 2)) for point in points]
    }


def solve(cap: float) -> dict[str, Any]:
    """Solve step by step, each step compiled; `setup` is the time to compile."""
    import equinox as eqx
    import jax
    import jax.numpy as jnp
    import optimistix as optx

    task = problem()
    residual = _residual(task)
    solver = optx.LevenbergMarquardt(rtol=1e-8, atol=1e-8)
    at = jnp.asarray(task.start)
    shape = jax.eval_shape(lambda: residual(at, None))
    common = {"fn": residual, "args": None, "options": {}, "tags": frozenset()}
    state = solver.init(residual, at, None, {}, *shape, frozenset())
    step = eqx.filter_jit(eqx.Partial(solver.step, **common))
    terminate = eqx.filter_jit(eqx.Partial(solver.terminate, **common))
    cost = jax.jit(lambda values: jnp.sum(residual(values, None)[0] ** 2))
    began = time.perf_counter()
    jax.block_until_ready(step(y=at, state=state)[0])
    jax.block_until_ready(terminate(y=at, state=state)[0])
    cost(at).block_until_ready()
    ready = time.perf_counter()
    done, trace = False, [(0.0, float(cost(at)))]
    while not done and time.perf_counter() - ready < cap:
        at, state, _ = step(y=at, state=state)
        done = bool(terminate(y=at, state=state)[0])
        trace.append((time.perf_counter() - ready, float(cost(at))))
    lower, upper = task.bounds
    outside = int(np.sum((np.asarray(at) < lower) | (np.asarray(at) > upper)))
    notes = ["no bounds" + (f", {outside} values outside" if outside else "")] + ([] if done else ["out of time"])
    return {
        "setup": ready - began,
        "seconds": time.perf_counter() - ready,
        "values": np.asarray(at).tolist(),
        "trace": trace,
        "note": "; ".join(notes),
    }
