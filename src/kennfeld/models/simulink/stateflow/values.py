"""Expressions of a chart's code where a guard holds: its variables, elements of arrays, operators of charts, calls.

What only charts know is taken out of an expression and put back as a name for its nodes; the rest is an expression over
graph nodes like any other.
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.errors import CodeError
from kennfeld.models.simulink.code.functions.bits import OF_BITS
from kennfeld.models.simulink.code.functions.registry import KEEPS_INTEGERS, matlab_word
from kennfeld.models.simulink.code.values import integers
from kennfeld.models.simulink.expressions.arrays import each, fold
from kennfeld.models.simulink.expressions.expressions import Expressions
from kennfeld.models.simulink.expressions.integer_types import Word
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.expressions.struct_parts import way_of
from kennfeld.models.simulink.stateflow.actions import changed, within
from kennfeld.models.simulink.stateflow.context import Context
from kennfeld.models.simulink.stateflow.diagram import Diagram, Event, State
from kennfeld.models.simulink.stateflow.elements import Elements
from kennfeld.models.simulink.stateflow.guards import Guard, Logic
from kennfeld.models.simulink.stateflow.library import is_of_library, results_of
from kennfeld.models.simulink.stateflow.timers import CHANGES, TEMPORAL
from kennfeld.models.simulink.stateflow.variables import Variables
from kennfeld.models.simulink.variables.scopes import Scope
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.execution import Machine

__all__ = ["Values"]

_FILLED = {"NaN": math.nan, "nan": math.nan, "Inf": math.inf, "inf": math.inf}


class Values:
    """Evaluates expressions for a machine."""

    def __init__(self, machine: "Machine", expressions: Expressions, scope: Scope) -> None:
        self.machine = machine
        self.expressions = expressions
        self.scope = scope
        self.loom = expressions.loom
        self.logic: Logic = machine.logic
        self.diagram: Diagram = machine.diagram
        self.variables: Variables = machine.variables
        self.elements = Elements(self)

    def nodes(self, tree: m.Expression, context: Context, guard: Guard) -> Nodes:
        """The nodes of an expression, Int[rows, columns]."""
        taken: dict[str, Nodes] = {}
        plain = self._plain(tree, context, guard, taken)
        try:
            return self.logic.simplified(self.expressions.computed(plain, self.scope, taken), guard)
        except NoValueError as error:
            raise UnsupportedError(f"{context.place}: {error}", "", error.undefined) from None
        except InputError as error:
            raise UnsupportedError(f"{context.place}: {error.findings[0]}") from None

    def one(self, tree: m.Expression, context: Context, guard: Guard) -> int:
        """The node of an expression that is a scalar; of an array as a condition, whether all its elements hold."""
        found = self.nodes(tree, context, guard)
        if found.size == 0:
            raise UnsupportedError(f"{context.place}: it decides by an empty array")
        return fold(self.loom, "and", [int(node) for node in found.ravel()])

    def given(self, arguments: tuple[m.Expression, ...], context: Context, guard: Guard) -> list[Nodes | None]:
        """The values that a function is given; None for texts, which can but be shown."""
        return [None if isinstance(one, m.Text) else self.nodes(one, context, guard) for one in arguments]

    def key(self, name: str, context: Context) -> str | None:
        """The variable that a name means."""
        if context.frame and (local := f"{context.frame}.{name}") in self.variables:
            return local
        data = self.diagram.datum(name, context.scope)
        if data is None or data.written.scope == "PARAMETER_DATA":
            return None
        return data.key if data.key in self.variables else None

    def key_of(self, tree: m.Expression, context: Context) -> str | None:
        """The variable that a name, or a way of names through states, means."""
        if isinstance(tree, m.Name):
            return self.key(tree.name, context)
        way = way_of(tree) if isinstance(tree, m.Field) else None
        state = self.diagram.state(way[:-1], context.scope) if way else None
        if way is None or state is None:
            return None
        data = self.diagram.data.get((state.id, way[-1]))
        return data.key if data is not None and data.key in self.variables else None

    # what only charts know

    def _plain(self, tree: m.Expression, context: Context, guard: Guard, taken: dict[str, Nodes]) -> m.Expression:
        """A tree in which names stand for what only charts know."""
        nodes = self._own(tree, context, guard)
        if nodes is not None:
            name = f"#{len(taken)}"
            taken[name] = nodes
            return m.Name(name, place=tree.place)
        called = tree.of if isinstance(tree, m.Call) else None  # a function, which is no variable
        return changed(tree, lambda one: one if one is called else self._plain(one, context, guard, taken))

    def _own(self, tree: m.Expression, context: Context, guard: Guard) -> Nodes | None:
        """The nodes of what only charts know; None for all else."""
        match tree:
            case m.Name() | m.Field():
                return self._named(tree, context, guard)
            case m.Binary(("&&" | "||") as operator, left, right) if self._may_fail(right, context):
                return self._decided(operator, left, right, context, guard)
            case m.Call(of, arguments):
                key = self.key_of(of, context)
                if key is not None:
                    return self.elements.get(key, arguments, context, guard)
                return self._called(of.name, arguments, context, guard) if isinstance(of, m.Name) else None
        return None

    def _named(self, tree: m.Expression, context: Context, guard: Guard) -> Nodes | None:
        key = self.key_of(tree, context)
        if key is not None:
            return self.variables.get(key, guard)
        if tree == m.Name("t") and self.diagram.chart.language == "C" and self.scope.find("t") is None:
            return self._array(self.machine.time)
        return None

    def _may_fail(self, tree: m.Expression, context: Context) -> bool:
        """Whether an expression calls a function of the chart or takes an element of an array."""
        return any(
            isinstance(one, m.Call)
            and isinstance(one.of, m.Name)
            and (self.diagram.function(one.of.name, context.scope) or self.key(one.of.name, context)) is not None
            for one in within(tree)
        )

    def _decided(
        self, operator: str, left: m.Expression, right: m.Expression, context: Context, guard: Guard
    ) -> Nodes | None:
        """An `and` or `or`, its right side only where the left side leaves it open."""
        first = self.one(left, context, guard)
        rest = self.logic.where(guard, first, holds=operator == "&&")
        decided = self.loom.const(0.0 if operator == "&&" else 1.0)
        if rest is None:
            return self._array(decided)
        second = self.one(right, context, rest)
        return self._array(self.loom.call("and" if operator == "&&" else "or", first, second))

    def _called(self, name: str, arguments: tuple[m.Expression, ...], context: Context, guard: Guard) -> Nodes | None:
        function = self.diagram.function(name, context.scope)
        if function is not None:
            given = self.given(arguments, context, guard)
            results, _ = self.machine.functions.call(function, given, context, guard)
            if not results:
                raise UnsupportedError(f"{context.place}: {name} gives no value")
            return self.logic.simplified(results[0], guard)
        if name in TEMPORAL:
            return self._array(self.machine.counting.temporal(name, arguments, context, guard))
        if name in CHANGES:
            return self._array(self._changed(name, arguments, context, guard))
        if name == "in" and len(arguments) == 1:
            return self._array(self.machine.activity.active(self.state(arguments[0], context), guard))
        if name == "cast" and len(arguments) == 2:
            return self.nodes(arguments[0], context, guard)
        if name == "isnan" and len(arguments) == 1:
            asked = self.nodes(arguments[0], context, guard)
            return each(self.loom, "ne", asked, asked)
        if name in _FILLED:
            return self._filled(name, arguments, context, guard)
        found = self.library(name, arguments, 1, context, guard)
        return found[0] if found else None

    def library(
        self, name: str, arguments: tuple[m.Expression, ...], wanted: int, context: Context, guard: Guard
    ) -> list[Nodes]:
        """The results of a function of MATLAB in a chart whose language that is; none of what is none of them."""
        if self.diagram.chart.language == "C" or not is_of_library(name):
            return []
        given = [one.value if isinstance(one, m.Text) else self._typed(one, context, guard) for one in arguments]
        try:
            return results_of(self.loom, name, given, wanted)
        except CodeError as error:
            raise UnsupportedError(f"{context.place}: {error.what}", error.mend) from None

    def _typed(self, tree: m.Expression, context: Context, guard: Guard) -> Nodes:
        """The nodes of an expression, with the integer type that its variables and casts say."""
        return integers(self.nodes(tree, context, guard), self._word(tree, context))

    def _word(self, tree: m.Expression, context: Context) -> Word | None:
        """The integer type of an expression, as the chart declares its variables."""
        match tree:
            case m.Name() | m.Field():
                return self._declared(tree, context)
            case m.Unary("-" | "+", operand):
                return self._word(operand, context)
            case m.Binary("+" | "-" | "*" | ".*" | "/" | "./" | "^" | ".^", left, right):
                return self._word(left, context) or self._word(right, context)
            case m.Call(of, arguments):
                declared = self._declared(of, context)
                name = of.name if isinstance(of, m.Name) else ""
                if declared is not None or self.key_of(of, context) is not None:
                    return declared
                if name == "cast" and len(arguments) == 2 and isinstance(arguments[1], m.Text):
                    return matlab_word(arguments[1].value)
                if name in KEEPS_INTEGERS or name in OF_BITS:
                    return next((word for one in arguments if (word := self._word(one, context)) is not None), None)
                return matlab_word(name)
        return None

    def _declared(self, tree: m.Expression, context: Context) -> Word | None:
        """The integer type that the chart declares for a variable."""
        key = self.key_of(tree, context)
        data = next((one for one in self.diagram.data.values() if one.key == key), None) if key is not None else None
        return matlab_word(data.written.type.strip()) if data is not None else None

    def _filled(self, name: str, arguments: tuple[m.Expression, ...], context: Context, guard: Guard) -> Nodes:
        """An array of a number that is none, or infinite; the name of a type behind its sizes is passed over."""
        sizes = m.Call(m.Name("zeros"), tuple(one for one in arguments if not isinstance(one, m.Text)))
        number = self.loom.const(_FILLED[name])
        return np.full(self.nodes(sizes, context, guard).shape, number, dtype=np.int64)

    def state(self, tree: m.Expression, context: Context) -> State:
        """The state that an expression names."""
        way = way_of(tree)
        state = self.diagram.state(way, context.scope) if way is not None else None
        if state is None:
            raise UnsupportedError(f"{context.place}: in asks for what is no state, or one of several")
        return state

    def _changed(self, name: str, arguments: tuple[m.Expression, ...], context: Context, guard: Guard) -> int:
        """Whether the value at the beginning of the step differs from that at the beginning of the step before."""
        tree, wanted = arguments[0], arguments[1:]
        base, indices = (tree.of, tree.arguments) if isinstance(tree, m.Call) else (tree, ())
        key = self.key_of(base, context)
        if key is None or len(wanted) != (name != "hasChanged"):
            raise UnsupportedError(f"{context.place}: {name} is used in a way that is not supported")
        after, before = (self._seen(f"{when} {key}", indices, context, guard) for when in ("now", "before"))
        changed = fold(self.loom, "or", [int(node) for node in each(self.loom, "ne", after, before).ravel()])
        if not wanted:
            return changed
        value = self.nodes(wanted[0], context, guard)
        equal = each(self.loom, "eq", before if name == "hasChangedFrom" else after, value)
        return self.loom.call("and", changed, fold(self.loom, "and", [int(node) for node in equal.ravel()]))

    def _seen(self, key: str, indices: tuple[m.Expression, ...], context: Context, guard: Guard) -> Nodes:
        return self.elements.get(key, indices, context, guard) if indices else self.variables.get(key, guard)

    def _array(self, node: int) -> Nodes:
        return np.array([[node]], dtype=np.int64)

    def event(self, tree: m.Expression, context: Context) -> tuple[Event, State | None] | None:
        """The event that an expression sends, and the state that it is sent to, if it names one."""
        if isinstance(tree, m.Name):
            found = self.diagram.event(tree.name, context.scope)
            return (found, None) if found is not None else None
        if isinstance(tree, m.Field):
            way = way_of(tree)
            state = self.diagram.state(way[:-1], context.scope) if way else None
            found = self.diagram.event(way[-1], state) if way and state is not None else None
            return (found, state) if found is not None else None
        if isinstance(tree, m.Call) and tree.of == m.Name("send") and 1 <= len(tree.arguments) <= 2:
            return self._sent(tree.arguments, context)
        return None

    def _sent(self, arguments: tuple[m.Expression, ...], context: Context) -> tuple[Event, State | None]:
        """The event of `send(E)` or `send(E, S)`, which may belong to S."""
        to = self.state(arguments[1], context) if len(arguments) == 2 else None
        sent = self.event(arguments[0], context)
        if sent is None and to is not None:
            sent = self.event(arguments[0], replace(context, scope=to))
        if sent is None:
            raise UnsupportedError(f"{context.place}: it sends what is no event of the chart")
        return (sent[0], to) if to is not None else sent
