"""When blocks run: their sample times, what is held between the hits of them, and what keeps still in minor steps."""

from dataclasses import replace

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.expressions import Expressions
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import CONSTANT, CONTINUOUS, Bus, OpenBus, Signal, Wired, scalar
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.weaving.failures import Failures
from kennfeld.models.simulink.weaving.guesses import Guesses
from kennfeld.models.simulink.weaving.registry import KINDS
from kennfeld.models.simulink.weaving.schedule import Clock, Rate, stated_rate

__all__ = ["Timing"]


class Timing:
    """The sample times of the blocks in one pass over them."""

    def __init__(self, clock: Clock, expressions: Expressions, guesses: Guesses, failures: Failures) -> None:
        self.clock = clock
        self.expressions = expressions
        self.loom: Loom = expressions.loom
        self.guesses = guesses
        self.failures = failures

    # sample times

    def rate(self, atom: Atom) -> Rate | None:
        """The sample time that a block states by itself; None where it inherits."""
        try:
            return stated_rate(atom, self.expressions, KINDS.get(atom.kind))
        except NoValueError as error:
            self.failures.note(atom, f"its sample time has no value: {error}", "", error.undefined)
            return None

    def own(self, atom: Atom) -> Rate:
        """The sample time of a block: as stated, else as inherited."""
        return self.rate(atom) or Rate(self.guessed_period(atom))

    def stated_period(self, atom: Atom) -> float | None:
        """The period of the sample time that a block states in s; None where it inherits."""
        found = self.rate(atom)
        return None if found is None else found.period

    def guessed_period(self, atom: Atom) -> float:
        """The period that a block inherits from its inputs, as an earlier pass found it."""
        return self.guesses.periods.get(atom, CONTINUOUS)

    def task_order(self, one: Atom, other: Atom) -> int:
        """-1 where the first of two blocks is in a faster task, 1 where in a slower one; 0 where both may be in one."""
        if not self.clock.multitasking:
            return 0
        periods = [self.stated_period(atom) for atom in (one, other)]
        if periods[0] is None or periods[1] is None or CONSTANT in periods:
            return 0
        return (periods[0] > periods[1]) - (periods[0] < periods[1])

    def hit(self, rate: Rate) -> int | None:
        """The node that is 1 where a sample time is hit, None where every step of the model hits it."""
        return None if rate.period in (CONTINUOUS, CONSTANT) else self.clock.hit(self.loom, rate)

    def hits(self, period: float) -> Signal:
        """1 at the hits of a sample time."""
        node = self.clock.hit(self.loom, Rate(period)) if period > 0 else None
        return scalar(self.loom.const(1.0) if node is None else node, max(period, 0.0))

    # signals

    def sampled(self, atom: Atom, wired: Wired, remembers: bool) -> Wired:
        """An output as it is with the block's own sample time: held between its hits."""
        rate = self.own(atom) if remembers else self.rate(atom)
        if rate is None or rate.period in (CONTINUOUS, CONSTANT) or isinstance(wired, OpenBus):
            return wired
        if isinstance(wired, Bus):
            return Bus({name: self.sampled(atom, member, remembers) for name, member in wired.members.items()})
        if wired.period == CONSTANT or (wired.period == rate.period and not remembers):
            return replace(wired, period=rate.period)
        return self.held(atom, wired, rate)

    def held(self, atom: Atom, wired: Signal, rate: Rate) -> Signal:
        """A signal that is held between the hits of a block's sample time."""
        wired = self.at_major(wired)
        hit = self.clock.hit(self.loom, rate)
        if hit is None:
            return replace(wired, period=rate.period)
        if atom.passes:
            what = "it has a sample time of its own in a subsystem that runs several times in a step"
            self.failures.note(atom, what)
        made = [self._kept(hit, node) for node in wired.flat]
        nodes = np.array(made, dtype=np.int64).reshape(wired.shape, order="F")
        return Signal(nodes, rate.period)

    def _kept(self, hit: int, node: int) -> int:
        """A node that keeps its value between hits."""
        before = self.loom.state()
        y = self.loom.call("select", hit, node, before)
        self.loom.close(before, node, y)
        return y

    def at_major(self, x: Signal) -> Signal:
        """A signal that keeps, within the minor steps of the solver, its value of the major step."""
        if x.period != CONTINUOUS or not self.clock.continuous:
            return x
        made = [self.major(int(node)) for node in x.nodes.ravel()]
        return replace(x, nodes=np.array(made, dtype=np.int64).reshape(x.shape))

    def major(self, node: int) -> int:
        """A node that keeps its value of the major step within the minor steps."""
        if not self.clock.continuous or self.loom.nodes[node].op in ("const", "major"):
            return node
        return self.loom.node("major", (node,))
