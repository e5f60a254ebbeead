"""The state of code along one path, the merging of two paths after a decision, and the interpreter that follows them.

After a decision each variable is selected by its condition.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from functools import partial, reduce
from typing import Protocol, TypeVar

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab.values import MatlabCell, MatlabFunctionHandle, MatlabStruct, object_array
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.node_arrays import Nodes, elementwise, format_sizes
from kennfeld.models.imperative.path_facts import assume, known_truth, logical_and, logical_not, logical_or
from kennfeld.program import tree as m

Key = TypeVar("Key")
_SAME_TYPE_REMEDY = "Give it the same type and size on both sides of the decision."


@dataclass(eq=False)
class CallFrame:
    """A function being followed: how it was called, and which of its variables are persistent."""

    name: str = ""
    arguments: int = 0
    wanted: int = 1
    persistent: list[str] = field(default_factory=list)
    functions: Mapping[str, m.FunctionDefinition] = field(default_factory=dict)
    shared: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class PathState:
    """The state of code along one path: variables, persistent variables by function, jumps and known conditions.

    `jumps` are the conditions under which a break, continue or return was executed; `facts` are the conditions known on
    this path; `failures` are those under which the code has failed, in any function, with values that do not count.
    `varies` is True if the size of a variable may depend on a condition.
    """

    names: dict[str, s.SymbolicValue] = field(default_factory=dict)
    kept: dict[tuple[str, str], s.SymbolicValue] = field(default_factory=dict)
    jumps: dict[str, int] = field(default_factory=dict)
    facts: Mapping[int, bool] = field(default_factory=dict)
    failures: dict[int, None] = field(default_factory=dict)
    varies: bool = False

    def under(self, builder: GraphBuilder, condition: int, holds: bool) -> "PathState":
        """Return a copy for one side of a decision, which may be changed."""
        facts = assume(builder, self.facts, condition, holds)
        return replace(self.copy(), facts=facts)

    def copy(self) -> "PathState":
        """Return a copy, which may be changed."""
        return replace(
            self,
            names=dict(self.names), kept=dict(self.kept), jumps=dict(self.jumps), failures=dict(self.failures),
        )  # fmt: skip

    def within(self, names: dict[str, s.SymbolicValue]) -> "PathState":
        """Return the state at the start of a function with its own variables."""
        return PathState(names, self.kept, {}, self.facts, self.failures, self.varies)

    def after(self, called: "PathState") -> "PathState":
        """Return this state after a function that has ended in the state `called`."""
        return replace(self, kept=called.kept, failures=called.failures, varies=called.varies)


def merge_states(builder: GraphBuilder, condition: int, yes: PathState, no: PathState, before: PathState) -> PathState:
    """Return the state after a decision."""
    work = _StateMerge(builder, condition, yes.facts, no.facts)
    jumps = {kind: work.jump(yes.jumps.get(kind), no.jumps.get(kind)) for kind in {**yes.jumps, **no.jumps}}
    names, kept = work.mapping(yes.names, no.names), work.mapping(yes.kept, no.kept)
    failures = work.failures(yes.failures, no.failures)
    varies = before.varies or yes.varies or no.varies or work.varies
    return replace(before, names=names, kept=kept, jumps=jumps, failures=failures, varies=varies)


class _StateMerge:
    def __init__(self, builder: GraphBuilder, condition: int, yes: Mapping[int, bool], no: Mapping[int, bool]) -> None:
        self.builder, self.condition = builder, condition
        self.yes, self.no = yes, no
        self.varies = False

    def jump(self, yes: int | None, no: int | None) -> int:
        builder, never = self.builder, self.builder.const(0.0)
        item = logical_and(builder, self.condition, never if yes is None else yes)
        other = logical_and(builder, logical_not(builder, self.condition), never if no is None else no)
        return logical_or(builder, item, other)

    def failures(self, yes: Mapping[int, None], no: Mapping[int, None]) -> dict[int, None]:
        """Return the conditions of both sides; those of one side hold only if it is taken."""
        result = {node: None for node in yes if node in no}
        for choice, side in ((self.condition, yes), (logical_not(self.builder, self.condition), no)):
            # as one condition, or a loop would repeat those of its last passes for each pass
            own = [node for node in side if node not in result]
            if own:
                result[logical_and(self.builder, choice, reduce(partial(logical_or, self.builder), own))] = None
        return result

    def mapping(
        self, yes: Mapping[Key, s.SymbolicValue], no: Mapping[Key, s.SymbolicValue]
    ) -> dict[Key, s.SymbolicValue]:
        return {key: self.held(str(key), yes.get(key), no.get(key)) for key in {**no, **yes}}

    def held(self, name: str, yes: s.SymbolicValue | None, no: s.SymbolicValue | None) -> s.SymbolicValue:
        if yes is no and yes is not None:
            return yes
        earlier = yes if isinstance(yes, s.ConditionalValue) else no
        yes, no = self._whole(yes, self.yes), self._whole(no, self.no)
        if yes is None and no is None and isinstance(earlier, s.ConditionalValue):
            # assigned on another path only; an assignment behind both sides counts
            return s.ConditionalValue(earlier.value, self.builder.const(0.0))
        if yes is None or no is None or isinstance(yes, s.ConditionalValue) or isinstance(no, s.ConditionalValue):
            return self._partial(name, yes, no)
        if isinstance(yes, s.VaryingArray) or isinstance(no, s.VaryingArray):
            return self._varying(name, yes, no)
        if isinstance(yes, s.InvalidValue) or isinstance(no, s.InvalidValue):
            return yes if isinstance(yes, s.InvalidValue) else no
        return self._both(name, yes, no)

    def _whole(self, value: s.SymbolicValue | None, facts: Mapping[int, bool]) -> s.SymbolicValue | None:
        if isinstance(value, s.DeferredValue):
            return s.force(value)
        if isinstance(value, s.ConditionalValue):
            truth = known_truth(self.builder, facts, value.defined)
            return value if truth is None else value.value if truth else None
        return value

    def _partial(self, name: str, yes: s.SymbolicValue | None, no: s.SymbolicValue | None) -> s.SymbolicValue:
        """Merge a variable that is certainly defined on at most one side."""
        parts = [item.value if isinstance(item, s.ConditionalValue) else item for item in (yes, no)]
        values = [part for part in parts if part is not None]
        if not values:
            return s.InvalidValue(f"{name} is not assigned")
        value = self.held(name, *values) if len(values) == 2 else values[0]
        if isinstance(value, s.InvalidValue):
            return value
        return s.ConditionalValue(value, self.jump(self._defined(yes), self._defined(no)))

    def _defined(self, value: s.SymbolicValue | None) -> int:
        return value.defined if isinstance(value, s.ConditionalValue) else self.builder.const(float(value is not None))

    def _both(self, name: str, yes: s.SymbolicValue, no: s.SymbolicValue) -> s.SymbolicValue:
        match yes, no:
            case np.ndarray(), np.ndarray():
                return self._arrays(name, yes, no)
            case MatlabStruct(), MatlabStruct() if yes.elements is no.elements:
                return yes
            case MatlabStruct(), MatlabStruct() if (
                set(yes.fields) == set(no.fields) and yes.elements.size == no.elements.size == 1
            ):
                return MatlabStruct.of(
                    {key: self.held(f"{name}.{key}", yes.fields[key], no.fields[key]) for key in yes.fields}
                )
            case MatlabStruct(), MatlabStruct() if (
                set(yes.fields) == set(no.fields) and yes.elements.shape == no.elements.shape
            ):
                return self._structs(name, yes, no)
            case MatlabCell(), MatlabCell() if yes.values.shape == no.values.shape:
                pairs = zip(yes.contents, no.contents, strict=True)
                return MatlabCell.of((self.held(name, *pair) for pair in pairs), yes.values.shape)
            case str(), str() if yes == no:
                return yes
            case MatlabFunctionHandle(), MatlabFunctionHandle() if not (yes.variables or no.variables):
                if (yes.name, yes.parameters, yes.body) == (no.name, no.parameters, no.body):
                    return yes
        return _of_two_types(name)

    def _structs(self, name: str, yes: MatlabStruct, no: MatlabStruct) -> MatlabStruct:
        """Merge arrays of structs, element by element."""
        pairs = zip(yes.elements.ravel(order="F"), no.elements.ravel(order="F"), strict=True)
        merged = [
            {key: self.held(f"{name}({at}).{key}", item[key], other[key]) for key in item}
            for at, (item, other) in enumerate(pairs, 1)
        ]
        whole = object_array(merged, (len(merged), 1)).reshape(yes.elements.shape, order="F")
        return MatlabStruct(whole, yes.names, yes.kind)

    def _arrays(self, name: str, yes: Nodes, no: Nodes) -> s.SymbolicValue:
        return self._selected(self.condition, yes, no) if yes.shape == no.shape else self._varying(name, yes, no)

    def _varying(self, name: str, yes: s.SymbolicValue, no: s.SymbolicValue) -> s.SymbolicValue:
        """Return an array whose size depends on the condition, arrays of equal sizes as one."""
        options: dict[tuple[int, ...], tuple[int, Nodes]] = {}
        for choice, side in ((self.condition, yes), (logical_not(self.builder, self.condition), no)):
            always = self.builder.const(1.0)
            for own, array in side.options if isinstance(side, s.VaryingArray) else ((always, side),):
                if not isinstance(array, np.ndarray):
                    return array if isinstance(array, s.InvalidValue) else _of_two_types(name)
                condition = logical_and(self.builder, choice, own)
                if array.shape in options:
                    known, other = options[array.shape]
                    array = self._selected(condition, array, other)
                    condition = logical_or(self.builder, known, condition)
                options[array.shape] = condition, array
        if len(options) == 1:
            return next(iter(options.values()))[1]
        self.varies = True
        sizes = " or ".join(format_sizes(array) for _, array in options.values())
        why = f"the size of {name} depends on a condition ({sizes})"
        return s.VaryingArray(why, _SAME_TYPE_REMEDY, tuple(options.values()))

    def _selected(self, condition: int, yes: Nodes, no: Nodes) -> Nodes:
        """Return an array of one size, selected by a condition."""
        if yes is no:
            return yes
        choice = np.array([[condition]], dtype=np.int64)
        result = yes if np.array_equal(yes, no) else elementwise(self.builder, "select", choice, yes, no)
        if isinstance(yes, s.LogicalNodes) and isinstance(no, s.LogicalNodes):
            return s.as_logical(result)
        return s.integers(result, s.word_of(yes) if s.word_of(yes) == s.word_of(no) else None)


def _of_two_types(name: str) -> s.InvalidValue:
    return s.InvalidValue(f"{name} has different types on the two sides of a condition", _SAME_TYPE_REMEDY)


class SymbolicInterpreter(Protocol):
    """Interpreter of statements, as expressions and loops use it.

    `questions` counts isempty queries of persistent variables that have no value yet.
    """

    context: EvaluationContext
    builder: GraphBuilder
    state: PathState
    frame: CallFrame
    questions: int

    @property
    def names(self) -> dict[str, s.SymbolicValue]: ...
    def value(self, tree: m.Expression) -> s.SymbolicValue: ...
    def nodes(self, tree: m.Expression, message: str = ...) -> Nodes: ...
    def read(self, name: str) -> s.SymbolicValue: ...
    def of_one_size(self, value: s.VaryingArray) -> Nodes: ...
    def truth(self, value: s.SymbolicValue) -> int: ...
    def assign(self, target: m.Expression | None, value: s.SymbolicValue) -> None: ...
    def run(self, statements: Sequence[m.Statement]) -> None: ...
    def going(self) -> int | None: ...
    def fail_where(self, condition: int) -> None: ...
    def decide(self, condition: int, yes: Callable[[], None], no: Callable[[], None] = ...) -> None: ...
    def within(self, names: Mapping[str, s.SymbolicValue], make: Callable[[], s.SymbolicValue]) -> s.SymbolicValue: ...
    def call(
        self, function: m.FunctionDefinition, arguments: Sequence[s.SymbolicValue], wanted: int
    ) -> tuple[s.SymbolicValue, ...]: ...
