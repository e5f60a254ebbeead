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
from kennfeld.models.imperative.control_flow import State
from kennfeld.models.imperative.evaluation_context import Desk
from kennfeld.models.imperative.evaluation_errors import CodeError
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.imperative.statement_interpreter import GLOBAL, Body
from kennfeld.models.imperative.symbolic_values import Held, Partial, Unclear, leaves, rebuilt

__all__ = ["Key", "Memories", "Memory", "Scout", "declares", "later", "memories"]

Key: TypeAlias = tuple[str, str]
Remember: TypeAlias = Callable[[Nodes, Callable[[], Nodes]], Nodes]


def declares(statements: object) -> bool:
    """Whether there are persistent variables in statements."""
    if isinstance(statements, m.Declaration):
        return statements.kind == "persistent"
    if isinstance(statements, tuple):
        return any(map(declares, statements))
    parts = ("body", "branches", "otherwise", "cases")
    return any(declares(getattr(statements, part)) for part in parts if hasattr(statements, part))


@dataclass(frozen=True, eq=False)
class Memory:
    """A persistent variable after the first call: its value, what it starts with if that is fixed.

    `always` says that the first call gives it a value for certain.
    """

    last: Held
    start: Held | None
    always: bool = True


@dataclass(eq=False)
class Scout:
    """Watches the first call for the decisions that give persistent variables their first values."""

    desk: Desk
    body: Body
    starts: dict[Key, Held] = field(default_factory=dict)
    asked: int = 0  # decisions on isempty that a start takes away

    def watch(self, whole: m.If, before: State, asked: int) -> None:
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

    def _is_start(self, name: str, before: State) -> bool:
        old, new = before.names.get(name), self.body.names[name]
        if not unset(self.desk, old) or isinstance(new, Partial | Unclear):
            return False
        nodes = [int(node) for part in leaves(new) for node in part.ravel()]
        return all(self.desk.constant(node) is not None for node in nodes)


def _asks(condition: m.Expression, names: list[str]) -> bool:
    """Whether a condition holds where one of these variables is empty, whatever else it says."""
    match condition:
        case m.Call(m.Name("isempty"), (m.Name(name),)):
            return name in names
        case m.Binary("||" | "|", left, right):
            return _asks(left, names) or _asks(right, names)
    return False


def memories(scout: Scout, kept: dict[Key, Held], questions: int) -> dict[Key, Memory]:
    """What is known of persistent variables after the first call; `questions` is how often isempty was asked of one."""
    plain = questions == scout.asked
    return {
        key: _memory(key, held, scout.starts.get(key) if plain else None)
        for key, held in kept.items()
        if key[0] != GLOBAL and not unset(scout.desk, held)
    }


def later(desk: Desk, kept: Mapping[Key, Held], known: Mapping[Key, Memory]) -> dict[Key, Memory]:
    """Persistent variables that only a later call gives values to."""
    found = {key: held for key, held in kept.items() if key not in known and key[0] != GLOBAL}
    made = {key: _memory(key, held, None) for key, held in found.items() if not unset(desk, held)}
    return {key: replace(one, always=False) for key, one in made.items()}


def unset(desk: Desk, held: Held | None) -> bool:
    """Whether a variable has no value for certain."""
    return isinstance(held, Partial) and desk.builder.value(held.defined) == 0.0


def _memory(key: Key, held: Held, start: Held | None) -> Memory:
    value = held.value if isinstance(held, Partial) else held
    if isinstance(value, Unclear):
        raise CodeError(value.why, value.mend)
    if start is not None and _sizes(start) != _sizes(value):
        raise CodeError(f"the size of the persistent variable {key[1]} changes", "Give it its full size at first.")
    return Memory(value, start, not isinstance(held, Partial))


def _sizes(held: Held) -> list[tuple[int, ...]]:
    return [part.shape for part in leaves(held)]


class Memories:
    """The persistent variables of a block as a call finds them; `remember` makes a memory of what a call leaves."""

    def __init__(self, desk: Desk, remember: Remember) -> None:
        self.desk, self.remember = desk, remember
        self._called: int | None = None

    def begun(self, memory: Memory, end: Callable[[], Held | None]) -> Held:
        """A variable as a call finds it; `end` is what the call leaves."""
        first = memory.last if memory.start is None else memory.start
        zero = self.desk.builder.const(0.0)
        arrays = [
            self.remember(
                np.full(part.shape, zero, dtype=np.int64) if memory.start is None else np.asarray(part),
                partial(_left, memory, end, at),
            )
            for at, part in enumerate(leaves(first))
        ]
        read = rebuilt(memory.last, iter(arrays))
        return read if memory.start is not None else Partial(read, self._has_value(memory, end))

    def _has_value(self, memory: Memory, end: Callable[[], Held | None]) -> int:
        """The node that says whether a variable has a value; one for all that the first call gives values to."""
        builder = self.desk.builder

        def has_value() -> Nodes:
            held = end()
            defined = held.defined if isinstance(held, Partial) and not memory.always else builder.const(1.0)
            return np.array([[defined]], dtype=np.int64)

        if memory.always and self._called is not None:
            return self._called
        made = int(self.remember(np.array([[builder.const(0.0)]], dtype=np.int64), has_value).item())
        if memory.always:
            self._called = made
        return made


def _left(memory: Memory, end: Callable[[], Held | None], at: int) -> Nodes:
    """One array of what a call leaves."""
    held = end()
    value = held.value if isinstance(held, Partial) else held
    if value is None or _sizes(value) != _sizes(memory.last):
        raise CodeError("the size of a persistent variable changes", "Give it its full size at first.")
    return list(leaves(value))[at]
