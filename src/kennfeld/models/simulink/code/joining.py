"""The variables after a decision: each takes the side whose condition holds."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.code.conditions import assumed, both, either, known, negated
from kennfeld.models.simulink.code.values import (
    Cells,
    Handle,
    Held,
    Later,
    Partial,
    Struct,
    Truths,
    Unclear,
    integers,
    resolved,
    truths,
    word_of,
)
from kennfeld.models.simulink.expressions.arrays import each
from kennfeld.models.simulink.expressions.signals import Nodes

__all__ = ["State", "joined"]

Key = TypeVar("Key")
_SPLIT = "Give it the same form on both sides of the decision."


@dataclass(frozen=True)
class State:
    """Everything that code has done along one path: variables, persistent ones by their functions, and jumps.

    `jumps` are the conditions under which a break, continue or return was met; `facts` are the conditions that are
    known on this path.
    """

    names: dict[str, Held] = field(default_factory=dict)
    kept: dict[tuple[str, str], Held] = field(default_factory=dict)
    jumps: dict[str, int] = field(default_factory=dict)
    facts: Mapping[int, bool] = field(default_factory=dict)

    def under(self, loom: Loom, condition: int, holds: bool) -> "State":
        """The same, ready to be changed, on the side of a decision."""
        facts = assumed(loom, self.facts, condition, holds)
        return State(dict(self.names), dict(self.kept), dict(self.jumps), facts)


def joined(loom: Loom, condition: int, yes: State, no: State, before: State) -> State:
    """What code has done after a decision."""
    work = _Joining(loom, condition, yes.facts, no.facts)
    jumps = {kind: work.jump(yes.jumps.get(kind), no.jumps.get(kind)) for kind in {**yes.jumps, **no.jumps}}
    return replace(before, names=work.mapping(yes.names, no.names), kept=work.mapping(yes.kept, no.kept), jumps=jumps)


class _Joining:
    def __init__(self, loom: Loom, condition: int, yes: Mapping[int, bool], no: Mapping[int, bool]) -> None:
        self.loom, self.condition = loom, condition
        self.yes, self.no = yes, no
        self.choice = np.array([[condition]], dtype=np.int64)

    def jump(self, yes: int | None, no: int | None) -> int:
        loom, never = self.loom, self.loom.const(0.0)
        one = both(loom, self.condition, never if yes is None else yes)
        other = both(loom, negated(loom, self.condition), never if no is None else no)
        return either(loom, one, other)

    def mapping(self, yes: Mapping[Key, Held], no: Mapping[Key, Held]) -> dict[Key, Held]:
        return {key: self.held(str(key), yes.get(key), no.get(key)) for key in {**no, **yes}}

    def held(self, name: str, yes: Held | None, no: Held | None) -> Held:
        if yes is no and yes is not None:
            return yes
        yes, no = self._whole(yes, self.yes), self._whole(no, self.no)
        if yes is None or no is None or isinstance(yes, Partial) or isinstance(no, Partial):
            return self._partial(name, yes, no)
        if isinstance(yes, Unclear) or isinstance(no, Unclear):
            return yes if isinstance(yes, Unclear) else no
        return self._both(name, yes, no)

    def _whole(self, held: Held | None, facts: Mapping[int, bool]) -> Held | None:
        if isinstance(held, Later):
            return resolved(held)
        if isinstance(held, Partial):
            found = known(self.loom, facts, held.defined)
            return held if found is None else held.value if found else None
        return held

    def _partial(self, name: str, yes: Held | None, no: Held | None) -> Held:
        """A variable that only one side knows for certain."""
        values = [one.value if isinstance(one, Partial) else one for one in (yes, no)]
        if values[0] is None or values[1] is None:
            value = values[0] if values[0] is not None else values[1]
            if value is None:
                return Unclear(f"{name} has no value")
        else:
            value = self.held(name, *values)
        return value if isinstance(value, Unclear) else Partial(value, self.jump(self._defined(yes), self._defined(no)))

    def _defined(self, held: Held | None) -> int:
        return held.defined if isinstance(held, Partial) else self.loom.const(float(held is not None))

    def _both(self, name: str, yes: Held, no: Held) -> Held:
        match yes, no:
            case np.ndarray(), np.ndarray():
                return self._arrays(name, yes, no)
            case Struct(), Struct() if set(yes.fields) == set(no.fields):
                return Struct({key: self.held(f"{name}.{key}", yes.fields[key], no.fields[key]) for key in yes.fields})
            case Cells(), Cells() if yes.shape == no.shape:
                pairs = zip(yes.cells, no.cells, strict=True)
                return Cells(tuple(self.held(name, *pair) for pair in pairs), yes.shape)
            case str(), str() if yes == no:
                return yes
            case Handle(), Handle() if yes.function == no.function and not (yes.names or no.names):
                return yes
        return Unclear(f"{name} is of one kind where a condition holds and of another where it does not", _SPLIT)

    def _arrays(self, name: str, yes: Nodes, no: Nodes) -> Held:
        if yes.shape != no.shape:
            sizes = " or ".join("x".join(map(str, one.shape)) for one in (yes, no))
            return Unclear(f"the size of {name} is {sizes}, as a condition decides", _SPLIT)
        made = yes if np.array_equal(yes, no) else each(self.loom, "select", self.choice, yes, no)
        if isinstance(yes, Truths) and isinstance(no, Truths):
            return truths(made)
        return integers(made, word_of(yes) if word_of(yes) == word_of(no) else None)
