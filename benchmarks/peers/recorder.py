"""Record of a peer's residual function: the best values so far, when, and that its time is up."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["OutOfTime", "Recorder"]

Float = NDArray[np.float64]


class OutOfTime(Exception):  # noqa: N818
    """Raised in a residual function to end a peer that has no time limit of its own."""


class Recorder:
    """Wraps a residual function. `trace` are (seconds, cost) of each value that was lower than all before."""

    def __init__(self, residual: Callable[[Float], Float], start: Float, cap: float) -> None:
        self._residual, self._cap = residual, cap
        self.best, self.values, self.calls = np.inf, start, 0
        self.trace: list[tuple[float, float]] = []
        self.began = time.perf_counter()

    def __call__(self, values: Float) -> Float:
        """The residuals."""
        residual = self._residual(values)
        cost = float(residual @ residual)
        now = time.perf_counter() - self.began
        self.calls += 1
        if cost < self.best:
            self.best, self.values = cost, values.copy()
            self.trace.append((now, cost))
        if now > self._cap:
            raise OutOfTime
        return residual

    def run(self, solve: Callable[[], Any]) -> dict[str, Any]:
        """Time `solve` and report where it ended, or where it was when its time was up."""
        self.began = time.perf_counter()
        try:
            solve()
            note = ""
        except OutOfTime:
            note = "out of time"
        return {
            "seconds": time.perf_counter() - self.began,
            "values": self.values.tolist(),
            "trace": self.trace,
            "note": note,
        }
