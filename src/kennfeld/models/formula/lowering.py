"""Lowering of the syntax tree to a graph: order of definitions, algebraic loops, and nodes of expressions.

Expressions are lowered by generators that yield their parts (`node = yield part, scope`), so that neither long
definitions nor deeply nested function calls reach Python's recursion limit.
"""

from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Any, Final, NamedTuple

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.formula.functions import (
    CONSTANTS,
    CONTINUOUS_FUNCTIONS,
    ITSELF,
    OPERATORS,
    FunctionArgument,
    InvalidArgumentError,
)
from kennfeld.models.formula.functions import BuiltinFunction as BuiltIn
from kennfeld.models.formula.name_resolution import NameTable, children
from kennfeld.models.formula.syntax import Call, Chain, Definition, Expr, FunctionDefinition, Name, Number, Prefix

# n functions, each of which calls the next twice with different arguments, expand to 2^n calls
_MAX_EXPANSIONS = 100_000


class _NameUse(NamedTuple):
    name: str
    at_start: bool  # for an initial value


def build_order(names: NameTable) -> list[str]:
    """Return the nodes in the order of their dependencies within a sample; report loops and mark them as broken."""
    needs = _function_needs(names)
    uses = {
        name: list(_uses(definition.value, names, needs))
        for name, definition in names.definitions.items()
        if definition.value is not None
    }
    order, loops = topological_order({name: [use.name for use in used] for name, used in uses.items()})
    for loop in loops:
        # a loop through an initial value has another remedy, as `prev` would not break it
        starts = {(name, use.name) for name in loop for use in uses[name] if use.at_start}
        _report_loop(names, loop, names.definitions, bool(starts & set(pairwise(loop))))
    return order


def topological_order(uses: Mapping[str, Iterable[str]]) -> tuple[list[str], list[list[str]]]:
    """Return the names in the order of their dependencies, and one loop for each group of names that depend on each
    other.

    >>> topological_order({"a": ["b"], "b": ["c"], "c": []})
    (['c', 'b', 'a'], [])
    >>> topological_order({"a": ["b"], "b": ["a"]})[1]
    [['a', 'b', 'a']]
    """
    # depth-first, with a stack in place of recursion; False while a name is on the path, True behind it
    done: dict[str, bool] = {}
    order: list[str] = []
    loops: list[list[str]] = []
    in_loop: set[str] = set()
    for root in uses:
        path: list[str] = []
        pending: list[Iterator[str]] = [iter((root,))]
        while pending:
            used = next(pending[-1], None)
            if used is None:
                pending.pop()
                if path:
                    done[path[-1]] = True
                    order.append(path.pop())
            elif used in uses and used not in done:
                done[used] = False
                path.append(used)
                pending.append(iter(uses[used]))
            # a use of a name on the path closes a loop; within a loop that is reported, further ones would only repeat
            # it
            elif not done.get(used, True) and not (used in in_loop and path[-1] in in_loop):
                loops.append([*path[path.index(used) :], used])
                in_loop.update(loops[-1])
    return order, loops


def _report_loop(
    names: NameTable, loop: list[str], statements: Mapping[str, Definition | FunctionDefinition], initial: bool = False
) -> None:
    members = loop[:-1]
    # a loop is shown from the name that is defined first in the text
    first = min(range(len(members)), key=lambda i: statements[members[i]].at[2:])
    turned = [*members[first:], *members[:first]]
    shown = " -> ".join([*turned, turned[0]])
    names.broken.update(members)
    at = statements[turned[0]].at
    if isinstance(statements[turned[0]], FunctionDefinition):
        names.source.report(at, f"a function calls itself: {shown}", "Write feedback with prev(x, init).")
    elif initial:
        remedy = "Use an initial value that does not depend on it."
        names.source.report(at, f"an initial value depends on itself: {shown}", remedy)
    else:
        remedy = "Break it with prev(x, init) to use the value of the previous step."
        names.source.report(at, f"algebraic loop: {shown}", remedy)


class _Needs(NamedTuple):
    """The same-sample dependencies of a function of the text: its arguments (None if unused) and other names."""

    arguments: tuple[_NameUse | None, ...]
    names: tuple[_NameUse, ...]


def _function_needs(names: NameTable) -> Mapping[str, _Needs]:
    bodies = {name: function.value for name, function in names.functions.items() if function.value is not None}
    # callees before callers, whose needs include theirs
    order, loops = topological_order({name: list(_calls(body, names.functions)) for name, body in bodies.items()})
    for loop in loops:
        _report_loop(names, loop, names.functions)
    needs: dict[str, _Needs] = {}
    for name in order:
        arguments = [argument.name for argument in names.functions[name].arguments]
        used = dict.fromkeys(_uses(bodies[name], names, needs, arguments))
        # of two uses of an argument, that in the same sample outweighs that for an initial value: it comes last
        now = {use.name: use for use in sorted(used, key=lambda use: not use.at_start)}
        others = tuple(use for use in used if use.name not in arguments)
        needs[name] = _Needs(tuple(now.get(argument) for argument in arguments), others)
    return needs


