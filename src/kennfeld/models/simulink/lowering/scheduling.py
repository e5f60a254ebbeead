"""Conditional subsystems: whether a block runs in a step, and whether its memory begins anew or is written.

Sample times: what blocks state, the step of the model, and when a slower block is hit.

When blocks run: their sample times, what is held between the hits of them, and what keeps still in minor steps.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Final, NamedTuple

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
from kennfeld.models.simulink.flattening.flat_model import FlatBlock, SignalSource, resets_with_subsystem
from kennfeld.models.simulink.lowering.diagnostics import BlockFailures
from kennfeld.models.simulink.lowering.pass_state import InferredAttributes
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES, BlockType
from kennfeld.models.simulink.signals import CONSTANT, CONTINUOUS, Bus, ExternalBus, Signal, SignalOrBus, scalar

__all__ = [
    "CONTINUOUS_BLOCK_TYPES",
    "ExecutionConditions",
    "ModelClock",
    "SampleTime",
    "SampleTimes",
    "common_step",
    "explicit_sample_time",
]

CONTINUOUS_BLOCK_TYPES: Final = frozenset(  # types of blocks that have continuous states
    {"Integrator", "SecondOrderIntegrator", "StateSpace", "TransferFcn", "ZeroPole"}
)

_NEAR = 1e-6  # of a period, as far as times may be rounded
_SHORTEST = 1e-9  # s, of a sample time


class SampleTime(NamedTuple):
    """A sample time: the first hit at `offset`, then one every `period`, in s."""

    period: float
    offset: float = 0.0


def explicit_sample_time(atom: FlatBlock, expressions: Expressions, kind: BlockType | None) -> SampleTime | None:
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
        return SampleTime(CONSTANT)
    if not period >= 0:
        raise EvaluationError(f"{text.strip()[:40]} is no sample time")
    if 0 < period < _SHORTEST:
        raise EvaluationError(
            f"{text.strip()[:40]} is a sample time of {period:g} s, and {_SHORTEST:g} s is the shortest"
        )
    return SampleTime(period, offset if period else 0.0)


def _of_chart(atom: FlatBlock) -> str:
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
class ModelClock:
    """The steps of a model: `step` in s, None where the data decide; whether there are continuous states.

    `multitasking` says whether each sample time is a task of its own, of which the faster run first; None where the
    file does not say it.
    """

    step: float | None
    continuous: bool = False
    multitasking: bool | None = False

    def hit(self, builder: GraphBuilder, rate: SampleTime) -> int | None:
        """The node that is 1 where a sample time is hit, None where every step hits it."""
        if self.step is not None and rate.offset == 0 and rate.period <= self.step * (1 + _NEAR):
            return None
        near = builder.const(_NEAR - rate.offset / rate.period)
        now, before = builder.input("t"), builder.call("sub", builder.input("t"), builder.input("dt"))
        period = builder.const(rate.period)
        count = [
            builder.call("floor", builder.call("add", builder.call("div", time, period), near))
            for time in (now, before)
        ]
        hit = builder.call("gt", *count)
        if rate.offset != 0:
            hit = builder.call("and", builder.call("ge", count[0], builder.const(0.0)), hit)
        return builder.node("major", (hit,)) if self.continuous else hit


class SampleTimes:
    """The sample times of the blocks in one pass over them."""

    def __init__(
        self, clock: ModelClock, expressions: Expressions, guesses: InferredAttributes, failures: BlockFailures
    ) -> None:
        self.clock = clock
        self.expressions = expressions
        self.builder: GraphBuilder = expressions.builder
        self.guesses = guesses
        self.failures = failures

    # sample times

    def rate(self, atom: FlatBlock) -> SampleTime | None:
        """The sample time that a block states by itself; None where it inherits."""
        try:
            return explicit_sample_time(atom, self.expressions, BLOCK_TYPES.get(atom.kind))
        except EvaluationError as error:
            self.failures.note(atom, f"its sample time has no value: {error}", "", error.undefined)
            return None

    def own(self, atom: FlatBlock) -> SampleTime:
        """The sample time of a block: as stated, else as inherited."""
        return self.rate(atom) or SampleTime(self.guessed_period(atom))

    def stated_period(self, atom: FlatBlock) -> float | None:
        """The period of the sample time that a block states in s; None where it inherits."""
        found = self.rate(atom)
        return None if found is None else found.period

    def guessed_period(self, atom: FlatBlock) -> float:
        """The period that a block inherits from its inputs, as an earlier pass found it."""
        return self.guesses.periods.get(atom, CONTINUOUS)

    def task_order(self, one: FlatBlock, other: FlatBlock) -> int:
        """-1 where the first of two blocks is in a faster task, 1 where in a slower one; 0 where both may be in one."""
        if not self.clock.multitasking:
            return 0
        periods = [self.stated_period(atom) for atom in (one, other)]
        if periods[0] is None or periods[1] is None or CONSTANT in periods:
            return 0
        return (periods[0] > periods[1]) - (periods[0] < periods[1])

    def hit(self, rate: SampleTime) -> int | None:
        """The node that is 1 where a sample time is hit, None where every step of the model hits it."""
        return None if rate.period in (CONTINUOUS, CONSTANT) else self.clock.hit(self.builder, rate)

    def hits(self, period: float) -> Signal:
        """1 at the hits of a sample time."""
        node = self.clock.hit(self.builder, SampleTime(period)) if period > 0 else None
        return scalar(self.builder.const(1.0) if node is None else node, max(period, 0.0))

    # signals

    def sampled(self, atom: FlatBlock, wired: SignalOrBus, remembers: bool) -> SignalOrBus:
        """An output as it is with the block's own sample time: held between its hits."""
        rate = self.own(atom) if remembers else self.rate(atom)
        if rate is None or rate.period in (CONTINUOUS, CONSTANT) or isinstance(wired, ExternalBus):
            return wired
        if isinstance(wired, Bus):
            return Bus({name: self.sampled(atom, member, remembers) for name, member in wired.members.items()})
        if wired.period == CONSTANT or (wired.period == rate.period and not remembers):
            return replace(wired, period=rate.period)
        return self.held(atom, wired, rate)

    def held(self, atom: FlatBlock, wired: Signal, rate: SampleTime) -> Signal:
        """A signal that is held between the hits of a block's sample time."""
        wired = self.at_major(wired)
        hit = self.clock.hit(self.builder, rate)
        if hit is None:
            return replace(wired, period=rate.period)
        if atom.passes:
            message = "it has a sample time of its own in a subsystem that runs several times in a step"
            self.failures.note(atom, message)
        made = [self._kept(hit, node) for node in wired.flat]
        nodes = np.array(made, dtype=np.int64).reshape(wired.shape, order="F")
        return Signal(nodes, rate.period)

    def _kept(self, hit: int, node: int) -> int:
        """A node that keeps its value between hits."""
        before = self.builder.state()
        y = self.builder.call("select", hit, node, before)
        self.builder.close(before, node, y)
        return y

    def at_major(self, x: Signal) -> Signal:
        """A signal that keeps, within the minor steps of the solver, its value of the major step."""
        if x.period != CONTINUOUS or not self.clock.continuous:
            return x
        made = [self.major(int(node)) for node in x.nodes.ravel()]
        return replace(x, nodes=np.array(made, dtype=np.int64).reshape(x.shape))

    def major(self, node: int) -> int:
        """A node that keeps its value of the major step within the minor steps."""
        if not self.clock.continuous or self.builder.nodes[node].op in ("const", "major"):
            return node
        return self.builder.node("major", (node,))


