"""Guards, the conditions under which parts of a chart run, and variables assigned under them.

A guard is a node that is true where its part runs. It also stores facts that follow from it: nodes that are true, false
or constant there. They prune parts that cannot run, and reveal variables that are constant on one path.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import TypeAlias

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.operations import OPERATIONS
from kennfeld.importers.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.importers.simulink.stateflow.chart_model import StateNode
from kennfeld.models.imperative.node_arrays import Nodes

_MAX_VISITED = 400  # nodes per query of a truth value
_TURNED = {"lt": "gt", "gt": "lt", "le": "ge", "ge": "le"}
_COMPARED = frozenset({"eq", "ne", "lt", "le", "gt", "ge"})

Clause: TypeAlias = tuple[tuple[int, ...], bool]


@dataclass(eq=False)
class Guard:
    """A node that is true where a part runs; `facts` are nodes of known truth there, `values` of known value.

    Each of `clauses` is a group of nodes that are not all true, or with False not all false. `ranges` are closed bounds
    from comparisons.
    """

    node: int
    facts: dict[int, bool] = field(default_factory=dict)
    values: dict[int, int] = field(default_factory=dict)
    ranges: dict[int, tuple[float, float]] = field(default_factory=dict)
    clauses: list[Clause] = field(default_factory=list)
    unknown: set[int] = field(default_factory=set)


class GuardLogic:
    """Derives guards, and simplifies nodes by their facts."""

    def __init__(self, builder: GraphBuilder) -> None:
        self.builder = builder
        self._left = 0

    @property
    def always(self) -> Guard:
        """The guard of parts that run in every step."""
        return Guard(self.builder.const(1.0))

    # what is known

    def truth(self, node: int, guard: Guard) -> bool | None:
        """Return True or False if a node is so wherever a guard holds, else None."""
        self._left = _MAX_VISITED
        return self._truth(node, guard)

    def simplify(self, node: int, guard: Guard) -> int:
        """Return a node of equal value wherever a guard holds, without decisions known there."""
        self._left = _MAX_VISITED
        return self._simplify(node, guard)

    def simplify_all(self, nodes: Nodes, guard: Guard) -> Nodes:
        """Simplify each of an array of nodes."""
        simplified = [self.simplify(int(node), guard) for node in nodes.ravel()]
        return np.array(simplified, dtype=np.int64).reshape(nodes.shape)

    def _truth(self, node: int, guard: Guard) -> bool | None:
        op, args, payload = self.builder.nodes[node]
        if op == "const":
            return bool(payload)
        if node in guard.facts:
            return guard.facts[node]
        # limited, as a query may visit each path of decisions
        if node in guard.unknown or self._left <= 0:
            return None
        self._left -= 1
        truth = self._evaluate_truth(op, args, node, guard)
        if truth is None:
            guard.unknown.add(node)
        else:
            guard.facts[node] = truth
        return truth

    def _evaluate_truth(self, op: str, args: tuple[int, ...], node: int, guard: Guard) -> bool | None:
        if op == "not":
            inner = self._truth(args[0], guard)
            return None if inner is None else not inner
        if op in ("and", "or"):
            parts = [self._truth(arg, guard) for arg in args]
            decisive = op == "or"
            return decisive if decisive in parts else None if None in parts else not decisive
        if op in _COMPARED:
            return self._compare(op, args, guard)
        simple = self._simplify(node, guard)
        return None if simple == node else self._truth(simple, guard)

    def _compare(self, op: str, args: tuple[int, ...], guard: Guard) -> bool | None:
        simple = tuple(self._simplify(arg, guard) for arg in args)
        numbers = [self.builder.value(arg) for arg in simple]
        if None not in numbers:
            return bool(OPERATIONS[op].evaluate(*numbers))
        node, op, number = self._normalize(op, simple)
        if node not in guard.ranges or number is None:
            return None
        # bounds are closed, also those of strict comparisons
        low, high = guard.ranges[node]
        if op in ("gt", "ge"):
            return True if low > number else False if high < number or (op == "gt" and high == number) else None
        if op in ("lt", "le"):
            return True if high < number else False if low > number or (op == "lt" and low == number) else None
        return op == "ne" if not low <= number <= high else None

    def _normalize(self, op: str, args: tuple[int, ...]) -> tuple[int, str, float | None]:
        """Return a comparison with the number on the right."""
        left = self.builder.value(args[0])
        return (args[0], op, self.builder.value(args[1])) if left is None else (args[1], _TURNED.get(op, op), left)

    def _simplify(self, node: int, guard: Guard) -> int:
        while node not in guard.values:
            op, args, _ = self.builder.nodes[node]
            known = self._truth(args[0], guard) if op == "select" else None
            if known is None:
                return node
            node = args[1] if known else args[2]
        return guard.values[node]

    # guards

    def narrow(self, guard: Guard, condition: int, holds: bool = True) -> Guard | None:
        """Narrow a guard to where a condition holds, or does not if not `holds`; None if nowhere."""
        known = self.truth(condition, guard)
        if known is not None:
            return guard if known == holds else None
        wanted = condition if holds else self.builder.call("not", condition)
        node = wanted if self.builder.value(guard.node) else self.builder.call("and", guard.node, wanted)
        # without `unknown`, which the condition may decide
        narrowed = Guard(node, dict(guard.facts), dict(guard.values), dict(guard.ranges), list(guard.clauses))
        self._learn(condition, holds, narrowed)
        if not self._propagate_clauses(narrowed):
            return None
        narrowed.facts[node] = True
        return narrowed

    def _learn(self, condition: int, holds: bool, guard: Guard) -> None:
        """Record a condition and its consequences for its operands."""
        waiting = [(condition, holds)]
        while waiting:
            node, truth = waiting.pop()
            if guard.facts.get(node) == truth:
                continue
            guard.facts[node] = truth
            op, args, _ = self.builder.nodes[node]
            if op == "not":
                waiting.append((args[0], not truth))
            # a true `and` has true operands, a false `or` false ones; else the operands are only known not to be all so
            elif op == ("and" if truth else "or"):
                waiting += [(arg, truth) for arg in args]
            elif op in ("and", "or"):
                guard.clauses.append((args, not truth))
            elif truth and op in _TURNED:
                self._limit(op, args, guard)
            elif op == ("eq" if truth else "ne"):
                waiting += self._learn_value(args, guard)

    def _limit(self, op: str, args: tuple[int, ...], guard: Guard) -> None:
        """Record a bound; a violated one implies nothing, since NaN violates all."""
        node, op, number = self._normalize(op, args)
        if number is not None:
            low, high = guard.ranges.get(node, (-math.inf, math.inf))
            guard.ranges[node] = (max(low, number), high) if op in ("gt", "ge") else (low, min(high, number))

    def _learn_value(self, args: tuple[int, ...], guard: Guard) -> list[tuple[int, bool]]:
        """Record the value of a memory and implied decisions; other nodes stay, to keep their derivatives."""
        follows: list[tuple[int, bool]] = []
        # the number may be on either side
        for item, constant in (args, args[::-1]):
            number, node = self.builder.value(constant), item
            while number is not None and self.builder.nodes[node].op in ("state", "select"):
                guard.values[node] = constant
                op, parts, _ = self.builder.nodes[node]
                # a selection that has the number did not take a side with another constant, which decides its condition
                sides = [self.builder.value(part) for part in parts[1:]] if op == "select" else []
                wrong = next((at for at, side in enumerate(sides) if side is not None and side != number), None)
                if wrong is None:
                    break
                follows.append((parts[0], bool(wrong)))
                node = parts[2 - wrong]
        return follows

    def _propagate_clauses(self, guard: Guard) -> bool:
        """Draw conclusions from the clauses; return False on a contradiction."""
        # unit propagation (Davis, Logemann and Loveland, Comm. ACM 5 (1962) 394)
        while self._propagate_values(guard):
            clause, last = next(self._unit_clauses(guard), (None, None))
            if clause is None:
                return True
            if last is None:
                return False
            guard.clauses = [other for other in guard.clauses if other is not clause]
            # may follow from what is learned
            guard.unknown.clear()
            self._learn(last, not clause[1], guard)
        return False

    def _unit_clauses(self, guard: Guard) -> Iterator[tuple[Clause, int | None]]:
        """Yield the clauses that only one node can satisfy, with that node; None if no node can."""
        for clause in guard.clauses:
            args, truth = clause
            self._left = _MAX_VISITED
            known = [self._truth(arg, guard) for arg in args]
            # one node of the other truth satisfies a clause
            if (not truth) not in known and known.count(None) < 2:
                yield clause, args[known.index(None)] if None in known else None

    def _propagate_values(self, guard: Guard) -> bool:
        """Propagate values into decided branches; return False on a contradiction."""
        waiting = list(guard.values.items())
        while waiting:
            node, value = waiting.pop()
            op, args, _ = self.builder.nodes[node]
            self._left = _MAX_VISITED
            known = self._truth(args[0], guard) if op == "select" else None
            if known is None:
                continue
            side = args[1] if known else args[2]
            number = self.builder.value(side)
            # two different constants: no run gets here
            if number is not None and number != self.builder.value(value):
                return False
            if side not in guard.values and self.builder.nodes[side].op in ("state", "select"):
                for condition, holds in self._learn_value((side, value), guard):
                    self._learn(condition, holds, guard)
                waiting = list(guard.values.items())
        return True

    def exclude(self, guard: Guard, taken: Guard | None) -> Guard | None:
        """Return the part of a guard where `taken`, a part of it, does not hold."""
        if taken is None:
            return guard
        return None if taken.node == guard.node else self.narrow(guard, taken.node, holds=False)

    def any_of(self, guards: Sequence[Guard | None]) -> Guard | None:
        """Join guards to one that holds where any of them does, with their common facts."""
        known = [guard for guard in guards if guard is not None]
        if len(known) < 2:
            return known[0] if known else None
        node = known[0].node
        for item in known[1:]:
            node = self.builder.call("or", node, item.node)
        first, *rest = known
        # where paths meet, only what all of them agree on is certain
        facts = {k: v for k, v in first.facts.items() if all(item.facts.get(k) == v for item in rest)}
        values = {k: v for k, v in first.values.items() if all(item.values.get(k) == v for item in rest)}
        clauses = [item for item in first.clauses if all(item in other.clauses for other in rest)]
        ranges = {k: v for k, v in first.ranges.items() if all(item.ranges.get(k) == v for item in rest)}
        return Guard(node, {**facts, node: True}, values, ranges, clauses)

    def select(self, guard: Guard, new: Nodes, old: Nodes) -> Nodes:
        """Return the value of a variable after an assignment under a guard; all are Int[rows, columns]."""
        pairs = zip(new.ravel(), old.ravel(), strict=True)
        selected = [self._select(guard, int(new_node), int(old_node)) for new_node, old_node in pairs]
        return np.array(selected, dtype=np.int64).reshape(new.shape)

    def _select(self, guard: Guard, new: int, old: int) -> int:
        op, args, _ = self.builder.nodes[old]
        # an assignment under the same guard replaces the one before, which is visible nowhere
        while op == "select" and args[0] == guard.node:
            old = args[2]
            op, args, _ = self.builder.nodes[old]
        return new if new == old else self.builder.call("select", guard.node, new, old)


class SizeChangedError(Exception):
    """A variable has another size than assumed."""

    def __init__(self, key: str, shape: tuple[int, ...]) -> None:
        super().__init__(key)
        self.key, self.shape = key, shape


class GuardedVariables:
    """The current value of each variable by its key: nodes in its shape, Int[rows, columns].

    `sized` are the keys of variables with a stated size.
    """

    def __init__(self, logic: GuardLogic, values: Mapping[str, Nodes], sized: frozenset[str] = frozenset()) -> None:
        self.logic = logic
        self.values = dict(values)
        self.sized = sized

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def get(self, key: str, guard: Guard) -> Nodes:
        """Return the value of a variable where a guard holds."""
        return self.logic.simplify_all(self.values[key], guard)

    def scalar(self, key: str, guard: Guard) -> int:
        """Return the node of a scalar variable."""
        return self.logic.simplify(int(self.values[key].ravel()[0]), guard)

    def set(self, key: str, new: Nodes, guard: Guard) -> None:
        """Assign a variable where a guard holds; a scalar fills an array, a new variable is NaN elsewhere."""
        old = self.values.get(key)
        if old is None:
            old = np.full(new.shape, self.logic.builder.const(math.nan), dtype=np.int64)
        if new.shape != old.shape:
            new = self._fit(key, new, old.shape)
        self.values[key] = self.logic.select(guard, new, old)

    def _fit(self, key: str, new: Nodes, shape: tuple[int, ...]) -> Nodes:
        if new.size == 1:
            return np.full(shape, new.ravel()[0], dtype=np.int64)
        if new.size == np.prod(shape) and 1 in new.shape and 1 in shape:
            return new.reshape(shape)
        if key in self.sized:
            sizes = " and ".join("x".join(map(str, item)) for item in (shape, new.shape))
            raise UnsupportedError(f"variable {key} has the sizes {sizes}")
        raise SizeChangedError(key, new.shape)

    def put(self, key: str, node: int, guard: Guard) -> None:
        """Assign a scalar variable where a guard holds."""
        self.set(key, np.array([[node]], dtype=np.int64), guard)

    def joined(
        self, before: Mapping[str, Nodes], paths: Sequence[tuple[Guard, Mapping[str, Nodes]]]
    ) -> dict[str, Nodes]:
        """Merge the values of exclusive branches, each with its guard."""
        merged = dict(before)
        for guard, after in paths:
            for key, nodes in after.items():
                old = before.get(key)
                if old is None:
                    merged[key] = nodes
                elif nodes is not old:
                    merged[key] = self.logic.select(guard, self.logic.simplify_all(nodes, guard), merged[key])
        return merged


@dataclass(frozen=True)
class ActionContext:
    """The context of running code: `scope` resolves names, `owner` holds the timers.

    `event` is the key of the event being processed, empty at a mere wake-up; `frame` that of a running function.
    `alive` narrows a guard to where the code continues after sending an event.
    """

    scope: StateNode
    owner: StateNode
    event: str = ""
    frame: str = ""
    alive: Callable[[Guard], Guard | None] = lambda guard: guard
    place: str = ""

    def at(self, place: str) -> "ActionContext":
        """Return the context for code at another place."""
        return replace(self, place=place)
