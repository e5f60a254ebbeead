"""The least-squares problems of optimagic's test sets, with exact Jacobians by complex steps."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["SETS", "CountedProblem", "Exhausted", "Problem", "problems"]

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]
SETS = ("more_wild", "cartis_roberts")
STEP = 1e-30
FEW = 12


class Exhausted(Exception):  # noqa: N818
    """Raised by a residual function that was called too often."""


class _ComplexNumpy:
    """numpy as optimagic's functions see it while they are differentiated: what they fill with numbers is complex."""

    float64 = np.complex128

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    @staticmethod
    def _complex(maker: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments, **named: maker(*arguments, **({"dtype": np.complex128} | named))

    def __init__(self) -> None:
        self.zeros, self.empty = self._complex(np.zeros), self._complex(np.empty)
        self.ones, self.full = self._complex(np.ones), self._complex(np.full)

    @staticmethod
    def abs(values: Any) -> Any:
        """Minus the argument where its real part is negative: analytic on either side of 0."""
        return np.where(np.real(values) < 0, -1.0, 1.0) * values

    @staticmethod
    def sign(values: Any) -> Any:
        """The sign of the real part."""
        return np.sign(np.real(values))


@contextmanager
def _complex_numpy() -> Iterator[None]:
    from optimagic.benchmarking import cartis_roberts, more_wild

    modules: tuple[Any, ...] = (cartis_roberts, more_wild)
    for module in modules:
        module.np = _ComplexNumpy()
    try:
        yield
    finally:
        for module in modules:
            module.np = np


@dataclass(frozen=True)
class Problem:
    """One problem, without bounds."""

    name: str
    function: Callable[[Float], Float]
    start: Float  # Float[values]
    stated: float | None  # the least cost according to optimagic

    def residual(self, values: Float) -> Float:
        """The residuals."""
        return np.asarray(self.function(np.array(values)), dtype=np.float64)

    @cached_property
    def pattern(self) -> Bool:
        """Dependence of each residual on each value: those that are not a number where the value is none.

        All, where there are few values; there a function may also branch on them.
        """
        if self.start.size <= FEW:
            return np.ones((self.residual(self.start).size, self.start.size), dtype=bool)
        columns = []
        for number in range(self.start.size):
            without = self.start.copy()
            without[number] = np.nan
            columns.append(np.isnan(self.residual(without)))
        return np.stack(columns, axis=1)

    @cached_property
    def groups(self) -> list[list[int]]:
        """Values of which no residual depends on two: their derivatives come from one step."""
        groups: list[list[int]] = []
        taken: list[Bool] = []
        for number, rows in enumerate(self.pattern.T):
            at = next((i for i, others in enumerate(taken) if not (others & rows).any()), len(groups))
            if at == len(groups):
                groups.append([])
                taken.append(np.zeros_like(rows))
            groups[at].append(number)
            taken[at] |= rows
        return groups

    def jacobian(self, values: Float) -> Float:
        """Their derivatives, one group of values after the other stepped into the imaginary."""
        derivatives = np.zeros(self.pattern.shape)
        with _complex_numpy():
            for group in self.groups:
                stepped = values.astype(np.complex128)
                stepped[group] += 1j * STEP
                slopes = np.imag(self.function(stepped)) / STEP
                derivatives[:, group] = np.where(self.pattern[:, group], slopes[:, None], 0.0)
        return derivatives


class CountedProblem:
    """A problem as a solver gets it: calls are counted, and the best values are kept."""

    def __init__(self, problem: Problem, cap: int) -> None:
        self._problem, self._cap = problem, cap
        self.start = problem.start.copy()
        self.residuals = self.jacobians = 0
        self.best, self.values = np.inf, self.start
        self._last: tuple[Float, Float] | None = None

    def residual(self, values: Float) -> Float:
        """The residuals; raises `Exhausted` once they have been asked for at too many values."""
        if self._last is not None and np.array_equal(values, self._last[0]):
            return self._last[1].copy()
        if self.residuals >= self._cap:
            raise Exhausted
        self.residuals += 1
        residual = self._problem.residual(values)
        self._last = np.array(values), residual
        cost = float(residual @ residual)
        if cost < self.best:
            self.best, self.values = cost, np.array(values)
        return residual.copy()

    def jacobian(self, values: Float) -> Float:
        """Their derivatives."""
        self.jacobians += 1
        return self._problem.jacobian(np.array(values))


def problems(name: str) -> list[Problem]:
    """All least-squares problems of a set."""
    from optimagic import config

    # Compiled functions would not take complex numbers.
    config.IS_NUMBA_INSTALLED = False
    from optimagic.benchmarking.get_benchmark_problems import get_benchmark_problems

    return [
        Problem(key, each["noise_free_fun"], np.asarray(each["inputs"]["params"], float), each["solution"]["value"])
        for key, each in get_benchmark_problems(name).items()
        if np.ndim(each["noise_free_fun"](np.asarray(each["inputs"]["params"], float))) == 1
    ]