class ExecutionConditions:
    """The conditions of blocks as nodes; `value` gives the signals of what stands for conditional subsystems."""

    def __init__(self, timing: SampleTimes, value: Callable[[SignalSource], SignalOrBus]) -> None:
        self.timing = timing
        self.builder = timing.builder
        self._value = value

    def active(self, atom: FlatBlock) -> int | None:
        """The node that says whether a block runs; None where it always does."""
        if atom.control is None:
            return None
        node = self._node(atom.control, 0)
        always = node is not None and self.builder.value(node) == 1 and not atom.repeats
        return None if always else node

    def restart(self, atom: FlatBlock) -> int | None:
        """The node that says whether the memory of a block begins anew; None where it never does."""
        if atom.control is None or not resets_with_subsystem(atom):
            return None
        if any(number > 1 for number in atom.passes[len(atom.control.passes) :]):
            return None  # only the first pass of a step does
        return self._node(atom.control, 1)

    def _node(self, control: FlatBlock, port: int) -> int | None:
        found = self._value(SignalSource(control, port))
        return int(found.nodes.ravel()[0]) if isinstance(found, Signal) else None

    def written(self, atom: FlatBlock, period: float) -> int | None:
        """The node that says whether a block's memory is written; None where it always is."""
        active = self.active(atom)
        return self.both(active, self.timing.hit(self.timing.rate(atom) or SampleTime(period)))

    def both(self, *conditions: int | None) -> int | None:
        """The node that says whether all conditions hold; None where there are none."""
        found: int | None = None
        for condition in conditions:
            if condition is not None:
                found = condition if found is None else self.builder.call("and", found, condition)
        return found

    def every_step(self, atom: FlatBlock) -> bool:
        """Whether a block's memory is written in every step of the model."""
        every = self.timing.hit(self.timing.own(atom)) is None
        return atom.control is None and every and not atom.repeats and not atom.begins
