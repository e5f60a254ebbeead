"""When blocks run: sample times, holds between hits, and execution conditions of conditional subsystems."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, SignalSource, resets_with_subsystem
from kennfeld.importers.simulink.lowering.diagnostics import BlockFailures
from kennfeld.importers.simulink.lowering.pass_state import InferredAttributes
from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.importers.simulink.signals import CONSTANT, CONTINUOUS, Bus, ExternalBus, Signal, SignalOrBus, scalar
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.sample_times import SampleTime, sample_hit

_MIN_PERIOD = 1e-9  # s


def explicit_sample_time(flat: FlatBlock, expressions: ParameterExpressions) -> SampleTime | None:
    """Evaluate the sample time in s that a block specifies, None if inherited; raises `EvaluationError`."""
    kind = BLOCK_TYPES.get(flat.type)
    key = kind.sample_of(flat.block) if kind is not None else "SampleTime"
    text = _of_chart(flat) or flat.block.value(key) or (kind.defaults.get(key) if kind is not None else None)
    if flat.type == "DiscretePulseGenerator" or text is None or not text.strip() or text.strip() == "-1":
        return None
    numbers = expressions.numbers(text, flat.scope).ravel()
    # [period offset]; -1 is inherited, inf constant, 0 continuous
    period = float(numbers[0]) if numbers.size else -1.0
    offset = float(numbers[1]) if numbers.size > 1 else 0.0
    if period == -1.0:
        return None
    if math.isinf(period):
        return SampleTime(CONSTANT)
    if not period >= 0:
        raise EvaluationError(f"must be a sample time, got {text.strip()[:40]}")
    if 0 < period < _MIN_PERIOD:
        raise EvaluationError(f"the sample time {text.strip()[:40]} ({period:g} s) must be at least {_MIN_PERIOD:g} s")
    return SampleTime(period, offset if period else 0.0)


def _of_chart(flat: FlatBlock) -> str:
    """Return the sample time of a chart or function imported alone."""
    chart = flat.block.chart if flat.type in ("Chart", "MATLAB Function") else None
    return chart.sample_time if chart is not None and chart.update == "DISCRETE" else ""


@dataclass
class ModelClock:
    """Steps of a model: `step` in s, None for that of the data, and whether there are continuous states.

    `multitasking` is True if each sample time is a task of its own, faster ones first; None if the file does not
    specify it.
    """

    step: float | None
    continuous: bool = False
    multitasking: bool | None = False

    def hit(self, builder: GraphBuilder, rate: SampleTime) -> int | None:
        """Return the node that is 1 at a sample hit, None if every step is one."""
        hit = sample_hit(builder, rate, self.step)
        if hit is None:
            return None
        # minor steps of the solver have other times, but belong to the same hit
        return builder.node("hold", (hit,)) if self.continuous else hit


class SampleTimes:
    """Sample times of blocks in one pass."""

    def __init__(
        self, clock: ModelClock, expressions: ParameterExpressions, guesses: InferredAttributes, failures: BlockFailures
    ) -> None:
        self.clock = clock
        self.expressions = expressions
        self.builder: GraphBuilder = expressions.builder
        self.guesses = guesses
        self.failures = failures

    def specified_sample_time(self, flat: FlatBlock) -> SampleTime | None:
        """Evaluate the sample time in s that a block specifies, None if inherited."""
        try:
            return explicit_sample_time(flat, self.expressions)
        except EvaluationError as error:
            self.failures.note(flat, f"its sample time has no value: {error}", "", error.undefined)
            return None

    def sample_time(self, flat: FlatBlock) -> SampleTime:
        """Return the sample time of a block, specified or inherited."""
        return self.specified_sample_time(flat) or SampleTime(self.guesses.periods.get(flat, CONTINUOUS))

    def specified_period(self, flat: FlatBlock) -> float | None:
        """Return the specified period of a block in s, None if inherited."""
        rate = self.specified_sample_time(flat)
        return None if rate is None else rate.period

    def period(self, flat: FlatBlock) -> float:
        """Return the period of a block in s, specified or inherited."""
        return self.sample_time(flat).period

    def task_order(self, block: FlatBlock, other: FlatBlock) -> int:
        """Compare the tasks of two blocks: -1 if that of the first is faster, 1 if slower, 0 if they may share one."""
        if not self.clock.multitasking:
            return 0
        periods = [self.specified_period(flat) for flat in (block, other)]
        if periods[0] is None or periods[1] is None or CONSTANT in periods:
            return 0
        # rate-monotonic: the shorter the period, the higher the priority
        return (periods[0] > periods[1]) - (periods[0] < periods[1])

    def hit(self, rate: SampleTime) -> int | None:
        """Return the node that is 1 at a sample hit, None if every step is one."""
        return None if rate.period in (CONTINUOUS, CONSTANT) else self.clock.hit(self.builder, rate)

    def hits(self, period: float) -> Signal:
        """Return 1 at the hits of a sample time."""
        node = self.clock.hit(self.builder, SampleTime(period)) if period > 0 else None
        return scalar(self.builder.const(1.0) if node is None else node, max(period, 0.0), self.builder)

    def sample(self, flat: FlatBlock, wired: SignalOrBus, remembers: bool) -> SignalOrBus:
        """Sample an output at the block's sample time, held between hits."""
        # a block without states follows its inputs, which are already held at an inherited sample time
        rate = self.sample_time(flat) if remembers else self.specified_sample_time(flat)
        if rate is None or rate.period in (CONTINUOUS, CONSTANT) or isinstance(wired, ExternalBus):
            return wired
        if isinstance(wired, Bus):
            return Bus({name: self.sample(flat, member, remembers) for name, member in wired.members.items()})
        # such a signal changes at the hits only, so that holding it would add states in vain
        if wired.period == CONSTANT or (wired.period == rate.period and not remembers):
            return replace(wired, period=rate.period)
        return self.hold(flat, wired, rate)

    def hold(self, flat: FlatBlock, wired: Signal, rate: SampleTime) -> Signal:
        """Hold a signal between the hits of a block's sample time."""
        wired = self.hold_in_minor_steps(wired)
        hit = self.clock.hit(self.builder, rate)
        if hit is None:
            return replace(wired, period=rate.period)
        if flat.passes:
            self.failures.note(flat, "it has its own sample time in an iterated subsystem, which is not supported")
        nodes = np.array([self._hold_node(hit, node) for node in wired.flat], dtype=np.int64)
        return replace(wired, nodes=nodes.reshape(wired.shape, order="F"), period=rate.period)

    def _hold_node(self, hit: int, node: int) -> int:
        before = self.builder.state()
        # y = hit ? x : y', which begins with x
        y = self.builder.call("select", hit, node, before)
        self.builder.close(before, node, y)
        return y

    def hold_in_minor_steps(self, x: Signal) -> Signal:
        """Hold a signal during the minor steps of the solver."""
        if x.period != CONTINUOUS or not self.clock.continuous:
            return x
        nodes = [
            node if self.builder.nodes[node].op in ("const", "hold") else self.builder.node("hold", (node,))
            for node in map(int, x.nodes.ravel())
        ]
        return replace(x, nodes=np.array(nodes, dtype=np.int64).reshape(x.shape))


