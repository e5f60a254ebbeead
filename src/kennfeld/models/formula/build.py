"""Syntax to graph.

Expressions are built by generators that ask for their parts (`node = yield part, scope`), so that neither long
definitions nor deeply nested calls of functions meet Python's recursion limit.
"""

from collections.abc import Callable, Generator, Mapping
from functools import partial
from typing import Any, Final, NamedTuple

from kennfeld.models.formula.functions import (
    CONSTANTS,
    OPERATORS,
    Argument,
    Loom,
    UnusableError,
)
from kennfeld.models.formula.functions import Function as BuiltIn
from kennfeld.models.formula.names import Names
from kennfeld.models.formula.order import build_order
from kennfeld.models.formula.syntax import Call, Chain, Expr, Name, Number, Prefix

__all__ = ["build"]

_MOST_EXPANSIONS = 100_000


class _Scope(NamedTuple):
    """Where an expression stands: what the arguments of the surrounding function are bound to."""

    key: int
    bound: "Mapping[str, tuple[Expr, _Scope]]"


_TEXT: Final = _Scope(0, {})

_Steps = Generator[tuple[Expr, _Scope], int, int]


def build(names: Names, loom: Loom, nodes: Mapping[str, int]) -> dict[str, int]:
    """The nodes of all definitions, auxiliary ones included; `nodes` are those that exist already.

    What is wrong goes to the source; then the nodes are of no use.
    """
    order = build_order(names)
    weaver = _Weaver(names, loom, dict(nodes))
    for name in order:
        if name not in names.broken:
            value = names.definitions[name].value
            assert value is not None
            weaver.nodes[name] = weaver.value(value, _TEXT)
    loom.settle()
    return {name: weaver.nodes[name] for name in names.definitions if name in weaver.nodes}


class _Weaver:
    def __init__(self, names: Names, loom: Loom, nodes: dict[str, int]) -> None:
        self.names = names
        self.loom = loom
        self.nodes = nodes
        self._built: dict[tuple[int, int], int] = {}
        self._memories: dict[tuple[Any, ...], int] = {}
        self._scopes: dict[tuple[Any, ...], _Scope] = {}

    def value(self, expr: Expr, scope: _Scope) -> int:
        """The node of an expression."""
        stack = [self._steps(expr, scope)]
        result: Any = None
        while stack:
            try:
                part = stack[-1].send(result)
            except StopIteration as finished:
                result = finished.value
                stack.pop()
            else:
                stack.append(self._steps(*part))
                result = None
        return int(result)

    def _steps(self, expr: Expr, scope: _Scope) -> _Steps:
        match expr:
            case Number():
                return _ready(self.loom.const(expr.value))
            case Name() if expr.name in scope.bound:
                return self._once(expr, *scope.bound[expr.name], self._argument)
            case Name():
                return _ready(self._name(expr))
            case Chain():
                return self._chain(expr, scope)
            case Prefix():
                return self._prefix(expr, scope)
            case Call():
                return self._once(expr, expr, scope, self._call)

    def _once(self, at: Expr, expr: Expr, scope: _Scope, steps: Callable[[Any, _Scope], _Steps]) -> _Steps:
        """Equal syntax in one scope is one node; this is what makes equal memory calls one state."""
        key = (expr.key, scope.key)
        if key not in self._built:
            self._built[key] = yield from steps(expr, scope)
        return self._built[key]

    def _argument(self, expr: Expr, scope: _Scope) -> _Steps:
        return (yield expr, scope)

    def _name(self, expr: Name) -> int:
        name = expr.name
        match self.names.kind(name, expr.at.quoted):
            case "constant":
                return self.loom.const(CONSTANTS[name])
            case "node":
                # a node whose definition is wrong has no number; any input that is no constant stands for it
                return self.nodes[name] if name in self.nodes else self.loom.input(name)
            case "parameter":
                return self.loom.lookup(name)
            case "input" | "clock":
                return self.loom.input(name)

    def _chain(self, expr: Chain, scope: _Scope) -> _Steps:
        node = yield expr.first, scope
        for operator, operand in expr.rest:
            node = self.loom.call(OPERATORS[operator], node, (yield operand, scope))
        return node

    def _prefix(self, expr: Prefix, scope: _Scope) -> _Steps:
        operand = yield expr.operand, scope
        return self.loom.call("neg" if expr.op == "-" else "not", operand)

    def _call(self, expr: Call, scope: _Scope) -> _Steps:
        if (function := self.names.built_in(expr)) is not None:
            return (yield from self._built_in(function, expr, scope))
        if not expr.at.quoted and expr.name in self.names.functions:
            return (yield from self._defined(expr, scope))
        coordinates: list[int] = []
        for arg in expr.args:
            coordinate = yield arg, scope
            coordinates.append(coordinate)
        return self.loom.lookup(expr.name, *coordinates)

    def _defined(self, expr: Call, scope: _Scope) -> _Steps:
        function = self.names.functions[expr.name]
        if expr.name in self.names.broken or function.value is None:
            return self.loom.input(expr.name)
        key = (expr.name, *((arg.key, scope.key) for arg in expr.args))
        if len(self._scopes) >= _MOST_EXPANSIONS:
            what = f"the functions of this text unfold to more than {_MOST_EXPANSIONS} calls"
            self.names.source.report(function.at, what, "Give values that are used twice names of their own.")
            self.names.broken.add(expr.name)
            return self.loom.input(expr.name)
        if key not in self._scopes:
            bound = {argument.name: (arg, scope) for argument, arg in zip(function.arguments, expr.args, strict=True)}
            self._scopes[key] = _Scope(len(self._scopes) + 1, bound)
        return (yield function.value, self._scopes[key])

    def _built_in(self, function: BuiltIn, expr: Call, scope: _Scope) -> _Steps:
        args: list[Any] = []
        key: list[Any] = [function.name]
        for index, given in enumerate(expr.args):
            if function.argument(index).later:
                args.append(partial(self.value, given, scope))
                key.append((given.key, scope.key))
            else:
                args.append((yield given, scope))
                key.append(args[-1])
        args += [self._default(argument, args, function) for argument in function.arguments[len(args) :]]
        if not function.memory:
            return function.rule(self.loom, *args)
        if tuple(key) not in self._memories:
            self._memories[tuple(key)] = self._remembered(function, expr, args)
        return self._memories[tuple(key)]

    def _default(self, argument: Argument, given: list[Any], function: BuiltIn) -> Any:
        earlier = [other.name for other in function.arguments]
        if argument.default in earlier:
            return given[earlier.index(argument.default)]
        node = self.loom.const(float(argument.default))
        return (lambda: node) if argument.later else node

    def _remembered(self, function: BuiltIn, expr: Call, args: list[Any]) -> int:
        try:
            return function.rule(self.loom, *args)
        except UnusableError as unusable:
            index = [argument.name for argument in function.arguments].index(unusable.argument)
            if self.loom.value(args[index]) is not None or not self.names.broken:
                self.names.source.report(expr.args[index].at, unusable.what)
            return self.loom.input(expr.name)


def _ready(node: int) -> _Steps:
    """The steps of what needs no parts."""
    yield from ()
    return node
