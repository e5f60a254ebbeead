"""Conditions under which parts of a chart run, and what is known where they hold.

A guard is a node that is true where its part runs. What it knows besides, that other nodes are true, false or have one
value, prunes parts that cannot run, and finds the values of variables that are fixed on one way through a chart.

The variables of a chart while one step of it is followed.

Where code of a chart runs, which decides what its names and events mean.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.operations import OPERATIONS
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.stateflow.chart_model import StateNode

__all__ = ["ActionContext", "Guard", "GuardLogic", "GuardedVariables", "SizeChangedError"]

_MOST_LOOKED_AT = 400  # nodes, to find out whether one is known
_TURNED = {"lt": "gt", "gt": "lt", "le": "ge", "ge": "le"}
_COMPARED = frozenset({"eq", "ne", "lt", "le", "gt", "ge"})

Clause: TypeAlias = tuple[tuple[int, ...], bool]


@dataclass(eq=False)
class Guard:
    """A node that says where a part runs; `facts` are nodes known there as true or false, `values` as constants.

    Each of `clauses` are nodes of which not all are true, or with False not all are false. `ranges` are the limits of
    numbers that comparisons have told, these limits included.
    """

    node: int
    facts: dict[int, bool] = field(default_factory=dict)
    values: dict[int, int] = field(default_factory=dict)
    ranges: dict[int, tuple[float, float]] = field(default_factory=dict)
    clauses: list[Clause] = field(default_factory=list)
    unknown: set[int] = field(default_factory=set)


class GuardLogic:
    """Makes guards, and simplifies nodes by what they know."""

    def __init__(self, builder: GraphBuilder) -> None:
        self.builder = builder
        self._left = 0

    @property
    def always(self) -> Guard:
        """The guard of what runs in every step."""
        return Guard(self.builder.const(1.0))

    # what is known

    def truth(self, node: int, guard: Guard) -> bool | None:
        """Whether a node is true wherever a guard holds, false there, or neither (None)."""
        self._left = _MOST_LOOKED_AT
        return self._truth(node, guard)

    def simple(self, node: int, guard: Guard) -> int:
        """The node that has the same value wherever a guard holds, without decisions that are made there."""
        self._left = _MOST_LOOKED_AT
        return self._simple(node, guard)

    def simplified(self, nodes: Nodes, guard: Guard) -> Nodes:
        """An array of nodes, each of them simplified."""
        made = [self.simple(int(node), guard) for node in nodes.ravel()]
        return np.array(made, dtype=np.int64).reshape(nodes.shape)

    def _truth(self, node: int, guard: Guard) -> bool | None:
        op, args, payload = self.builder.nodes[node]
        if op == "const":
            return bool(payload)
        if node in guard.facts:
            return guard.facts[node]
        if node in guard.unknown or self._left <= 0:
            return None
        self._left -= 1
        found = self._found(op, args, node, guard)
        if found is None:
            guard.unknown.add(node)
        else:
            guard.facts[node] = found
        return found

    def _found(self, op: str, args: tuple[int, ...], node: int, guard: Guard) -> bool | None:
        if op == "not":
            inner = self._truth(args[0], guard)
            return None if inner is None else not inner
        if op in ("and", "or"):
            parts = [self._truth(arg, guard) for arg in args]
            decisive = op == "or"
            return decisive if decisive in parts else None if None in parts else not decisive
        if op in _COMPARED:
            return self._compared(op, args, guard)
        simple = self._simple(node, guard)
        return None if simple == node else self._truth(simple, guard)

    def _compared(self, op: str, args: tuple[int, ...], guard: Guard) -> bool | None:
        simple = tuple(self._simple(arg, guard) for arg in args)
        numbers = [self.builder.value(arg) for arg in simple]
        if None not in numbers:
            return bool(OPERATIONS[op].evaluate(*numbers))
        node, op, number = self._against(op, simple)
        if node not in guard.ranges or number is None:
            return None
        low, high = guard.ranges[node]
        if op in ("gt", "ge"):
            return True if low > number else False if high < number or (op == "gt" and high == number) else None
        if op in ("lt", "le"):
            return True if high < number else False if low > number or (op == "lt" and low == number) else None
        return op == "ne" if not low <= number <= high else None

    def _against(self, op: str, args: tuple[int, ...]) -> tuple[int, str, float | None]:
        """A comparison with the number on the right."""
        left = self.builder.value(args[0])
        return (args[0], op, self.builder.value(args[1])) if left is None else (args[1], _TURNED.get(op, op), left)

    def _simple(self, node: int, guard: Guard) -> int:
        while node not in guard.values:
            op, args, _ = self.builder.nodes[node]
            known = self._truth(args[0], guard) if op == "select" else None
            if known is None:
                return node
            node = args[1] if known else args[2]
        return guard.values[node]

    # guards

    def where(self, guard: Guard, condition: int, holds: bool = True) -> Guard | None:
        """The guard where a condition holds as well, or with `holds` false does not; None where that is nowhere."""
        known = self.truth(condition, guard)
        if known is not None:
            return guard if known == holds else None
        wanted = condition if holds else self.builder.call("not", condition)
        node = wanted if self.builder.value(guard.node) else self.builder.call("and", guard.node, wanted)
        made = Guard(node, dict(guard.facts), dict(guard.values), dict(guard.ranges), list(guard.clauses))
        self._learn(condition, holds, made)
        if not self._concluded(made):
            return None
        made.facts[node] = True
        return made

    def _learn(self, condition: int, holds: bool, guard: Guard) -> None:
        """Note a condition, and what follows for what it is made of."""
        waiting = [(condition, holds)]
        while waiting:
            node, truth = waiting.pop()
            if guard.facts.get(node) == truth:
                continue
            guard.facts[node] = truth
            op, args, _ = self.builder.nodes[node]
            if op == "not":
                waiting.append((args[0], not truth))
            elif op == ("and" if truth else "or"):
                waiting += [(arg, truth) for arg in args]
            elif op in ("and", "or"):
                guard.clauses.append((args, not truth))
            elif truth and op in _TURNED:
                self._limit(op, args, guard)
            elif op == ("eq" if truth else "ne"):
                waiting += self._equal(args, guard)

    def _limit(self, op: str, args: tuple[int, ...], guard: Guard) -> None:
        """Note a limit; one that is not kept tells nothing, since what is no number keeps none."""
        node, op, number = self._against(op, args)
        if number is not None:
            low, high = guard.ranges.get(node, (-math.inf, math.inf))
            guard.ranges[node] = (max(low, number), high) if op in ("gt", "ge") else (low, min(high, number))

    def _equal(self, args: tuple[int, ...], guard: Guard) -> list[tuple[int, bool]]:
        """Note the value of a memory, and the decisions that follow; what is no memory stays, so its derivatives do."""
        follows: list[tuple[int, bool]] = []
        for one, other in (args, args[::-1]):
            number, node = self.builder.value(other), one
            while number is not None and self.builder.nodes[node].op in ("state", "select"):
                guard.values[node] = other
                op, parts, _ = self.builder.nodes[node]
                sides = [self.builder.value(part) for part in parts[1:]] if op == "select" else []
                wrong = next((at for at, side in enumerate(sides) if side is not None and side != number), None)
                if wrong is None:
                    break
                follows.append((parts[0], bool(wrong)))
                node = parts[2 - wrong]
        return follows

    def _concluded(self, guard: Guard) -> bool:
        """Draw conclusions from the clauses; whether they can all hold."""
        while self._followed(guard):
            clause, last = next(self._pressing(guard), (None, None))
            if clause is None:
                return True
            if last is None:
                return False
            guard.clauses = [one for one in guard.clauses if one is not clause]
            guard.unknown.clear()
            self._learn(last, not clause[1], guard)
        return False

    def _pressing(self, guard: Guard) -> Iterator[tuple[Clause, int | None]]:
        """The clauses that one node alone can keep, with that node; those that none can keep, with None."""
        for clause in guard.clauses:
            args, truth = clause
            self._left = _MOST_LOOKED_AT
            known = [self._truth(arg, guard) for arg in args]
            if (not truth) not in known and known.count(None) < 2:
                yield clause, args[known.index(None)] if None in known else None

    def _followed(self, guard: Guard) -> bool:
        """Hand values on to the sides of decisions that are known by now; whether that fits."""
        waiting = list(guard.values.items())
        while waiting:
            node, value = waiting.pop()
            op, args, _ = self.builder.nodes[node]
            self._left = _MOST_LOOKED_AT
            known = self._truth(args[0], guard) if op == "select" else None
            if known is None:
                continue
            side = args[1] if known else args[2]
            number = self.builder.value(side)
            if number is not None and number != self.builder.value(value):
                return False
            if side not in guard.values and self.builder.nodes[side].op in ("state", "select"):
                for condition, holds in self._equal((side, value), guard):
                    self._learn(condition, holds, guard)
                waiting = list(guard.values.items())
        return True

    def besides(self, guard: Guard, taken: Guard | None) -> Guard | None:
        """The guard where another one, which is part of it, does not hold."""
        if taken is None:
            return guard
        return None if taken.node == guard.node else self.where(guard, taken.node, holds=False)

    def either(self, guards: Sequence[Guard | None]) -> Guard | None:
        """The guard where any of several holds; it knows what all of them know."""
        given = [guard for guard in guards if guard is not None]
        if len(given) < 2:
            return given[0] if given else None
        node = given[0].node
        for one in given[1:]:
            node = self.builder.call("or", node, one.node)
        first, *rest = given
        facts = {k: v for k, v in first.facts.items() if all(one.facts.get(k) == v for one in rest)}
        values = {k: v for k, v in first.values.items() if all(one.values.get(k) == v for one in rest)}
        clauses = [one for one in first.clauses if all(one in other.clauses for other in rest)]
        ranges = {k: v for k, v in first.ranges.items() if all(one.ranges.get(k) == v for one in rest)}
        return Guard(node, {**facts, node: True}, values, ranges, clauses)

    def chosen(self, guard: Guard, new: Nodes, old: Nodes) -> Nodes:
        """What a variable holds after it has been given a new value where a guard holds."""
        pairs = zip(new.ravel(), old.ravel(), strict=True)
        made = [self._chosen(guard, int(one), int(other)) for one, other in pairs]
        return np.array(made, dtype=np.int64).reshape(new.shape)

    def _chosen(self, guard: Guard, new: int, old: int) -> int:
        op, args, _ = self.builder.nodes[old]
        while op == "select" and args[0] == guard.node:
            old = args[2]
            op, args, _ = self.builder.nodes[old]
        return new if new == old else self.builder.call("select", guard.node, new, old)


class SizeChangedError(Exception):
    """A variable turned out to have another size than was thought."""

    def __init__(self, key: str, shape: tuple[int, ...]) -> None:
        super().__init__(key)
        self.key, self.shape = key, shape


class GuardedVariables:
    """What each variable holds so far, by its key: nodes in the shape of the variable, Int[rows, columns].

    `sized` are the keys whose sizes the chart states.
    """

    def __init__(self, logic: GuardLogic, values: Mapping[str, Nodes], sized: frozenset[str] = frozenset()) -> None:
        self.logic = logic
        self.values = dict(values)
        self.sized = sized

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def get(self, key: str, guard: Guard) -> Nodes:
        """What a variable holds where a guard holds."""
        return self.logic.simplified(self.values[key], guard)

    def one(self, key: str, guard: Guard) -> int:
        """The node of a variable that is a scalar."""
        return self.logic.simple(int(self.values[key].ravel()[0]), guard)

    def set(self, key: str, new: Nodes, guard: Guard) -> None:
        """Give a variable a value where a guard holds; a scalar fills an array, a new one is no number elsewhere."""
        old = self.values.get(key)
        if old is None:
            old = np.full(new.shape, self.logic.builder.const(math.nan), dtype=np.int64)
        if new.shape != old.shape:
            new = self._fitted(key, new, old.shape)
        self.values[key] = self.logic.chosen(guard, new, old)

    def _fitted(self, key: str, new: Nodes, shape: tuple[int, ...]) -> Nodes:
        if new.size == 1:
            return np.full(shape, new.ravel()[0], dtype=np.int64)
        if new.size == np.prod(shape) and 1 in new.shape and 1 in shape:
            return new.reshape(shape)
        if key in self.sized:
            sizes = " and ".join("x".join(map(str, one)) for one in (shape, new.shape))
            raise UnsupportedError(f"its variable {key} has the sizes {sizes}")
        raise SizeChangedError(key, new.shape)

    def put(self, key: str, node: int, guard: Guard) -> None:
        """Give a scalar a value where a guard holds."""
        self.set(key, np.array([[node]], dtype=np.int64), guard)

    def joined(
        self, before: Mapping[str, Nodes], ways: Sequence[tuple[Guard, Mapping[str, Nodes]]]
    ) -> dict[str, Nodes]:
        """The values after ways that exclude each other, each with the guard where it is taken."""
        made = dict(before)
        for guard, after in ways:
            for key, nodes in after.items():
                old = before.get(key)
                if old is None:
                    made[key] = nodes
                elif nodes is not old:
                    made[key] = self.logic.chosen(guard, self.logic.simplified(nodes, guard), made[key])
        return made


@dataclass(frozen=True)
class ActionContext:
    """Where code runs: names are sought from `scope`, timers are those of `owner`, `event` is what is processed.

    `event` is the key of an event, empty where the chart merely wakes up. `frame` is that of a function that runs.
    `alive` gives the guard where the code goes on after an event that it has sent.
    """

    scope: StateNode
    owner: StateNode
    event: str = ""
    frame: str = ""
    alive: Callable[[Guard], Guard | None] = lambda guard: guard
    place: str = ""

    def at(self, place: str) -> "ActionContext":
        """The same for code of another place."""
        return replace(self, place=place)