class ExecutionConditions:
    """Execution conditions of blocks as nodes; `value` returns the signals of conditional subsystems."""

    def __init__(self, timing: SampleTimes, value: Callable[[SignalSource], SignalOrBus]) -> None:
        self.timing = timing
        self.builder = timing.builder
        self._value = value

    def run_condition(self, flat: FlatBlock) -> int | None:
        """Return the node that is 1 if a block runs, None if it always does."""
        if flat.control is None:
            return None
        node = self._node(flat.control, 0)
        always = node is not None and self.builder.value(node) == 1 and not flat.repeats
        return None if always else node

    def reset_condition(self, flat: FlatBlock) -> int | None:
        """Return the node that is 1 if the states of a block are reset, None if they never are."""
        if flat.control is None or not resets_with_subsystem(flat):
            return None
        if any(number > 1 for number in flat.passes[len(flat.control.passes) :]):
            return None  # only in the first iteration of a step
        return self._node(flat.control, 1)

    def _node(self, control: FlatBlock, port: int) -> int | None:
        signal = self._value(SignalSource(control, port))
        return int(signal.nodes.ravel()[0]) if isinstance(signal, Signal) else None

    def write_condition(self, flat: FlatBlock, period: float) -> int | None:
        """Return the node that is 1 if the states of a block are written, None if they always are."""
        active = self.run_condition(flat)
        return self.conjunction(active, self.timing.hit(self.timing.specified_sample_time(flat) or SampleTime(period)))

    def conjunction(self, *conditions: int | None) -> int | None:
        """Join conditions by "and", None if there are none."""
        conjunction: int | None = None
        for condition in conditions:
            if condition is not None:
                conjunction = condition if conjunction is None else self.builder.call("and", conjunction, condition)
        return conjunction

    def is_written_every_step(self, flat: FlatBlock) -> bool:
        """Return True if the states of a block are written in every step."""
        every = self.timing.hit(self.timing.sample_time(flat)) is None
        return flat.control is None and every and not flat.repeats and not flat.resets_each_step
