"""Runs statements of MATLAB over variables that hold nodes: both sides of a decision are built.

A variable takes the side whose condition holds. `break`, `continue` and `return` are conditions too: what stands behind
them is built as the other side of a decision.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.models.simulink.code.calls import Calls
from kennfeld.models.simulink.code.conditions import either, known, negated
from kennfeld.models.simulink.code.desk import MOST_PASSES, Desk
from kennfeld.models.simulink.code.errors import CodeError, EndedError
from kennfeld.models.simulink.code.indexing import assigned
from kennfeld.models.simulink.code.joining import State, joined
from kennfeld.models.simulink.code.limits import most_of
from kennfeld.models.simulink.code.masks import chooses, chosen_elements
from kennfeld.models.simulink.code.values import (
    EMPTY,
    Cells,
    Held,
    Later,
    Partial,
    Truths,
    Unclear,
    array_of,
    constants,
    resolved,
)
from kennfeld.models.simulink.expressions import each, fold
from kennfeld.models.simulink.signals import Nodes

__all__ = ["GLOBAL", "Body", "Frame"]

Begin = Callable[[int], int | None]
GLOBAL = "global"  # the function that shared variables are kept under
_PASSES = "Bound its passes by a number in the code: for k = 1:N with break, or while k < N && ..."
_SILENT = frozenset(
    {"disp", "fprintf", "warning", "assert", "printf", "display", "tic", "toc", "figure", "plot", "drawnow", "pause"}
    | {"narginchk", "nargoutchk", "validateattributes", "keyboard", "beep", "clc", "close", "clear", "format", "hold"}
)


@dataclass(eq=False)
class Frame:
    """A function that is being followed: how it was called, and which of its variables are persistent."""

    name: str = ""
    given: int = 0
    wanted: int = 1
    persistent: list[str] = field(default_factory=list)
    functions: Mapping[str, m.FunctionDefinition] = field(default_factory=dict)
    shared: list[str] = field(default_factory=list)


class Body:
    """Code along one path, and its variables so far.

    `names` are the variables; `run` follows statements, `value` evaluates an expression, `decide` builds both sides of
    a decision, `call` runs a function. All raise `CodeError`.
    """

    def __init__(self, desk: Desk, names: Mapping[str, Held] | None = None, frame: Frame | None = None) -> None:
        self.desk, self.loom = desk, desk.loom
        self.state = State(dict(names or {}))
        self.frame = frame or Frame(functions=desk.functions)
        self.calls = Calls(self)
        self.watch: Callable[[m.If, State, int], None] | None = (
            None  # told of each `if`, and how often it asked isempty
        )
        self.questions = 0  # how often a persistent variable was asked for a value that it did not have yet

    @property
    def names(self) -> dict[str, Held]:
        """The variables."""
        return self.state.names

    # statements

    def run(self, statements: Sequence[m.Statement]) -> None:
        """Follow statements, up to where a jump is certain."""
        for at, statement in enumerate(statements, 1):
            self.desk.step()
            try:
                self._statement(statement)
            except CodeError as error:
                raise error if error.line else CodeError(error.what, error.mend, statement.place.line) from None
            going = self._going()
            if going is not None:
                self.decide(going, partial(self._go_on, statements[at:]))
                return

    def _going(self) -> int | None:
        """The condition under which no jump was met; None where there was none for certain."""
        met = self.loom.const(0.0)
        for node in self.state.jumps.values():
            met = either(self.loom, met, node)
        return None if known(self.loom, self.state.facts, met) is False else negated(self.loom, met)

    def _go_on(self, rest: Sequence[m.Statement]) -> None:
        self.state.jumps.clear()
        self.run(rest)

    def _statement(self, statement: m.Statement) -> None:
        match statement:
            case m.Assign((target,), value):
                self._assign(target, value)
            case m.Assign(targets, value):
                self._assign_several(targets, value)
            case m.If(branches, otherwise):
                self._if(statement, branches, otherwise)
            case m.For(target, values, body):
                self._for(target, values, body)
            case m.While(condition, body):
                self._while(condition, body)
            case m.Switch(subject, cases, otherwise):
                self._switch(self.value(subject), cases, otherwise)
            case m.Jump(kind):
                self.state.jumps[kind] = self.loom.const(1.0)
            case m.Declaration(kind, names):
                self._declare(kind, names)
            case m.Evaluate(expression):
                self._evaluate(expression)
            case m.Command("error", _):
                raise EndedError
            case m.Command(name, _) if name in _SILENT or name.startswith("coder."):
                return
            case _:
                raise CodeError(f"a statement that is not supported ({type(statement).__name__.lower()})")

    def _evaluate(self, expression: m.Expression) -> None:
        """An expression alone: a call for what it does; what is only told is passed over."""
        name = _called(expression)
        if name == "error":
            raise EndedError
        if name in _SILENT or (name or "").startswith("coder."):
            return
        if isinstance(expression, m.Call) and isinstance(expression.of, m.Name):
            self.calls.several(expression.of.name, expression.arguments, 0)
        elif isinstance(expression, m.Name) and expression.name not in self.names:
            self.calls.several(expression.name, (), 0)
        else:
            self.value(expression)

    def _declare(self, kind: str, names: Sequence[str]) -> None:
        if kind == "global":
            self._share(names)
            return
        for name in names:
            self.frame.persistent.append(name)
            unset = Partial(EMPTY, self.loom.const(0.0))
            self.names[name] = self.state.kept.get((self.frame.name, name), unset)

    def _share(self, names: Sequence[str]) -> None:
        """Variables that all functions share, which the host has given."""
        for name in names:
            if (GLOBAL, name) not in self.state.kept:
                raise CodeError(f"global {name}: the block has no data store of this name", "Make it an input.")
            self.frame.shared.append(name)
            self.names[name] = self.state.kept[GLOBAL, name]

    # values

    def value(self, tree: m.Expression) -> Held:
        """The value of an expression."""
        return self.calls.value(tree)

    def nodes(self, tree: m.Expression, what: str = "it") -> Nodes:
        """The value of an expression as an array of nodes."""
        return array_of(self.value(tree), what)

    def read(self, name: str) -> Held:
        """A variable that has a value here."""
        held = self.names[name]
        if isinstance(held, Later):
            held = self.names[name] = resolved(held)
        if isinstance(held, Partial):
            if not known(self.loom, self.state.facts, held.defined):
                raise CodeError(f"{name} has no value in every case", f"Give {name} a value before the decision.")
            return held.value
        if isinstance(held, Unclear):
            raise CodeError(held.why, held.mend)
        return self._simpler(held) if isinstance(held, np.ndarray) else held

    def _simpler(self, nodes: Nodes) -> Held:
        """Nodes without the decisions that are known on this path."""
        if not self.state.facts or nodes.size > 100:
            return nodes
        made = nodes.copy()
        for place, first in np.ndenumerate(nodes):
            node = int(first)
            while self.loom.nodes[node].op == "select":
                choice, yes, no = self.loom.nodes[node].args
                found = known(self.loom, self.state.facts, choice)
                if found is None:
                    break
                node = yes if found else no
            made[place] = node
        return made

    def truth(self, held: Held) -> int:
        """The condition that a value is as one: whether all of its elements hold, and there are any."""
        nodes = array_of(held, "a condition")
        if nodes.size == 0:
            return self.loom.const(0.0)
        return int(nodes.item()) if nodes.size == 1 else fold(self.loom, "and", [int(n) for n in nodes.ravel()])

    def within(self, names: Mapping[str, Held], make: Callable[[], Held]) -> Held:
        """What is made while the variables are others."""
        self._keep_shared()
        outer, around = self.state, self.frame
        self.state, self.frame = State(dict(names), outer.kept, {}, outer.facts), replace(around, shared=[])
        made = make()
        self.state, self.frame = replace(outer, kept=self.state.kept), around
        return made

    # assignments

    def assign(self, target: m.Expression | None, value: Held) -> None:
        """Give a variable, or a part of one, a value."""
        if isinstance(target, m.Name):
            self.names[target.name] = value
        elif target is not None:
            name = _base(target)
            old = self.names.get(name)
            whole = self.read(name) if old is not None and not self._undefined(old) else None
            self.names[name] = assigned(self.calls, whole, target, value)

    def _assign(self, target: m.Expression | None, tree: m.Expression) -> None:
        if target is not None and chooses(self.calls, target, tree):
            assert isinstance(target, m.Call)
            self.names[_base(target)] = chosen_elements(self.calls, target, tree)
        else:
            self.assign(target, self.value(tree))

    def _undefined(self, held: Held) -> bool:
        return isinstance(held, Partial) and not known(self.loom, self.state.facts, held.defined)

    def _assign_several(self, targets: Sequence[m.Expression | None], value: m.Expression) -> None:
        name = _called(value)
        arguments = value.arguments if isinstance(value, m.Call) else ()
        if name is None or name in self.names:
            raise CodeError("several results are taken of what is no function")
        results = self.calls.several(name, arguments, len(targets))
        if len(results) < len(targets):
            raise CodeError(f"{name} gives {len(results)} results where {len(targets)} are taken")
        for target, result in zip(targets, results, strict=False):
            self.assign(target, result)

    # decisions

    def decide(self, condition: int, yes: Callable[[], None], no: Callable[[], None] = lambda: None) -> None:
        """Build both sides of a decision, or the one that is known to be taken."""
        fixed = known(self.loom, self.state.facts, condition)
        if fixed is not None:
            (yes if fixed else no)()
            return
        before = self.state
        one, other = (self._side(condition, holds, side) for holds, side in ((True, yes), (False, no)))
        if one is None and other is None:
            raise EndedError
        if one is None or other is None:
            self.state = one or other or before
        else:
            self.state = joined(self.loom, condition, one, other, before)

    def _side(self, condition: int, holds: bool, make: Callable[[], None]) -> State | None:
        """What one side of a decision leaves; None where it ends in an error."""
        before, frame, depth, ends = self.state, self.frame, len(self.desk.calling), len(self.calls.ends)
        self.state = before.under(self.loom, condition, holds)
        try:
            make()
            made = self.state
        except EndedError:
            made = None
            del self.desk.calling[depth:], self.calls.ends[ends:]
            self.frame = frame
        self.state = before
        return made

    def _if(self, whole: m.If, branches: Sequence[m.Branch], otherwise: Sequence[m.Statement]) -> None:
        first, rest, before = branches[0], branches[1:], self.state
        if self.watch is not None:
            before = replace(before, names=dict(before.names), kept=dict(before.kept))
        asked = self.questions
        condition = self.truth(self.value(first.condition))
        asked = self.questions - asked
        no = (lambda: self._if(whole, rest, otherwise)) if rest else (lambda: self.run(otherwise))
        self.decide(condition, lambda: self.run(first.body), no)
        if self.watch is not None:
            self.watch(whole, before, asked)

    def _switch(self, subject: Held, cases: Sequence[m.Branch], otherwise: Sequence[m.Statement]) -> None:
        if not cases:
            self.run(otherwise)
            return
        condition = self._matches(subject, self.value(cases[0].condition))
        rest = cases[1:]
        self.decide(condition, lambda: self.run(cases[0].body), lambda: self._switch(subject, rest, otherwise))

    def _matches(self, subject: Held, case: Held) -> int:
        """Whether a case is that of a switch."""
        if isinstance(case, Cells):
            found = self.loom.const(0.0)
            for one in case.cells:
                found = either(self.loom, found, self._matches(subject, one))
            return found
        if isinstance(subject, str) or isinstance(case, str):
            return self.loom.const(float(subject == case if isinstance(subject, type(case)) else 0.0))
        left, right = array_of(subject, "what switch decides on"), array_of(case, "a case")
        if left.size != 1 or right.size > 1:
            raise CodeError("switch decides on several elements")
        return self.loom.call("eq", int(left.item()), int(right.item())) if right.size else self.loom.const(0.0)

    # loops

    def _repeat(self, begin: Begin, body: Sequence[m.Statement]) -> None:
        """Passes of a loop one within the other; `begin` gives the condition of a pass, None after the last one."""
        outside: list[tuple[int, State]] = []
        try:
            for number in count():
                if not self._pass(begin, number, body, outside):
                    break
        except EndedError:  # the last pass that was entered by a decision is never taken
            if not outside:
                raise
            condition, before = outside.pop()
            self.state = before.under(self.loom, condition, False)
        for condition, before in reversed(outside):
            no = before.under(self.loom, condition, False)
            self.state = joined(self.loom, condition, self.state, no, before)
        self.state.jumps.pop("break", None)

    def _pass(self, begin: Begin, number: int, body: Sequence[m.Statement], outside: list[tuple[int, State]]) -> bool:
        """One pass; false where it was the last one."""
        self.desk.step()
        condition = begin(number)
        if condition is None or not self._enter(condition, outside):
            return False
        self.run(body)
        self.state.jumps.pop("continue", None)
        going = self._going()
        if going is not None and not self._enter(going, outside):
            return False
        if going is not None:
            self.state.jumps.clear()
        return True

    def _enter(self, condition: int, outside: list[tuple[int, State]]) -> bool:
        """Go on where a condition holds; false where it never does."""
        fixed = known(self.loom, self.state.facts, condition)
        if fixed is None:
            if len(outside) > MOST_PASSES:
                raise CodeError(
                    f"a loop whose end depends on signals does not end within {MOST_PASSES} passes", _PASSES
                )
            outside.append((condition, self.state))
            self.state = self.state.under(self.loom, condition, True)
        return fixed is not False

    def _while(self, condition: m.Expression, body: Sequence[m.Statement]) -> None:
        def begin(number: int) -> int:
            found = self.truth(self.value(condition))
            fixed = self.desk.numbers(np.array([found], dtype=np.int64), "the condition of a loop")
            if fixed is None and number > MOST_PASSES:
                raise CodeError(f"while does not end within {MOST_PASSES} passes by what the code says", _PASSES)
            return found if fixed is None else self.loom.const(float(fixed.item() != 0))

        self._repeat(begin, body)

    def _for(self, target: m.Expression, values: m.Expression, body: Sequence[m.Statement]) -> None:
        if isinstance(values, m.Range):
            self._repeat(self._counting(target, values), body)
            return
        whole = self.nodes(values, "what a loop runs over")
        columns = iter([column.reshape(-1, 1) for column in whole.T] if whole.size else [])

        def begin(number: int) -> int | None:
            column = next(columns, None)
            if column is None:
                return None
            self.assign(target, column.view(Truths) if isinstance(whole, Truths) else column)
            return self.loom.const(1.0)

        self._repeat(begin, body)

    def _counting(self, target: m.Expression, values: m.Range) -> Begin:
        """The passes over a range, whose end may depend on signals where a limit of it is known."""
        first, step = self._fixed(values.first), self._fixed(values.step or m.Number(1.0))
        end = self.nodes(values.last, "the end of a range")
        if first is None or step is None or not step or end.size != 1:
            return self._walking(target, values)
        last, loom = int(end.item()), self.loom
        fixed = self.desk.numbers(end, "the end of a loop")
        limit = float(fixed.item()) if fixed is not None else most_of(loom, last, step > 0)
        if not np.isfinite(limit):
            raise CodeError(
                "a loop to an end that depends on signals, without a limit", f"Write min(..., N). {_PASSES}"
            )
        passes = int(np.floor((limit - first) / step * (1 + 1e-12) + 1e-10)) + 1
        self.desk.room(passes)

        def begin(number: int) -> int | None:
            if number >= passes:
                return None
            at = loom.const(first + number * step)
            holds = loom.call("le" if step > 0 else "ge", at, last) if fixed is None else loom.const(1.0)
            self.assign(target, np.array([[at]], dtype=np.int64))
            return holds

        return begin

    def _walking(self, target: m.Expression, values: m.Range) -> Begin:
        """The passes over a range whose beginning depends on signals: its ends tell how many there are at most."""
        first, last = (self.nodes(part, "the end of a range") for part in (values.first, values.last))
        step = self._fixed(values.step or m.Number(1.0))
        if first.size != 1 or last.size != 1 or not step:
            raise CodeError("a loop over a range whose step depends on signals", _PASSES)
        loom, up = self.loom, step > 0
        span = (most_of(loom, int(last.item()), up) - most_of(loom, int(first.item()), not up)) / step
        fixed = each(loom, "sub", last, first)
        known_span = self.desk.constant(int(fixed.item()))
        passes = (
            int(np.floor((known_span / step if known_span is not None else span) + 1e-10)) + 1
            if (known_span is not None or np.isfinite(span))
            else -1
        )
        if passes < 0 and known_span is None:
            raise CodeError("a loop over a range that depends on signals, without limits", _PASSES)

        def begin(number: int) -> int | None:
            if number >= passes:
                return None
            at = each(loom, "add", first, constants(loom, number * step))
            self.assign(target, at)
            return int(each(loom, "le" if up else "ge", at, last).item())

        return begin

    def _fixed(self, tree: m.Expression) -> float | None:
        nodes = self.nodes(tree, "the end of a range")
        found = self.desk.numbers(nodes, "a range") if nodes.size == 1 else None
        return float(found.item()) if found is not None else None

    # functions

    def call(
        self, function: m.FunctionDefinition, arguments: Sequence[Held], wanted: int = 1, frame: str = ""
    ) -> tuple[Held, ...]:
        """Run a function with its own variables and give its results; those without a value are left out."""
        name = frame or f"{function.name} {id(function)}"
        if any(function is one for one in self.desk.calling):
            raise CodeError(f"{function.name} calls itself, which is not supported", "Write it as a loop.")
        if len(arguments) > len(function.parameters) and "varargin" not in function.parameters[-1:]:
            raise CodeError(f"{function.name} takes {len(function.parameters)} arguments and gets {len(arguments)}")
        self._keep_shared()
        outer, around = self.state, self.frame
        self.frame = Frame(name, len(arguments), wanted, [], self.desk.beside(function))
        self.state = State(_given(function, arguments), outer.kept, {}, outer.facts)
        self.desk.calling.append(function)
        self.run(function.body)
        self.desk.calling.pop()
        self._keep()
        results = tuple(self._results(function, wanted))
        self.state, self.frame = replace(outer, kept=self.state.kept), around
        for name in self.frame.shared:
            self.names[name] = self.state.kept[GLOBAL, name]
        return results

    def _keep(self) -> None:
        """Note the values of persistent variables for the next call."""
        for name in self.frame.persistent:
            self.state.kept[self.frame.name, name] = self.names[name]
        self._keep_shared()

    def _keep_shared(self) -> None:
        for name in self.frame.shared:
            self.state.kept[GLOBAL, name] = self.names[name]

    def _results(self, function: m.FunctionDefinition, wanted: int) -> Iterator[Held]:
        for name in function.results[: max(wanted, 1)]:
            if name not in self.names:
                yield Unclear(f"{function.name} gives {name} no value", f"Give {name} a value in every case.")
            elif self._undefined(self.names[name]):
                yield Unclear(
                    f"{function.name} gives {name} no value, or not in every case", f"Give {name} a value first."
                )
            else:
                held = self.names[name]
                yield held if isinstance(held, Unclear) else self.read(name)


def _given(function: m.FunctionDefinition, arguments: Sequence[Held]) -> dict[str, Held]:
    names = list(function.parameters)
    if names[-1:] == ["varargin"]:
        fixed = len(names) - 1
        rest = tuple(arguments[fixed:])
        return {**dict(zip(names, arguments[:fixed], strict=False)), "varargin": Cells(rest, (1, len(rest)))}
    return dict(zip(names, arguments, strict=False))


def _called(tree: m.Expression) -> str | None:
    """The name of the function that an expression calls, with its dots."""
    if isinstance(tree, m.Call):
        tree = tree.of
    names: list[str] = []
    while isinstance(tree, m.Field):
        names.append(tree.name)
        tree = tree.of
    return ".".join([tree.name, *reversed(names)]) if isinstance(tree, m.Name) else None


def _base(tree: m.Expression) -> str:
    """The variable that an assignment changes."""
    while isinstance(tree, (m.Field, m.DynamicField, m.Call, m.CellIndex)):
        tree = tree.of
    if not isinstance(tree, m.Name):
        raise CodeError("it assigns to what is no variable")
    return tree.name
