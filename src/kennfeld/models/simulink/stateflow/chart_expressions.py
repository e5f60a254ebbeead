"""Expressions of a chart's code where a guard holds: its variables, elements of arrays, operators of charts, calls.

What only charts know is taken out of an expression and put back as a name for its nodes; the rest is an expression over
graph nodes like any other.

Elements of a chart's arrays, read and written; a place that changes is a choice between all elements.

Beyond the array, where a chart would stop, there is not a number to read, and nothing is written.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.traversal import field_path
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.integer_types import IntegerType
from kennfeld.models.imperative.library.elementwise_functions import OF_BITS
from kennfeld.models.imperative.library.function_registry import KEEPS_INTEGERS, matlab_word
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, reduce_nodes
from kennfeld.models.imperative.symbolic_values import integers
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.stateflow.chart_model import ChartEvent, ChartModel, StateNode
from kennfeld.models.simulink.stateflow.function_library import is_of_library, results_of
from kennfeld.models.simulink.stateflow.guarded_variables import ActionContext, Guard, GuardedVariables, GuardLogic
from kennfeld.models.simulink.stateflow.label_parser import map_children, walk
from kennfeld.models.simulink.stateflow.temporal_logic import CHANGES, TEMPORAL
from kennfeld.models.simulink.variables.mask_scope import Scope

if TYPE_CHECKING:
    from kennfeld.models.simulink.stateflow.chart_execution import ChartExecution

__all__ = ["ChartExpressions"]

_MOST_ELEMENTS = 1_000  # of an array whose element is chosen while the model runs

_FILLED = {"NaN": math.nan, "nan": math.nan, "Inf": math.inf, "inf": math.inf}


class Elements:
    """The elements of the variables of a machine."""

    def __init__(self, values: "ChartExpressions") -> None:
        self.values = values
        self.builder = values.builder
        self.variables = values.variables

    def get(self, key: str, indices: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> Nodes:
        """Elements of a variable."""
        array = self.variables.get(key, guard)
        places = self._places(array.shape, indices, context, guard)
        try:
            fixed = self._fixed(places)
            if fixed is not None:
                return _taken(array, fixed)
            elements = self._elements(array, places, context)
        except IndexError:
            raise UnsupportedError(f"{context.place}: it takes elements of {key} that are not there") from None
        found = self.builder.const(math.nan)
        for where, element in elements:
            found = self.builder.call("select", where, element, found)
        return np.array([[found]], dtype=np.int64)

    def set(
        self, key: str, indices: tuple[m.Expression, ...], new: Nodes, context: ActionContext, guard: Guard
    ) -> None:
        """Give elements of an array a value."""
        array = self.variables.get(key, guard)
        places = self._places(array.shape, indices, context, guard)
        made = array.copy()
        try:
            fixed = self._fixed(places)
            if fixed is not None:
                _put(made, fixed, new)
                return self.variables.set(key, made, guard)
            elements = self._elements(array, places, context)
        except (IndexError, ValueError):
            raise UnsupportedError(f"{context.place}: it assigns to elements of {key} that are not there") from None
        if new.size != 1:
            raise UnsupportedError(f"{context.place}: it assigns to several elements of {key} that change")
        chosen = [self.builder.call("select", where, int(new.item()), element) for where, element in elements]
        return self.variables.set(key, np.array(chosen, dtype=np.int64).reshape(array.shape), guard)

    def _places(
        self, shape: tuple[int, ...], indices: tuple[m.Expression, ...], context: ActionContext, guard: Guard
    ) -> list[Nodes | None]:
        """The nodes of each index, None of a colon."""
        found: list[Nodes | None] = []
        if len(indices) not in (1, 2):
            raise UnsupportedError(f"{context.place}: it indexes with {len(indices)} numbers")
        for axis, index in enumerate(indices):
            size = math.prod(shape) if len(indices) == 1 else shape[axis]
            if isinstance(index, m.Colon):
                found.append(None)
            else:
                found.append(self._place(self._ended(index, size, context), context, guard))
        return found

    def _ended(self, index: m.Expression, size: int, context: ActionContext) -> m.Expression:
        """An index in which `end` is a number, but not within an index of another array."""
        if isinstance(index, m.End):
            return m.Number(float(size))
        if isinstance(index, m.Call) and self.values.key_of(index.of, context) is not None:
            return index
        return map_children(index, lambda part: self._ended(part, size, context))

    def _place(self, index: m.Expression, context: ActionContext, guard: Guard) -> Nodes:
        """The nodes of an index, made whole as its language does."""
        whole = "floor" if self.values.diagram.language.name == "C" else "round"
        return elementwise(self.builder, whole, self.values.nodes(index, context, guard))

    def _fixed(self, places: Sequence[Nodes | None]) -> list[list[int] | None] | None:
        """The indices as numbers counted from 0; None where one changes. Raises `IndexError` where one is no number."""
        found: list[list[int] | None] = []
        for place in places:
            if place is None:
                found.append(None)
                continue
            numbers = [self.builder.value(int(node)) for node in place.ravel()]
            if None in numbers:
                return None
            if not np.all(np.isfinite(np.array(numbers, dtype=np.float64))):
                raise IndexError
            found.append([int(number or 0) - 1 for number in numbers])
        return found

    def _elements(
        self, array: Nodes, places: Sequence[Nodes | None], context: ActionContext
    ) -> "list[tuple[int, int]]":
        """Each element, rows first, with the node that is 1 where the indices mean it; raises `IndexError`."""
        if array.size > _MOST_ELEMENTS or any(place is None or place.size != 1 for place in places):
            raise UnsupportedError(f"{context.place}: it indexes an array in a way that is not supported")
        for place, size in zip(places, array.shape if len(places) == 2 else (array.size,), strict=True):
            number = self.builder.value(int(place.item())) if place is not None else None
            if number is not None and not 1 <= number <= size:
                raise IndexError
        made = []
        for at in np.ndindex(*array.shape):
            wanted = at if len(places) == 2 else (at[0] + at[1] * array.shape[0],)
            equal = [
                self.builder.call("eq", int(place.item()), self.builder.const(float(index + 1)))
                for place, index in zip(places, wanted, strict=True)
                if place is not None
            ]
            made.append((reduce_nodes(self.builder, "and", equal), int(array[at])))
        return made


def _flat(indices: list[int], shape: tuple[int, ...]) -> tuple[Any, ...]:
    if min(indices, default=0) < 0:
        raise IndexError
    return np.unravel_index(np.array(indices, dtype=np.int64), shape, order="F")


def _taken(array: Nodes, indices: list[list[int] | None]) -> Nodes:
    if len(indices) == 1:
        chosen = indices[0]
        if chosen is None:
            return array.reshape(-1, 1, order="F")
        try:
            found = array[_flat(chosen, array.shape)]
        except ValueError:
            raise IndexError from None
        found = np.asarray(found, dtype=np.int64)
        return found.reshape(-1, 1) if array.shape[1] == 1 and array.shape[0] != 1 else found.reshape(1, -1)
    return np.asarray(array[_grid(indices, array.shape)])


def _put(array: Nodes, indices: list[list[int] | None], new: Nodes) -> None:
    if len(indices) == 1:
        chosen = indices[0] if indices[0] is not None else list(range(array.size))
        array[_flat(chosen, array.shape)] = new.item() if new.size == 1 else new.ravel(order="F")
    else:
        array[_grid(indices, array.shape)] = new.item() if new.size == 1 else new


def _grid(indices: list[list[int] | None], shape: tuple[int, ...]) -> Any:
    chosen = [list(range(size)) if one is None else one for one, size in zip(indices, shape, strict=True)]
    if any(place < 0 for one in chosen for place in one):
        raise IndexError
    return np.ix_(*chosen)


class ChartExpressions:
    """Evaluates expressions for a machine."""

    def __init__(self, machine: "ChartExecution", expressions: Expressions, scope: Scope) -> None:
        self.machine = machine
        self.expressions = expressions
        self.scope = scope
        self.builder = expressions.builder
        self.logic: GuardLogic = machine.logic
        self.diagram: ChartModel = machine.diagram
        self.variables: GuardedVariables = machine.variables
        self.elements = Elements(self)

    def nodes(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes:
        """The nodes of an expression, Int[rows, columns]."""
        taken: dict[str, Nodes] = {}
        plain = self._plain(tree, context, guard, taken)
        try:
            return self.logic.simplified(self.expressions.computed(plain, self.scope, taken), guard)
        except EvaluationError as error:
            raise UnsupportedError(f"{context.place}: {error}", "", error.undefined) from None
        except InputError as error:
            raise UnsupportedError(f"{context.place}: {error.findings[0]}") from None

    def one(self, tree: m.Expression, context: ActionContext, guard: Guard) -> int:
        """The node of an expression that is a scalar; of an array as a condition, whether all its elements hold."""
        found = self.nodes(tree, context, guard)
        if found.size == 0:
            raise UnsupportedError(f"{context.place}: it decides by an empty array")
        return reduce_nodes(self.builder, "and", [int(node) for node in found.ravel()])

    def given(self, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> list[Nodes | None]:
        """The values that a function is given; None for texts, which can but be shown."""
        return [None if isinstance(one, m.Text) else self.nodes(one, context, guard) for one in arguments]

    def key(self, name: str, context: ActionContext) -> str | None:
        """The variable that a name means."""
        if context.frame and (local := f"{context.frame}.{name}") in self.variables:
            return local
        data = self.diagram.datum(name, context.scope)
        if data is None or data.written.scope == "PARAMETER_DATA":
            return None
        return data.key if data.key in self.variables else None

    def key_of(self, tree: m.Expression, context: ActionContext) -> str | None:
        """The variable that a name, or a way of names through states, means."""
        if isinstance(tree, m.Name):
            return self.key(tree.name, context)
        way = field_path(tree) if isinstance(tree, m.Field) else None
        state = self.diagram.state(way[:-1], context.scope) if way else None
        if way is None or state is None:
            return None
        data = self.diagram.data.get((state.id, way[-1]))
        return data.key if data is not None and data.key in self.variables else None

    # what only charts know

    def _plain(self, tree: m.Expression, context: ActionContext, guard: Guard, taken: dict[str, Nodes]) -> m.Expression:
        """A tree in which names stand for what only charts know."""
        nodes = self._own(tree, context, guard)
        if nodes is not None:
            name = f"#{len(taken)}"
            taken[name] = nodes
            return m.Name(name, place=tree.place)
        called = tree.of if isinstance(tree, m.Call) else None  # a function, which is no variable
        return map_children(tree, lambda one: one if one is called else self._plain(one, context, guard, taken))

    def _own(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes | None:
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

    def _named(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes | None:
        key = self.key_of(tree, context)
        if key is not None:
            return self.variables.get(key, guard)
        if tree == m.Name("t") and self.diagram.chart.language == "C" and self.scope.find("t") is None:
            return self._array(self.machine.time)
        return None

    def _may_fail(self, tree: m.Expression, context: ActionContext) -> bool:
        """Whether an expression calls a function of the chart or takes an element of an array."""
        return any(
            isinstance(one, m.Call)
            and isinstance(one.of, m.Name)
            and (self.diagram.function(one.of.name, context.scope) or self.key(one.of.name, context)) is not None
            for one in walk(tree)
        )

    def _decided(
        self, operator: str, left: m.Expression, right: m.Expression, context: ActionContext, guard: Guard
    ) -> Nodes | None:
        """An `and` or `or`, its right side only where the left side leaves it open."""
        first = self.one(left, context, guard)
        rest = self.logic.where(guard, first, holds=operator == "&&")
        decided = self.builder.const(0.0 if operator == "&&" else 1.0)
        if rest is None:
            return self._array(decided)
        second = self.one(right, context, rest)
        return self._array(self.builder.call("and" if operator == "&&" else "or", first, second))

    def _called(
        self, name: str, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard
    ) -> Nodes | None:
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
            return elementwise(self.builder, "ne", asked, asked)
        if name in _FILLED:
            return self._filled(name, arguments, context, guard)
        found = self.library(name, arguments, 1, context, guard)
        return found[0] if found else None

    def library(
        self, name: str, arguments: tuple[m.Expression, ...], wanted: int, context: ActionContext, guard: Guard
    ) -> list[Nodes]:
        """The results of a function of MATLAB in a chart whose language that is; none of what is none of them."""
        if self.diagram.chart.language == "C" or not is_of_library(name):
            return []
        given = [one.value if isinstance(one, m.Text) else self._typed(one, context, guard) for one in arguments]
        try:
            return results_of(self.builder, name, given, wanted)
        except ProgramError as error:
            raise UnsupportedError(f"{context.place}: {error.message}", error.remedy) from None

    def _typed(self, tree: m.Expression, context: ActionContext, guard: Guard) -> Nodes:
        """The nodes of an expression, with the integer type that its variables and casts say."""
        return integers(self.nodes(tree, context, guard), self._word(tree, context))

    def _word(self, tree: m.Expression, context: ActionContext) -> IntegerType | None:
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

    def _declared(self, tree: m.Expression, context: ActionContext) -> IntegerType | None:
        """The integer type that the chart declares for a variable."""
        key = self.key_of(tree, context)
        data = next((one for one in self.diagram.data.values() if one.key == key), None) if key is not None else None
        return matlab_word(data.written.type.strip()) if data is not None else None

    def _filled(self, name: str, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> Nodes:
        """An array of a number that is none, or infinite; the name of a type behind its sizes is passed over."""
        sizes = m.Call(m.Name("zeros"), tuple(one for one in arguments if not isinstance(one, m.Text)))
        number = self.builder.const(_FILLED[name])
        return np.full(self.nodes(sizes, context, guard).shape, number, dtype=np.int64)

    def state(self, tree: m.Expression, context: ActionContext) -> StateNode:
        """The state that an expression names."""
        way = field_path(tree)
        state = self.diagram.state(way, context.scope) if way is not None else None
        if state is None:
            raise UnsupportedError(f"{context.place}: in asks for what is no state, or one of several")
        return state

    def _changed(self, name: str, arguments: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> int:
        """Whether the value at the beginning of the step differs from that at the beginning of the step before."""
        tree, wanted = arguments[0], arguments[1:]
        base, indices = (tree.of, tree.arguments) if isinstance(tree, m.Call) else (tree, ())
        key = self.key_of(base, context)
        if key is None or len(wanted) != (name != "hasChanged"):
            raise UnsupportedError(f"{context.place}: {name} is used in a way that is not supported")
        after, before = (self._seen(f"{when} {key}", indices, context, guard) for when in ("now", "before"))
        changed = reduce_nodes(
            self.builder, "or", [int(node) for node in elementwise(self.builder, "ne", after, before).ravel()]
        )
        if not wanted:
            return changed
        value = self.nodes(wanted[0], context, guard)
        equal = elementwise(self.builder, "eq", before if name == "hasChangedFrom" else after, value)
        return self.builder.call(
            "and", changed, reduce_nodes(self.builder, "and", [int(node) for node in equal.ravel()])
        )

    def _seen(self, key: str, indices: tuple[m.Expression, ...], context: ActionContext, guard: Guard) -> Nodes:
        return self.elements.get(key, indices, context, guard) if indices else self.variables.get(key, guard)

    def _array(self, node: int) -> Nodes:
        return np.array([[node]], dtype=np.int64)

    def event(self, tree: m.Expression, context: ActionContext) -> tuple[ChartEvent, StateNode | None] | None:
        """The event that an expression sends, and the state that it is sent to, if it names one."""
        if isinstance(tree, m.Name):
            found = self.diagram.event(tree.name, context.scope)
            return (found, None) if found is not None else None
        if isinstance(tree, m.Field):
            way = field_path(tree)
            state = self.diagram.state(way[:-1], context.scope) if way else None
            found = self.diagram.event(way[-1], state) if way and state is not None else None
            return (found, state) if found is not None else None
        if isinstance(tree, m.Call) and tree.of == m.Name("send") and 1 <= len(tree.arguments) <= 2:
            return self._sent(tree.arguments, context)
        return None

    def _sent(self, arguments: tuple[m.Expression, ...], context: ActionContext) -> tuple[ChartEvent, StateNode | None]:
        """The event of `send(E)` or `send(E, S)`, which may belong to S."""
        to = self.state(arguments[1], context) if len(arguments) == 2 else None
        sent = self.event(arguments[0], context)
        if sent is None and to is not None:
            sent = self.event(arguments[0], replace(context, scope=to))
        if sent is None:
            raise UnsupportedError(f"{context.place}: it sends what is no event of the chart")
        return (sent[0], to) if to is not None else sent
