"""Loops of MATLAB code, unrolled: over ranges and columns, and as long as a condition holds.

Where the end of a loop depends on signals, each pass is one side of a decision within the pass before it.
"""

from collections.abc import Callable, Sequence
from itertools import count
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.conditions import known
from kennfeld.models.simulink.code.desk import MOST_PASSES
from kennfeld.models.simulink.code.errors import CodeError, EndedError
from kennfeld.models.simulink.code.joining import State, joined
from kennfeld.models.simulink.code.limits import most_of
from kennfeld.models.simulink.code.values import Truths, constants
from kennfeld.models.simulink.expressions.arrays import each

if TYPE_CHECKING:
    from kennfeld.models.simulink.code.body import Body

__all__ = ["Loops"]

Begin: TypeAlias = Callable[[int], int | None]  # the condition of a pass by its number; None after the last one

_PASSES = "Bound its passes by a number in the code: for k = 1:N with break, or while k < N && ..."


class Loops:
    """The loops of a body."""

    def __init__(self, body: "Body") -> None:
        self.body, self.desk, self.loom = body, body.desk, body.loom

    def _repeat(self, begin: Begin, body: Sequence[m.Statement]) -> None:
        """Passes of a loop one within the other; `begin` gives the condition of a pass, None after the last one."""
        outside: list[tuple[int, State]] = []
        try:
            for number in count():
                if not self._pass(begin, number, body, outside):
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

    def _pass(self, begin: Begin, number: int, body: Sequence[m.Statement], outside: list[tuple[int, State]]) -> bool:
        """One pass; false where it was the last one."""
        self.desk.step()
        condition = begin(number)
        if condition is None or not self._enter(condition, outside):
            return False
        self.body.run(body)
        self.body.state.jumps.pop("continue", None)
        going = self.body.going()
        if going is not None and not self._enter(going, outside):
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

        def begin(number: int) -> int:
            found = self.body.truth(self.body.value(condition))
            fixed = self.desk.numbers(np.array([found], dtype=np.int64), "the condition of a loop")
            if fixed is None and number > MOST_PASSES:
                raise CodeError(f"while does not end within {MOST_PASSES} passes by what the code says", _PASSES)
            return found if fixed is None else self.loom.const(float(fixed.item() != 0))

        self._repeat(begin, body)

    def over(self, target: m.Expression, values: m.Expression, body: Sequence[m.Statement]) -> None:
        """Run statements for each number of a range, or each column of an array."""
        if isinstance(values, m.Range):
            self._repeat(self._counting(target, values), body)
            return
        whole = self.body.nodes(values, "what a loop runs over")
        columns = iter([column.reshape(-1, 1) for column in whole.T] if whole.size else [])

        def begin(number: int) -> int | None:
            column = next(columns, None)
            if column is None:
                return None
            self.body.assign(target, column.view(Truths) if isinstance(whole, Truths) else column)
            return self.loom.const(1.0)

        self._repeat(begin, body)

    def _counting(self, target: m.Expression, values: m.Range) -> Begin:
        """The passes over a range, whose end may depend on signals where a limit of it is known."""
        first, step = self._fixed(values.first), self._fixed(values.step or m.Number(1.0))
        end = self.body.nodes(values.last, "the end of a range")
        if first is None or step is None or not step or end.size != 1:
            return self._walking(target, values)
        last, loom = int(end.item()), self.loom
        fixed = self.desk.numbers(end, "the end of a loop")
        limit = float(fixed.item()) if fixed is not None else most_of(loom, last, step > 0)
        if not np.isfinite(limit):
            raise CodeError(
                "a loop to an end that depends on signals, without a limit", f"Write min(..., N). {_PASSES}"
            )
        passes = int(np.floor((limit - first) / step * (1 + 1e-12) + 1e-10)) + 1
        self.desk.room(passes)

        def begin(number: int) -> int | None:
            if number >= passes:
                return None
            at = loom.const(first + number * step)
            holds = loom.call("le" if step > 0 else "ge", at, last) if fixed is None else loom.const(1.0)
            self.body.assign(target, np.array([[at]], dtype=np.int64))
            return holds

        return begin

    def _walking(self, target: m.Expression, values: m.Range) -> Begin:
        """The passes over a range whose beginning depends on signals: its ends tell how many there are at most."""
        first, last = (self.body.nodes(part, "the end of a range") for part in (values.first, values.last))
        step = self._fixed(values.step or m.Number(1.0))
        if first.size != 1 or last.size != 1 or not step:
            raise CodeError("a loop over a range whose step depends on signals", _PASSES)
        loom, up = self.loom, step > 0
        span = (most_of(loom, int(last.item()), up) - most_of(loom, int(first.item()), not up)) / step
        fixed = each(loom, "sub", last, first)
        known_span = self.desk.constant(int(fixed.item()))
        passes = (
            int(np.floor((known_span / step if known_span is not None else span) + 1e-10)) + 1
            if (known_span is not None or np.isfinite(span))
            else -1
        )
        if passes < 0 and known_span is None:
            raise CodeError("a loop over a range that depends on signals, without limits", _PASSES)

        def begin(number: int) -> int | None:
            if number >= passes:
                return None
            at = each(loom, "add", first, constants(loom, number * step))
            self.body.assign(target, at)
            return int(each(loom, "le" if up else "ge", at, last).item())

        return begin

    def _fixed(self, tree: m.Expression) -> float | None:
        nodes = self.body.nodes(tree, "the end of a range")
        found = self.desk.numbers(nodes, "a range") if nodes.size == 1 else None
        return float(found.item()) if found is not None else None
