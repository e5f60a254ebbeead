"""Loops of imperative code, unrolled.

If the end of a loop depends on signals, each pass is one side of a decision within the previous pass.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import count
from typing import Final, TypeAlias

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.models.imperative.evaluation_context import MAX_PASSES, MAX_STATEMENTS
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.imperative.path_facts import bound_of, known_truth
from kennfeld.models.imperative.path_state import Key, PathState, SymbolicInterpreter, merge_states
from kennfeld.models.imperative.ranges import constant_distance, range_length
from kennfeld.models.imperative.symbolic_values import ConditionalValue, SymbolicValue
from kennfeld.program import tree as m

# the condition under which a pass is made, and what the variable of the loop is in it, which a while has not
Turn: TypeAlias = tuple[int, Nodes | None]
Begin: TypeAlias = Callable[[int], Turn | None]  # a pass by its number; None after the last one

_LIMIT_PASSES_REMEDY = "Limit the number of passes in the code: for k = 1:N with break, or while k < N && ..."


_LONG_PASSES: Final = 256  # of a loop whose end is a jump, which may depend on signals in some passes only


@dataclass(eq=False)
class _Loop:
    """A loop being unrolled.

    Attributes:
        begin: begins a pass.
        body: its statements.
        target: the variable that counts the passes.
        line: its line.
        before: the state before the first pass.
        outside: the conditions of its passes, each with the state before.
        open_passes: number of passes that were made only under a condition.
    """

    begin: Begin
    body: Sequence[m.Statement]
    target: m.Expression | None = None
    line: int = 0
    before: PathState | None = None
    outside: list[tuple[int, PathState]] = field(default_factory=list)
    open_passes: int = 0


class LoopUnroller:
    """Unrolling of loops."""

    def __init__(self, body: SymbolicInterpreter) -> None:
        self.body, self.context, self.builder = body, body.context, body.builder

    def _repeat(self, loop: _Loop) -> None:
        """Unroll the passes of a loop, each within the previous one."""
        outside = loop.outside
        loop.before = self.body.state
        if self.context.open_passes:
            loop.before = replace(loop.before, names=dict(loop.before.names), kept=dict(loop.before.kept))
        try:
            for number in count():
                if not self._pass(loop, number):
                    break
        except AbortedPathError:  # the last pass that was entered by a decision is never taken
            if not outside:
                raise
            condition, before = outside.pop()
            self.body.state = before.under(self.builder, condition, False)
        for condition, before in reversed(outside):
            no = before.under(self.builder, condition, False)
            self.body.state = merge_states(self.builder, condition, self.body.state, no, before)
        self.body.state.jumps.pop("break", None)

    def _pass(self, loop: _Loop, number: int) -> bool:
        """Run one pass; return False after the last one."""
        self.context.step()
        turn = loop.begin(number)
        if turn is None or not self._enter(turn[0], loop.outside):
            return False
        if self._has_no_end(loop, turn[0]):
            self._leave_unknown(loop)
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

    def _has_no_end(self, loop: _Loop, condition: int) -> bool:
        """Count a pass that is made; return True if there were too many whose condition depends on signals."""
        most = self.context.open_passes
        is_certain = self.builder.value(condition) is not None
        loop.open_passes += not is_certain
        # a loop whose condition always holds ends by a jump: it may count its passes, and end by that
        return 0 < most < loop.open_passes or (is_certain and most > 0 and len(loop.outside) > _LONG_PASSES)

    def _leave_unknown(self, loop: _Loop) -> None:
        """Continue behind a loop that would go on; what it has assigned is NaN from there on."""
        assert loop.before is not None
        self.context.open_loop(loop.line)
        unknown, state = self.builder.const(math.nan), self.body.state
        _forget(state.names, loop.before.names, unknown)
        _forget(state.kept, loop.before.kept, unknown)

    def _enter(self, condition: int, outside: list[tuple[int, PathState]]) -> bool:
        """Continue on the side where a condition holds; return False if it never does."""
        fixed = known_truth(self.builder, self.body.state.facts, condition)
        if fixed is None:
            if len(outside) > MAX_PASSES:
                raise ProgramError(
                    f"a loop whose end depends on signals does not end within {MAX_PASSES} passes", _LIMIT_PASSES_REMEDY
                )
            outside.append((condition, self.body.state))
            self.body.state = self.body.state.under(self.builder, condition, True)
        return fixed is not False

    def as_long_as(self, condition: m.Expression, body: Sequence[m.Statement], line: int = 0) -> None:
        """Run statements while a condition holds."""

        def begin(number: int) -> Turn:
            result = self.body.truth(self.body.value(condition))
            fixed = self.context.numbers(np.array([result], dtype=np.int64), "the condition of a loop")
            if fixed is None and number > MAX_PASSES:
                raise ProgramError(f"a while loop has no fixed end within {MAX_PASSES} passes", _LIMIT_PASSES_REMEDY)
            return result if fixed is None else self.builder.const(float(fixed.item() != 0)), None

        self._repeat(_Loop(begin, body, line=line))

    def over(self, target: m.Expression, values: m.Expression, body: Sequence[m.Statement]) -> None:
        """Run statements for each number of a range, or each column of an array."""
        begin = self._along_range(values) if isinstance(values, m.Range) else self._along_columns(values)
        self._repeat(_Loop(begin, body, target))

    def _along_columns(self, values: m.Expression) -> Begin:
        whole = self.body.nodes(values, "the range of a loop")
        columns: Sequence[Nodes] = list(whole.reshape(whole.shape[0], -1, order="F").T) if whole.size else []

        def begin(number: int) -> Turn | None:
            return (self.builder.const(1.0), columns[number].reshape(-1, 1)) if number < len(columns) else None

        return begin

    def _along_range(self, values: m.Range) -> Begin:
        """Return the passes over a range; if its length depends on signals, the maximum by their bounds."""
        first, last = self._end(values.first), self._end(values.last)
        step = self._step(values)
        span = constant_distance(self.context, first, last)
        passes = range_length(self.context, self._longest(first, last, step) if span is None else span, step)
        if passes > MAX_STATEMENTS:  # each pass is at least one
            raise ProgramError(f"it unrolls to more than {MAX_STATEMENTS} statements", _LIMIT_PASSES_REMEDY)
        fixed, builder = self.context.constant(first), self.builder
        start = first if fixed is None else builder.const(fixed)

        def begin(number: int) -> Turn | None:
            if number >= passes:
                return None
            at = builder.call("add", start, builder.const(number * step))
            within = builder.call("le" if step > 0 else "ge", at, last) if span is None else builder.const(1.0)
            return within, np.array([[at]], dtype=np.int64)

        return begin

    def _end(self, tree: m.Expression) -> int:
        nodes = self.body.nodes(tree, "the end of a range")
        if nodes.size != 1:
            raise ProgramError("the ends of a loop range must be scalars")
        self.context.numbers(nodes, "the end of a loop")
        return int(nodes.item())

    def _step(self, values: m.Range) -> float:
        if values.step is None:
            return 1.0
        numbers = self.context.numbers(self.body.nodes(values.step), "the step of a loop")
        if numbers is None or numbers.size != 1:
            raise ProgramError("the step of a loop range depends on signals", _LIMIT_PASSES_REMEDY)
        return float(numbers.item())

    def _longest(self, first: int, last: int, step: float) -> float:
        """Return the maximum distance from the first to the last number of a range, by their bounds."""
        up = step > 0
        result = bound_of(self.builder, last, up) - bound_of(self.builder, first, not up)
        if not np.isfinite(result):
            raise ProgramError(
                "the end of a loop range depends on signals and has no bound",
                f"Write min(..., N). {_LIMIT_PASSES_REMEDY}",
            )
        return result


def _forget(values: dict[Key, SymbolicValue], before: Mapping[Key, SymbolicValue], unknown: int) -> None:
    """Replace the numbers of variables that have changed by a node."""
    for key, value in values.items():
        if value is before.get(key):
            continue
        if isinstance(value, np.ndarray):
            values[key] = np.full_like(value, unknown)
        elif isinstance(value, ConditionalValue) and isinstance(value.value, np.ndarray):
            values[key] = ConditionalValue(np.full_like(value.value, unknown), value.defined)