def _calls(expr: Expr, functions: Collection[str]) -> Iterator[str]:
    stack = [expr]
    while stack:
        at = stack.pop()
        if isinstance(at, Call) and not at.at.quoted and at.name in functions:
            yield at.name
        stack.extend(children(at))


def _uses(
    expr: Expr, names: NameTable, needs: Mapping[str, _Needs], arguments: Collection[str] = ()
) -> Iterator[_NameUse]:
    """Return the nodes and arguments that an expression needs in the same sample, not those for the next state only."""
    stack = [(expr, False)]
    while stack:
        at, start = stack.pop()
        if isinstance(at, Name):
            if at.name in arguments or names.kind(at.name, at.at.quoted) == "node":
                yield _NameUse(at.name, start)
        elif isinstance(at, Call) and (function := names.built_in(at)) is not None:
            bound = [(function.argument(i), arg) for i, arg in enumerate(at.args)]
            stack.extend((arg, start or spec.name == "init") for spec, arg in bound if not spec.later)
        elif isinstance(at, Call) and not at.at.quoted and at.name in names.functions:
            # none for a function that calls itself or has no valid body, which is reported
            needed = needs.get(at.name, _Needs((), ()))
            yield from (_NameUse(use.name, start or use.at_start) for use in needed.names)
            same_sample = zip(at.args, needed.arguments, strict=False)
            stack.extend((arg, start or use.at_start) for arg, use in same_sample if use)
        else:
            stack.extend((part, start) for part in children(at))


class _Scope(NamedTuple):
    """The arguments of the enclosing function, bound to expressions."""

    key: int
    bound: "Mapping[str, tuple[Expr, _Scope]]"


_TEXT: Final = _Scope(0, {})

_Steps = Generator[tuple[Expr, _Scope], int, int]


def build(names: NameTable, builder: GraphBuilder, nodes: Mapping[str, int]) -> dict[str, int]:
    """Add the nodes of all definitions, auxiliary ones included, to a graph; `nodes` are the existing ones.

    Findings are reported to the source; the nodes must not be used if there are any.
    """
    order = build_order(names)
    compiler = GraphLowering(names, builder, dict(nodes))
    for name in order:
        if name not in names.broken:
            value = names.definitions[name].value
            assert value is not None
            compiler.nodes[name] = compiler.value(value, _TEXT)
    builder.settle()
    compiler.check_orders()
    return {name: compiler.nodes[name] for name in names.definitions if name in compiler.nodes}


class _LaterArgument:
    """An argument that is evaluated when all nodes exist; those with equal keys have the same value."""

    def __init__(self, lowering: "GraphLowering", expr: Expr, scope: _Scope) -> None:
        self._lowering, self._expr, self._scope = lowering, expr, scope
        self.key = id(lowering), expr.key, scope.key

    def __call__(self) -> int:
        return self._lowering.value(self._expr, self._scope)


