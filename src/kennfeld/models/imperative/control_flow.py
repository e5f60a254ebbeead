"""Decisions and loops of imperative code: merging of variables, and unrolling.

After a decision each variable is selected by its condition. Loops are unrolled. If the end of a loop depends on
signals, each pass is one side of a decision within the previous pass.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab import syntax as m
from kennfeld.models.imperative.evaluation_context import MAX_PASSES
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError
from kennfeld.models.imperative.graph_operators import constant_distance, range_length
from kennfeld.models.imperative.node_arrays import Nodes, elementwise
from kennfeld.models.imperative.path_facts import assume, bound_of, known_truth, logical_and, logical_not, logical_or
from kennfeld.models.imperative.symbolic_values import (
    ConditionalValue,
    DeferredValue,
    FunctionHandleValue,
    InvalidValue,
    LogicalNodes,
    SymbolicCell,
    SymbolicStruct,
    SymbolicValue,
    as_logical,
    force,
    integers,
    word_of,
)

if TYPE_CHECKING:
    from kennfeld.models.imperative.statement_interpreter import StatementInterpreter


Key = TypeVar("Key")
_SAME_TYPE_REMEDY = "Give it the same type and size on both sides of the decision."

# the condition under which a pass is made, and what the variable of the loop is in it, which a while has not
Turn: TypeAlias = tuple[int, Nodes | None]
Begin: TypeAlias = Callable[[int], Turn | None]  # a pass by its number; None after the last one

_LIMIT_PASSES_REMEDY = "Limit the number of passes in the code: for k = 1:N with break, or while k < N && ..."


@dataclass(frozen=True)
class PathState:
    """The state of code along one path: variables, persistent variables by function, jumps and known conditions.

    `jumps` are the conditions under which a break, continue or return was executed; `facts` are the conditions known on
    this path.
    """

    names: dict[str, SymbolicValue] = field(default_factory=dict)
    kept: dict[tuple[str, str], SymbolicValue] = field(default_factory=dict)
    jumps: dict[str, int] = field(default_factory=dict)
    facts: Mapping[int, bool] = field(default_factory=dict)

    def under(self, builder: GraphBuilder, condition: int, holds: bool) -> "PathState":
        """Return a copy for one side of a decision, which may be changed."""
        facts = assume(builder, self.facts, condition, holds)
        return PathState(dict(self.names), dict(self.kept), dict(self.jumps), facts)


def merge_states(builder: GraphBuilder, condition: int, yes: PathState, no: PathState, before: PathState) -> PathState:
    """Return the state after a decision."""
    work = _StateMerge(builder, condition, yes.facts, no.facts)
    jumps = {kind: work.jump(yes.jumps.get(kind), no.jumps.get(kind)) for kind in {**yes.jumps, **no.jumps}}
    return replace(before, names=work.mapping(yes.names, no.names), kept=work.mapping(yes.kept, no.kept), jumps=jumps)


class _StateMerge:
    def __init__(self, builder: GraphBuilder, condition: int, yes: Mapping[int, bool], no: Mapping[int, bool]) -> None:
        self.builder, self.condition = builder, condition
        self.yes, self.no = yes, no
        self.choice = np.array([[condition]], dtype=np.int64)

    def jump(self, yes: int | None, no: int | None) -> int:
        builder, never = self.builder, self.builder.const(0.0)
        one = logical_and(builder, self.condition, never if yes is None else yes)
        other = logical_and(builder, logical_not(builder, self.condition), never if no is None else no)
        return logical_or(builder, one, other)

    def mapping(self, yes: Mapping[Key, SymbolicValue], no: Mapping[Key, SymbolicValue]) -> dict[Key, SymbolicValue]:
        return {key: self.held(str(key), yes.get(key), no.get(key)) for key in {**no, **yes}}

    def held(self, name: str, yes: SymbolicValue | None, no: SymbolicValue | None) -> SymbolicValue:
        if yes is no and yes is not None:
            return yes
        yes, no = self._whole(yes, self.yes), self._whole(no, self.no)
        if yes is None or no is None or isinstance(yes, ConditionalValue) or isinstance(no, ConditionalValue):
            return self._partial(name, yes, no)
        if isinstance(yes, InvalidValue) or isinstance(no, InvalidValue):
            return yes if isinstance(yes, InvalidValue) else no
        return self._both(name, yes, no)

    def _whole(self, held: SymbolicValue | None, facts: Mapping[int, bool]) -> SymbolicValue | None:
        if isinstance(held, DeferredValue):
            return force(held)
        if isinstance(held, ConditionalValue):
            truth = known_truth(self.builder, facts, held.defined)
            return held if truth is None else held.value if truth else None
        return held

    def _partial(self, name: str, yes: SymbolicValue | None, no: SymbolicValue | None) -> SymbolicValue:
        """Merge a variable that is certainly defined on at most one side."""
        values = [item.value if isinstance(item, ConditionalValue) else item for item in (yes, no)]
        if values[0] is None or values[1] is None:
            value = values[0] if values[0] is not None else values[1]
            if value is None:
                return InvalidValue(f"{name} is not assigned")
        else:
            value = self.held(name, *values)
        return (
            value
            if isinstance(value, InvalidValue)
            else ConditionalValue(value, self.jump(self._defined(yes), self._defined(no)))
        )

    def _defined(self, held: SymbolicValue | None) -> int:
        return held.defined if isinstance(held, ConditionalValue) else self.builder.const(float(held is not None))

    def _both(self, name: str, yes: SymbolicValue, no: SymbolicValue) -> SymbolicValue:
        match yes, no:
            case np.ndarray(), np.ndarray():
                return self._arrays(name, yes, no)
            case SymbolicStruct(), SymbolicStruct() if set(yes.fields) == set(no.fields):
                return SymbolicStruct(
                    {key: self.held(f"{name}.{key}", yes.fields[key], no.fields[key]) for key in yes.fields}
                )
            case SymbolicCell(), SymbolicCell() if yes.shape == no.shape:
                pairs = zip(yes.cells, no.cells, strict=True)
                return SymbolicCell(tuple(self.held(name, *pair) for pair in pairs), yes.shape)
            case str(), str() if yes == no:
                return yes
            case FunctionHandleValue(), FunctionHandleValue() if yes.function == no.function and not (
                yes.names or no.names
            ):
                return yes
        return InvalidValue(f"{name} has different types on the two sides of a condition", _SAME_TYPE_REMEDY)

    def _arrays(self, name: str, yes: Nodes, no: Nodes) -> SymbolicValue:
        if yes.shape != no.shape:
            sizes = " or ".join("x".join(map(str, item.shape)) for item in (yes, no))
            return InvalidValue(f"the size of {name} depends on a condition ({sizes})", _SAME_TYPE_REMEDY)
        result = yes if np.array_equal(yes, no) else elementwise(self.builder, "select", self.choice, yes, no)
        if isinstance(yes, LogicalNodes) and isinstance(no, LogicalNodes):
            return as_logical(result)
        return integers(result, word_of(yes) if word_of(yes) == word_of(no) else None)


@dataclass(frozen=True)
class _Loop:
    """A loop being unrolled; `outside` are the conditions of its passes, each with the state before."""

    begin: Begin
    body: Sequence[m.Statement]
    target: m.Expression | None = None
    outside: list[tuple[int, PathState]] = field(default_factory=list)


class LoopUnroller:
    """Unrolling of loops."""

    def __init__(self, body: "StatementInterpreter") -> None:
        self.body, self.context, self.builder = body, body.context, body.builder

    def _repeat(self, loop: _Loop) -> None:
        """Unroll the passes of a loop, each within the previous one."""
        outside = loop.outside
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

    def as_long_as(self, condition: m.Expression, body: Sequence[m.Statement]) -> None:
        """Run statements while a condition holds."""

        def begin(number: int) -> Turn:
            result = self.body.truth(self.body.value(condition))
            fixed = self.context.numbers(np.array([result], dtype=np.int64), "the condition of a loop")
            if fixed is None and number > MAX_PASSES:
                raise ProgramError(f"a while loop has no fixed end within {MAX_PASSES} passes", _LIMIT_PASSES_REMEDY)
            return result if fixed is None else self.builder.const(float(fixed.item() != 0)), None

        self._repeat(_Loop(begin, body))

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
        span = constant_distance(self.body.calls, first, last)
        passes = range_length(self.body.calls, self._longest(first, last, step) if span is None else span, step)
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
