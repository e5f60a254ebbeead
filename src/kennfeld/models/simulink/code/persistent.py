"""Variables that keep their values from one call of a function to the next.

The code is followed as in its very first call, to see what becomes of them. Where `if isempty(x) ... end` gives fixed
numbers or parameters, that is what the memory starts with, and the decision is gone. Else a second memory tells whether
x has a value already.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import TypeAlias

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.body import GLOBAL, Body
from kennfeld.models.simulink.code.desk import Desk
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.joining import State
from kennfeld.models.simulink.code.values import Held, Partial, Unclear, leaves, rebuilt
from kennfeld.models.simulink.signals import Nodes

__all__ = ["Key", "Memory", "Scout", "begun", "declares", "memories"]

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
    """A persistent variable after the first call: its value, what it starts with if that is fixed."""

    last: Held
    start: Held | None


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

    def unset(self, held: Held | None) -> bool:
        """Whether a variable has no value for certain."""
        return isinstance(held, Partial) and self.desk.loom.value(held.defined) == 0.0

    def _is_start(self, name: str, before: State) -> bool:
        old, new = before.names.get(name), self.body.names[name]
        if not self.unset(old) or isinstance(new, Partial | Unclear):
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
        if key[0] != GLOBAL and not scout.unset(held)
    }


def _memory(key: Key, held: Held, start: Held | None) -> Memory:
    value = held.value if isinstance(held, Partial) else held
    if isinstance(value, Unclear):
        raise CodeError(value.why, value.mend)
    if start is not None and _sizes(start) != _sizes(value):
        raise CodeError(f"the size of the persistent variable {key[1]} changes", "Give it its full size at first.")
    return Memory(value, start)


def _sizes(held: Held) -> list[tuple[int, ...]]:
    return [part.shape for part in leaves(held)]


def begun(desk: Desk, memory: Memory, remember: Remember, end: Callable[[], Held | None]) -> Held:
    """A persistent variable as a call finds it; `end` is what the call leaves."""
    loom, zero = desk.loom, desk.loom.const(0.0)
    first = memory.start if memory.start is not None else memory.last
    blank = memory.start is None

    def left() -> list[Nodes]:
        held = end()
        value = held.value if isinstance(held, Partial) else held
        if value is None or _sizes(value) != _sizes(memory.last):
            raise CodeError("the size of a persistent variable changes", "Give it its full size at first.")
        return list(leaves(value))

    def one(at: int) -> Nodes:
        return left()[at]

    arrays = [
        remember(np.full(part.shape, zero, dtype=np.int64) if blank else np.asarray(part), partial(one, at))
        for at, part in enumerate(leaves(first))
    ]
    read = rebuilt(memory.last, iter(arrays))
    if not blank:
        return read

    def has_value() -> Nodes:
        held = end()
        defined = held.defined if isinstance(held, Partial) else loom.const(1.0)
        return np.array([[defined]], dtype=np.int64)

    return Partial(read, int(remember(np.array([[zero]], dtype=np.int64), has_value).item()))