class GraphLowering:
    def __init__(self, names: NameTable, builder: GraphBuilder, nodes: dict[str, int]) -> None:
        self.names = names
        self.builder = builder
        self.nodes = nodes
        self._built: dict[tuple[int, int], int] = {}
        self._memories: dict[tuple[Any, ...], int] = {}
        self._scopes: dict[tuple[Any, ...], _Scope] = {}
        self._ordered: list[tuple[BuiltIn, Call, list[Any]]] = []

    def check_orders(self) -> None:
        """Report calls with constants in the wrong order, such as crossed limits; all nodes must exist."""
        for function, expr, args in self._ordered:
            places = [function.position(name) for name in function.ordered]
            # limits that later samples use are evaluated now that all nodes exist
            nodes = [args[at]() if function.arguments[at].later else args[at] for at in places]
            low, high = (self.builder.value(node) for node in nodes)
            if low is not None and high is not None and low > high:
                (first, _), (second, _) = named = list(zip(function.ordered, (low, high), strict=True))
                values = " and ".join(f"{name} = {value:g}" for name, value in named)
                # the other one may be a default, which the text does not show
                at = max(place for place in places if place < len(expr.args))
                message = f"{function.name} requires {first} <= {second}, got {values}"
                self.names.source.report(expr.args[at].at, message, "Exchange them.")

    def value(self, expr: Expr, scope: _Scope) -> int:
        """Return the node of an expression."""
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
                return _ready(self.builder.const(expr.value))
            case Name() if expr.name in scope.bound:
                return self._once(*scope.bound[expr.name], self._argument)
            case Name():
                return _ready(self._name(expr))
            case Chain():
                return self._chain(expr, scope)
            case Prefix():
                return self._prefix(expr, scope)
            case Call():
                return self._once(expr, scope, self._call)

    def _once(self, expr: Expr, scope: _Scope, steps: Callable[[Any, _Scope], _Steps]) -> _Steps:
        """Lower equal syntax in one scope to one node, so that equal memory calls share one state."""
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
                return self.builder.const(CONSTANTS[name])
            case "node":
                # placeholder for a node whose definition is wrong: any input that is not a constant
                return self.nodes[name] if name in self.nodes else self.builder.input(name)
            case "parameter":
                return self.builder.lookup(name)
            case "input" | "clock":
                return self.builder.input(name)

    def _chain(self, expr: Chain, scope: _Scope) -> _Steps:
        node = yield expr.first, scope
        for operator, operand in expr.rest:
            node = self.builder.call(OPERATORS[operator], node, (yield operand, scope))
        return node

    def _prefix(self, expr: Prefix, scope: _Scope) -> _Steps:
        operand = yield expr.operand, scope
        return self.builder.call("neg" if expr.op == "-" else "not", operand)

    def _call(self, expr: Call, scope: _Scope) -> _Steps:
        if (function := self.names.built_in(expr)) is not None:
            return (yield from self._built_in(function, expr, scope))
        if not expr.at.quoted and expr.name in self.names.functions:
            return (yield from self._expand(expr, scope))
        coordinates: list[int] = []
        for arg in expr.args:
            coordinate = yield arg, scope
            coordinates.append(coordinate)
        return self.builder.lookup(expr.name, *coordinates)

    def _expand(self, expr: Call, scope: _Scope) -> _Steps:
        function = self.names.functions[expr.name]
        if expr.name in self.names.broken or function.value is None:
            return self.builder.input(expr.name)
        # equal calls share a scope, and with it their nodes and states
        key = (expr.name, *((arg.key, scope.key) for arg in expr.args))
        if len(self._scopes) >= _MAX_EXPANSIONS:
            message = f"the functions of this text expand to more than {_MAX_EXPANSIONS} calls"
            self.names.source.report(function.at, message, "Assign values that are used twice to named nodes.")
            self.names.broken.add(expr.name)
            return self.builder.input(expr.name)
        if key not in self._scopes:
            bound = {argument.name: (arg, scope) for argument, arg in zip(function.arguments, expr.args, strict=True)}
            self._scopes[key] = _Scope(len(self._scopes) + 1, bound)
        return (yield function.value, self._scopes[key])

    def _built_in(self, function: BuiltIn, expr: Call, scope: _Scope) -> _Steps:
        if self.names.solver:
            function = CONTINUOUS_FUNCTIONS.get(function.name, function)
        args: list[Any] = []
        key: list[Any] = [function.name]
        for index, argument_value in enumerate(expr.args):
            if function.argument(index).later:
                args.append(_LaterArgument(self, argument_value, scope))
                # its node does not exist yet: equal syntax in one scope stands for it
                key.append((argument_value.key, scope.key))
            else:
                args.append((yield argument_value, scope))
                key.append(args[-1])
        args += [self._default(argument, args, function) for argument in function.arguments[len(args) :]]
        if function.ordered:
            self._ordered.append((function, expr, args))
        if not function.memory:
            return function.rule(self.builder, *args)
        if tuple(key) not in self._memories:
            self._memories[tuple(key)] = self._held(self._remember(function, expr, args))
        return self._memories[tuple(key)]

    def _held(self, node: int) -> int:
        """Return the value of a function with memory, which a solver holds within the step unless it integrates it."""
        is_state = self.builder.nodes[node].op == "state"
        return CONTINUOUS_FUNCTIONS["sampled"].rule(self.builder, node) if self.names.solver and not is_state else node

    def _default(self, argument: FunctionArgument, args: list[Any], function: BuiltIn) -> Any:
        if argument.default == ITSELF:
            return None
        earlier = [other.name for other in function.arguments]
        if argument.default in earlier:
            return args[earlier.index(argument.default)]
        node = self.builder.const(float(argument.default))
        return (lambda: node) if argument.later else node

    def _remember(self, function: BuiltIn, expr: Call, args: list[Any]) -> int:
        try:
            return function.rule(self.builder, *args)
        except InvalidArgumentError as unusable:
            index = function.position(unusable.argument)
            # a number of steps that is not constant may be the placeholder of a wrong line, which is reported there
            if self.builder.value(args[index]) is not None or not self.names.broken:
                self.names.source.report(expr.args[index].at, unusable.message)
            return self.builder.input(expr.name)


def _ready(node: int) -> _Steps:
    """Return a node without yielding parts."""
    yield from ()
    return node
