"""One iteration of a calibration: the cost at a trial point, then gradient and Gauss-Newton matrix there.

The step's own linear algebra is left out; it does not depend on the data. This is the one file that reaches into
Kennfeld's inner rooms for the topics on large data.
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.measure import peak, repeated, reset_peak
from kennfeld.domain.dataset import Dataset
from kennfeld.domain.parameter_set import ParameterSet

__all__ = ["measure_iteration"]


def measure_iteration(
    formula: str, target: str, node: str, parameters: ParameterSet, load: Callable[[int], Dataset]
) -> dict[str, Any]:
    """Durations and memory. `load(n)` gives the data, cut to n samples where n is not 0.

    Memory counts from before the data are loaded, but after the same model was compiled on a few of them, so that
    imports and the compiler are left out.
    """
    _Ready(formula, target, node, parameters, load(100)).iterate()
    before = reset_peak()
    began = time.perf_counter()
    data = load(0)
    loaded = time.perf_counter()
    ready = _Ready(formula, target, node, parameters, data)
    prepared = time.perf_counter()
    cost = ready.iterate()
    parts = {name: repeated(work, lasting=2.0) for name, work in (("cost", ready.cost), ("normal", ready.normal))}
    whole = repeated(ready.iterate, lasting=3.0)
    size = sum(channel.values.nbytes for channel in data.values()) + (0 if data.time is None else data.time.nbytes)
    return {
        "load": loaded - began,
        "prepare": prepared - loaded,
        "value": cost,
        "entries": ready.entries,
        "free": ready.free,
        "bytes": size,
        "peak": peak() - before,
        **{name: times["best"] for name, times in parts.items()},
        "iteration": whole["best"],
        "median": whole["median"],
    }


class _Ready:
    """A compiled problem, evaluated at another point each time, so that nothing can be kept from earlier calls."""

    def __init__(self, formula: str, target: str, node: str, parameters: ParameterSet, data: Dataset) -> None:
        from kennfeld.domain.criteria import Criterion
        from kennfeld.models.formula import formula as read
        from kennfeld.optimize import Problem
        from kennfeld.optimize.sums.compiled import CompiledProblem
        from kennfeld.optimize.sums.objective import LeastSquaresObjective

        model = read(formula, parameters=list(parameters))
        compiled = CompiledProblem(Problem(model, (data,), parameters, (Criterion(node, target),)))
        self._objective = LeastSquaresObjective(compiled)
        start = self._objective.start
        self._start, self._step = start, 1e-3 * start * np.random.default_rng(0).normal(size=start.size)
        self._calls = 0
        self.entries, self.free = compiled.kernel.entries.room, start.size

    def _next(self) -> Any:
        self._calls += 1
        return self._start + (self._calls % 2 + 1e-6 * self._calls) * self._step

    def cost(self) -> float:
        """The cost at another point."""
        return self._objective.cost(self._next())

    def normal(self) -> None:
        """Gradient and matrix at another point."""
        self._objective.normal(self._next())

    def iterate(self) -> float:
        """Both at another point, and the cost there."""
        point = self._next()
        cost = self._objective.cost(point)
        self._objective.normal(point)
        return cost
