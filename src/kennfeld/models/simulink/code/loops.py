"""Loops of MATLAB code, unrolled: over ranges and columns, and as long as a condition holds.

Where the end of a loop depends on signals, each pass is one side of a decision within the pass before it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.conditions import known
from kennfeld.models.simulink.code.desk import MOST_PASSES
from kennfeld.models.simulink.code.errors import CodeError, EndedError
from kennfeld.models.simulink.code.joining import State, joined
from kennfeld.models.simulink.code.limits import most_of
from kennfeld.models.simulink.code.ranges import distance, steps_within
from kennfeld.models.simulink.expressions.signals import Nodes

if TYPE_CHECKING:
    from kennfeld.models.simulink.code.body import Body

__all__ = ["Loops"]

# the condition under which a pass is made, and what the variable of the loop is in it, which a while has not
Turn: TypeAlias = tuple[int, Nodes | None]
Begin: TypeAlias = Callable[[int], Turn | None]  # a pass by its number; None after the last one

_PASSES = "Bound its passes by a number in the code: for k = 1:N with break, or while k < N && ..."


@dataclass(frozen=True)
class _Loop:
    """A loop while it is unrolled; `outside` are the passes that a decision led into, with what was before each."""

    begin: Begin
    body: Sequence[m.Statement]
    target: m.Expression | None = None
    outside: list[tuple[int, State]] = field(default_factory=list)


class Loops:
    """The loops of a body."""

    def __init__(self, body: "Body") -> None:
        self.body, self.desk, self.loom = body, body.desk, body.loom

    def _repeat(self, loop: _Loop) -> None:
        """Passes of a loop, one within the other."""
        outside = loop.outside
        try:
            for number in count():
                if not self._pass(loop, number):
                    break
        except EndedError:  # the last pass that was entered by a decision is never taken
            if not outside:
                raise
            condition, before = outside.pop()
            self.body.state = before.under(self.loom, condition, False)
        for condition, before in reversed(outside):
            no = before.under(self.loom, condition, False)
            self.body.state = joined(self.loom, condition, self.body.state, no, before)
        self.body.state.jumps.pop("break", None)

    def _pass(self, loop: _Loop, number: int) -> bool:
        """One pass; false where it was the last one."""
        self.desk.step()
        turn = loop.begin(number)
        if turn is None or not self._enter(turn[0], loop.outside):
            return False
        if turn[1] is not None:
            self.body.assign(loop.target, turn[1])
        self.body.run(loop.body)
        self.body.state.jumps.pop("continue", None)
        going = self.body.going()
        if going is not None and not self._enter(going, loop.outside):
            return False
        if going is not None:
            self.body.state.jumps.clear()
        return True

    def _enter(self, condition: int, outside: list[tuple[int, State]]) -> bool:
        """Go on where a condition holds; false where it never does."""
        fixed = known(self.loom, self.body.state.facts, condition)
        if fixed is None:
            if len(outside) > MOST_PASSES:
                raise CodeError(
                    f"a loop whose end depends on signals does not end within {MOST_PASSES} passes", _PASSES
                )
            outside.append((condition, self.body.state))
            self.body.state = self.body.state.under(self.loom, condition, True)
        return fixed is not False

    def as_long_as(self, condition: m.Expression, body: Sequence[m.Statement]) -> None:
        """Run statements as long as a condition holds."""

        def begin(number: int) -> Turn:
            found = self.body.truth(self.body.value(condition))
            fixed = self.desk.numbers(np.array([found], dtype=np.int64), "the condition of a loop")
            if fixed is None and number > MOST_PASSES:
                raise CodeError(f"while does not end within {MOST_PASSES} passes by what the code says", _PASSES)
            return found if fixed is None else self.loom.const(float(fixed.item() != 0)), None

        self._repeat(_Loop(begin, body))

    def over(self, target: m.Expression, values: m.Expression, body: Sequence[m.Statement]) -> None:
        """Run statements for each number of a range, or each column of an array."""
        begin = self._along_range(values) if isinstance(values, m.Range) else self._along_columns(values)
        self._repeat(_Loop(begin, body, target))

    def _along_columns(self, values: m.Expression) -> Begin:
        whole = self.body.nodes(values, "what a loop runs over")
        columns: Sequence[Nodes] = list(whole.reshape(whole.shape[0], -1, order="F").T) if whole.size else []

        def begin(number: int) -> Turn | None:
            return (self.loom.const(1.0), columns[number].reshape(-1, 1)) if number < len(columns) else None

        return begin

    def _along_range(self, values: m.Range) -> Begin:
        """The passes over a range; where its length depends on signals, as many as its limits allow."""
        first, last = self._end(values.first), self._end(values.last)
        step = self._step(values)
        span = distance(self.body.calls, first, last)
        passes = steps_within(self.body.calls, self._longest(first, last, step) if span is None else span, step)
        fixed, loom = self.desk.constant(first), self.loom
        start = first if fixed is None else loom.const(fixed)

        def begin(number: int) -> Turn | None:
            if number >= passes:
                return None
            at = loom.call("add", start, loom.const(number * step))
            within = loom.call("le" if step > 0 else "ge", at, last) if span is None else loom.const(1.0)
            return within, np.array([[at]], dtype=np.int64)

        return begin

    def _end(self, tree: m.Expression) -> int:
        nodes = self.body.nodes(tree, "the end of a range")
        if nodes.size != 1:
            raise CodeError("a loop over a range from or to an array")
        self.desk.numbers(nodes, "the end of a loop")
        return int(nodes.item())

    def _step(self, values: m.Range) -> float:
        if values.step is None:
            return 1.0
        found = self.desk.numbers(self.body.nodes(values.step), "the step of a loop")
        if found is None or found.size != 1:
            raise CodeError("a loop over a range whose step depends on signals", _PASSES)
        return float(found.item())

    def _longest(self, first: int, last: int, step: float) -> float:
        """How far it can be from the first to the last number of a range, by their limits."""
        up = step > 0
        found = most_of(self.loom, last, up) - most_of(self.loom, first, not up)
        if not np.isfinite(found):
            raise CodeError(
                "a loop to an end that depends on signals, without a limit", f"Write min(..., N). {_PASSES}"
            )
        return found
