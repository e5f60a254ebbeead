"""Sample times: what blocks state, the step of the model, and when a slower block is hit."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, NamedTuple

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.expressions import Expressions
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import CONSTANT
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.weaving.registry import Kind

__all__ = ["IN_TIME", "Clock", "Rate", "common_step", "stated_rate"]

IN_TIME: Final = frozenset(  # types of blocks that have continuous states
    {"Integrator", "SecondOrderIntegrator", "StateSpace", "TransferFcn", "ZeroPole"}
)

_NEAR = 1e-6  # of a period, as far as times may be rounded
_SHORTEST = 1e-9  # s, of a sample time


class Rate(NamedTuple):
    """A sample time: the first hit at `offset`, then one every `period`, in s."""

    period: float
    offset: float = 0.0


def stated_rate(atom: Atom, expressions: Expressions, kind: Kind | None) -> Rate | None:
    """The sample time that a block states; None where it inherits. Raises `NoValueError`."""
    key = kind.sample_of(atom.block) if kind is not None else "SampleTime"
    text = _of_chart(atom) or atom.block.value(key) or (kind.defaults.get(key) if kind is not None else None)
    if atom.kind == "DiscretePulseGenerator" or text is None or not text.strip() or text.strip() == "-1":
        return None
    numbers = expressions.numbers(text, atom.scope).ravel()
    period = float(numbers[0]) if numbers.size else -1.0
    offset = float(numbers[1]) if numbers.size > 1 else 0.0
    if period == -1.0:
        return None
    if math.isinf(period):
        return Rate(CONSTANT)
    if not period >= 0:
        raise NoValueError(f"{text.strip()[:40]} is no sample time")
    if 0 < period < _SHORTEST:
        raise NoValueError(f"{text.strip()[:40]} is a sample time of {period:g} s, and {_SHORTEST:g} s is the shortest")
    return Rate(period, offset if period else 0.0)


def _of_chart(atom: Atom) -> str:
    """The sample time of a chart or function that runs by itself."""
    chart = atom.block.chart if atom.kind in ("Chart", "MATLAB Function") else None
    return chart.sample_time if chart is not None and chart.update == "DISCRETE" else ""


def common_step(periods: Iterable[float]) -> float | None:
    """The longest step that hits all sample times in s, None of none.

    >>> common_step([0.02, 0.005, 0.01])
    0.005
    """
    parts = [Fraction(period).limit_denominator(10**9) for period in periods if 0 < period < math.inf]
    parts = [part for part in parts if part > 0]
    if not parts:
        return None
    bottom = math.lcm(*(part.denominator for part in parts))
    return float(Fraction(math.gcd(*(int(part * bottom) for part in parts)), bottom))


@dataclass
class Clock:
    """The steps of a model: `step` in s, None where the data decide; whether there are continuous states.

    `multitasking` says whether each sample time is a task of its own, of which the faster run first; None where the
    file does not say it.
    """

    step: float | None
    continuous: bool = False
    multitasking: bool | None = False

    def hit(self, loom: Loom, rate: Rate) -> int | None:
        """The node that is 1 where a sample time is hit, None where every step hits it."""
        if self.step is not None and rate.offset == 0 and rate.period <= self.step * (1 + _NEAR):
            return None
        near = loom.const(_NEAR - rate.offset / rate.period)
        now, before = loom.input("t"), loom.call("sub", loom.input("t"), loom.input("dt"))
        period = loom.const(rate.period)
        count = [loom.call("floor", loom.call("add", loom.call("div", time, period), near)) for time in (now, before)]
        hit = loom.call("gt", *count)
        if rate.offset != 0:
            hit = loom.call("and", loom.call("ge", count[0], loom.const(0.0)), hit)
        return loom.node("major", (hit,)) if self.continuous else hit
