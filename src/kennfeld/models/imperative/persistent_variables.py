"""Persistent variables as states of the graph.

The code is followed as in its first call to find their initial values. If `if isempty(x) ... end` assigns constants or
parameters, these become the first values of the states and the decision is removed. Otherwise a second state records
whether x has a value.
"""

from collections.abc import Callable, Mapping
from dataclasses import field, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.imperative.path_state import PathState
from kennfeld.models.imperative.statement_interpreter import GLOBAL, StatementInterpreter
from kennfeld.program import tree as m

Key: TypeAlias = tuple[str, str]
Remember: TypeAlias = Callable[[Nodes, Callable[[], Nodes]], Nodes]


@dataclass(frozen=True, eq=False)
class PersistentVariable:
    """A persistent variable after the first call: its value, and its initial value if constant.

    `always` is True if the first call certainly assigns it.
    """

    last: s.SymbolicValue
    start: s.SymbolicValue | None
    always: bool = True


@dataclass(eq=False)
class FirstCallObserver:
    """Observer of the first call for decisions that initialise persistent variables."""

    context: EvaluationContext
    body: StatementInterpreter
    starts: dict[Key, s.SymbolicValue] = field(default_factory=dict)
    asked: int = 0  # decisions on isempty that a start takes away

    def watch(self, whole: m.If, before: PathState, asked: int) -> None:
        """Record the values assigned by a decision on isempty alone, if constant and without other effects."""
        frame, names = self.body.frame, self.body.names
        is_alone = len(whole.branches) == 1 and not whole.otherwise
        if not (is_alone and _holds_if_empty(whole.branches[0].condition, frame.persistent)):
            return
        changed = [name for name, value in names.items() if value is not before.names.get(name)]
        kept = self.body.state.kept
        if self.body.state.jumps or any(kept[key] is not before.kept.get(key) for key in kept):
            return
        if not all(name in frame.persistent and self._is_start(name, before) for name in changed):
            return
        for name in changed:
            self.starts[frame.name, name] = names[name]
        self.asked += asked

    def _is_start(self, name: str, before: PathState) -> bool:
        old, new = before.names.get(name), self.body.names[name]
        if not is_unset(self.context, old) or isinstance(new, s.ConditionalValue | s.InvalidValue):
            return False
        nodes = [int(node) for part in s.leaf_arrays(new) for node in part.ravel()]
        return all(self.context.constant(node) is not None for node in nodes)


def _holds_if_empty(condition: m.Expression, names: list[str]) -> bool:
    """Return True if a condition holds whenever one of these variables is empty."""
    match condition:
        case m.Call(m.Name("isempty"), (m.Name(name),)):
            return name in names
        case m.Binary("||" | "|", left, right):
            return _holds_if_empty(left, names) or _holds_if_empty(right, names)
    return False


def initial_persistents(
    scout: FirstCallObserver, kept: dict[Key, s.SymbolicValue], questions: int
) -> dict[Key, PersistentVariable]:
    """Return the persistent variables after the first call; `questions` counts the queries by isempty."""
    plain = questions == scout.asked
    return {
        key: _memory(key, value, scout.starts.get(key) if plain else None)
        for key, value in kept.items()
        if key[0] != GLOBAL and not is_unset(scout.context, value)
    }


def late_persistents(
    context: EvaluationContext, kept: Mapping[Key, s.SymbolicValue], known: Mapping[Key, PersistentVariable]
) -> dict[Key, PersistentVariable]:
    """Return the persistent variables that only later calls assign."""
    late = {key: value for key, value in kept.items() if key not in known and key[0] != GLOBAL}
    result = {key: _memory(key, value, None) for key, value in late.items() if not is_unset(context, value)}
    return {key: replace(item, always=False) for key, item in result.items()}


def is_unset(context: EvaluationContext, value: s.SymbolicValue | None) -> bool:
    """Return True if a variable certainly has no value."""
    return isinstance(value, s.ConditionalValue) and context.builder.value(value.defined) == 0.0


def _memory(key: Key, current: s.SymbolicValue, start: s.SymbolicValue | None) -> PersistentVariable:
    value = current.value if isinstance(current, s.ConditionalValue) else current
    if isinstance(value, s.InvalidValue):
        raise ProgramError(value.why, value.remedy)
    if start is not None and _sizes(start) != _sizes(value):
        raise ProgramError(f"the size of the persistent variable {key[1]} changes", "Initialize it with its full size.")
    return PersistentVariable(value, start, not isinstance(current, s.ConditionalValue))


def _sizes(value: s.SymbolicValue) -> list[tuple[int, ...]]:
    return [part.shape for part in s.leaf_arrays(value)]


class PersistentVariables:
    """The persistent variables of a block at the start of a call; `remember` creates their states."""

    def __init__(self, context: EvaluationContext, remember: Remember) -> None:
        self.context, self.remember = context, remember
        self._called: int | None = None

    def begun(self, memory: PersistentVariable, end: Callable[[], s.SymbolicValue | None]) -> s.SymbolicValue:
        """Return a variable at the start of a call; `end` is its value at the end."""
        first = memory.last if memory.start is None else memory.start
        zero = self.context.builder.const(0.0)
        arrays = [
            self.remember(
                np.full(part.shape, zero, dtype=np.int64) if memory.start is None else np.asarray(part),
                partial(_value_at_end, memory, end, at),
            )
            for at, part in enumerate(s.leaf_arrays(first))
        ]
        read = s.with_leaf_arrays(memory.last, iter(arrays))
        return read if memory.start is not None else s.ConditionalValue(read, self._has_value(memory, end))

    def _has_value(self, memory: PersistentVariable, end: Callable[[], s.SymbolicValue | None]) -> int:
        """Return the condition that a variable has a value, shared by all assigned in the first call."""
        builder = self.context.builder

        def has_value() -> Nodes:
            value = end()
            defined = (
                value.defined if isinstance(value, s.ConditionalValue) and not memory.always else builder.const(1.0)
            )
            return np.array([[defined]], dtype=np.int64)

        if memory.always and self._called is not None:
            return self._called
        result = int(self.remember(np.array([[builder.const(0.0)]], dtype=np.int64), has_value).item())
        if memory.always:
            self._called = result
        return result


def _value_at_end(memory: PersistentVariable, end: Callable[[], s.SymbolicValue | None], at: int) -> Nodes:
    """Return the value of an array at the end of a call."""
    current = end()
    value = current.value if isinstance(current, s.ConditionalValue) else current
    if value is None or _sizes(value) != _sizes(memory.last):
        raise ProgramError("the size of a persistent variable changes", "Initialize it with its full size.")
    return list(s.leaf_arrays(value))[at]
