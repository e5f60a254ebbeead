"""Variables that keep their values from one call of a function to the next.

The code is followed as in its very first call, to see what becomes of them. Where `if isempty(x) ... end` gives fixed
numbers or parameters, that is what the memory starts with, and the decision is gone. Else a second memory tells whether
x has a value already.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.imperative.control_flow import PathState
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.imperative.statement_interpreter import GLOBAL, StatementInterpreter
from kennfeld.models.imperative.symbolic_values import (
    ConditionalValue,
    InvalidValue,
    SymbolicValue,
    leaf_arrays,
    with_leaf_arrays,
)

__all__ = [
    "FirstCallObserver",
    "Key",
    "PersistentVariable",
    "PersistentVariables",
    "declares_persistent",
    "initial_persistents",
    "late_persistents",
]

Key: TypeAlias = tuple[str, str]
Remember: TypeAlias = Callable[[Nodes, Callable[[], Nodes]], Nodes]


def declares_persistent(statements: object) -> bool:
    """Whether there are persistent variables in statements."""
    if isinstance(statements, m.Declaration):
        return statements.kind == "persistent"
    if isinstance(statements, tuple):
        return any(map(declares_persistent, statements))
    parts = ("body", "branches", "otherwise", "cases")
    return any(declares_persistent(getattr(statements, part)) for part in parts if hasattr(statements, part))


@dataclass(frozen=True, eq=False)
class PersistentVariable:
    """A persistent variable after the first call: its value, what it starts with if that is fixed.

    `always` says that the first call gives it a value for certain.
    """

    last: SymbolicValue
    start: SymbolicValue | None
    always: bool = True


@dataclass(eq=False)
class FirstCallObserver:
    """Watches the first call for the decisions that give persistent variables their first values."""

    context: EvaluationContext
    body: StatementInterpreter
    starts: dict[Key, SymbolicValue] = field(default_factory=dict)
    asked: int = 0  # decisions on isempty that a start takes away

    def watch(self, whole: m.If, before: PathState, asked: int) -> None:
        """Note the values that a decision on isempty alone gives, where they are fixed and it does nothing else."""
        frame, names = self.body.frame, self.body.names
        if len(whole.branches) != 1 or whole.otherwise or not _asks(whole.branches[0].condition, frame.persistent):
            return
        changed = [name for name, held in names.items() if held is not before.names.get(name)]
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
        if not unset(self.context, old) or isinstance(new, ConditionalValue | InvalidValue):
            return False
        nodes = [int(node) for part in leaf_arrays(new) for node in part.ravel()]
        return all(self.context.constant(node) is not None for node in nodes)


def _asks(condition: m.Expression, names: list[str]) -> bool:
    """Whether a condition holds where one of these variables is empty, whatever else it says."""
    match condition:
        case m.Call(m.Name("isempty"), (m.Name(name),)):
            return name in names
        case m.Binary("||" | "|", left, right):
            return _asks(left, names) or _asks(right, names)
    return False


def initial_persistents(
    scout: FirstCallObserver, kept: dict[Key, SymbolicValue], questions: int
) -> dict[Key, PersistentVariable]:
    """What is known of persistent variables after the first call; `questions` is how often isempty was asked of one."""
    plain = questions == scout.asked
    return {
        key: _memory(key, held, scout.starts.get(key) if plain else None)
        for key, held in kept.items()
        if key[0] != GLOBAL and not unset(scout.context, held)
    }


def late_persistents(
    context: EvaluationContext, kept: Mapping[Key, SymbolicValue], known: Mapping[Key, PersistentVariable]
) -> dict[Key, PersistentVariable]:
    """Persistent variables that only a later call gives values to."""
    found = {key: held for key, held in kept.items() if key not in known and key[0] != GLOBAL}
    made = {key: _memory(key, held, None) for key, held in found.items() if not unset(context, held)}
    return {key: replace(one, always=False) for key, one in made.items()}


def unset(context: EvaluationContext, held: SymbolicValue | None) -> bool:
    """Whether a variable has no value for certain."""
    return isinstance(held, ConditionalValue) and context.builder.value(held.defined) == 0.0


def _memory(key: Key, held: SymbolicValue, start: SymbolicValue | None) -> PersistentVariable:
    value = held.value if isinstance(held, ConditionalValue) else held
    if isinstance(value, InvalidValue):
        raise ProgramError(value.why, value.remedy)
    if start is not None and _sizes(start) != _sizes(value):
        raise ProgramError(f"the size of the persistent variable {key[1]} changes", "Give it its full size at first.")
    return PersistentVariable(value, start, not isinstance(held, ConditionalValue))


def _sizes(held: SymbolicValue) -> list[tuple[int, ...]]:
    return [part.shape for part in leaf_arrays(held)]


class PersistentVariables:
    """The persistent variables of a block as a call finds them; `remember` makes a memory of what a call leaves."""

    def __init__(self, context: EvaluationContext, remember: Remember) -> None:
        self.context, self.remember = context, remember
        self._called: int | None = None

    def begun(self, memory: PersistentVariable, end: Callable[[], SymbolicValue | None]) -> SymbolicValue:
        """A variable as a call finds it; `end` is what the call leaves."""
        first = memory.last if memory.start is None else memory.start
        zero = self.context.builder.const(0.0)
        arrays = [
            self.remember(
                np.full(part.shape, zero, dtype=np.int64) if memory.start is None else np.asarray(part),
                partial(_left, memory, end, at),
            )
            for at, part in enumerate(leaf_arrays(first))
        ]
        read = with_leaf_arrays(memory.last, iter(arrays))
        return read if memory.start is not None else ConditionalValue(read, self._has_value(memory, end))

    def _has_value(self, memory: PersistentVariable, end: Callable[[], SymbolicValue | None]) -> int:
        """The node that says whether a variable has a value; one for all that the first call gives values to."""
        builder = self.context.builder

        def has_value() -> Nodes:
            held = end()
            defined = held.defined if isinstance(held, ConditionalValue) and not memory.always else builder.const(1.0)
            return np.array([[defined]], dtype=np.int64)

        if memory.always and self._called is not None:
            return self._called
        made = int(self.remember(np.array([[builder.const(0.0)]], dtype=np.int64), has_value).item())
        if memory.always:
            self._called = made
        return made


def _left(memory: PersistentVariable, end: Callable[[], SymbolicValue | None], at: int) -> Nodes:
    """One array of what a call leaves."""
    held = end()
    value = held.value if isinstance(held, ConditionalValue) else held
    if value is None or _sizes(value) != _sizes(memory.last):
        raise ProgramError("the size of a persistent variable changes", "Give it its full size at first.")
    return list(leaf_arrays(value))[at]
