"""Translation of functions in Python to the shared syntax tree: numbers, lists, conditions, loops and mathematics."""

import ast
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial, reduce
from itertools import count
from typing import Final

import numpy as np

from kennfeld.base.errors import Finding, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import BoundedGraphBuilder, GraphBuilder, GraphTooLargeError
from kennfeld.importers.python.mathematics import LIBRARY
from kennfeld.importers.python.reading import PythonFunction, number_of, returns_of
from kennfeld.importers.python.scope import (
    FunctionScope,
    NumberKind,
    UntranslatableError,
    as_function,
    element_name,
    merged_kind,
    parameters_of,
    read_names,
    stored_names,
    untranslated,
)
from kennfeld.importers.python.sequences import SequenceTranslation, target_names
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError
from kennfeld.models.imperative.path_facts import logical_or
from kennfeld.models.imperative.statement_interpreter import StatementInterpreter
from kennfeld.program import tree as m

_MOST_KINDS: Final = 6  # a kind changes from integer to float to unknown, one name after the other


class PythonTranslation(SequenceTranslation):
    """Translates a function of a file, and those that it calls."""

    def __init__(self, source: PythonFunction) -> None:
        super().__init__(source)
        self.functions: dict[str, m.FunctionDefinition] = {}
        self._numbers = count()
        self.kinds_of_results: dict[str, tuple[NumberKind, ...]] = {}
        self._result_kinds: list[NumberKind] = []  # of the function at hand, so far
        self._call_kinds: dict[int, tuple[ast.expr, tuple[NumberKind, ...]]] = {}  # of calls that were translated
        self._depth = 0  # of loops
        self._ends: list[str] = []  # of the loops around a statement, the variables that tell of `break`

    def function(self, tree: ast.FunctionDef, scope: FunctionScope) -> str:
        """Translate a function; return its name in the tree.

        Args:
            tree: the function.
            scope: what it knows at its start: the lengths of its arguments that are lists, the kinds of the others, and
                the names around it that an inner function reads, which it gets as arguments.
        """
        own, lengths = parameters_of(tree), scope.lists
        outer_names = [name for name in scope.names if name not in own]
        # a function is translated for each kind of arguments
        elements = [element_name(name, 0) if name in lengths else name for name in (*own, *outer_names)]
        pairs = zip((*own, *outer_names), elements, strict=True)
        kinds = [f"{name}:{lengths.get(name)}:{scope.kinds.get(element)}" for name, element in pairs]
        name = f"{tree.name}@{tree.lineno}({','.join(kinds)})"
        if name in self.functions:
            return name
        parameters = tuple(variable for each in (*own, *outer_names) for variable in _variables(each, scope))
        results = tuple(f"%return{at}" for at in range(self._result_count(tree)))
        # a call of itself ends there
        self.functions[name] = m.FunctionDefinition(name, parameters, results, ())
        around = self.scope, self._result_kinds, self._depth
        self.scope, self._result_kinds, self._depth = scope, [], 0
        scope.names = {*own, *outer_names, *stored_names(tree)}
        body = self._block(tree.body, results)
        self.kinds_of_results[name] = tuple(self._result_kinds)
        self.scope, self._result_kinds, self._depth = around
        self.functions[name] = m.FunctionDefinition(name, parameters, results, body)
        return name

    def _result_count(self, tree: ast.FunctionDef) -> int:
        if tree is self.source.tree:
            return len(self.source.results)
        counts = {len(e.value.elts) if isinstance(e.value, ast.Tuple) else 1 for e in returns_of(tree) if e.value}
        if len(counts) != 1:
            raise UntranslatableError(f"{tree.name} returns different numbers of values", tree.lineno)
        return counts.pop()

    # statements

    def _block(self, body: Sequence[ast.stmt], results: tuple[str, ...]) -> tuple[m.Statement, ...]:
        return tuple(statement for item in body for statement in self._statement(item, results))

    def _statement(self, tree: ast.stmt, results: tuple[str, ...]) -> list[m.Statement]:
        place = m.TextPosition(tree.lineno)
        match tree:
            case ast.Pass() | ast.Expr(value=ast.Constant()):
                return []
            case ast.Return(value=value) if value is not None:
                return [*self._return(value, results, tree), m.Jump("return", place=place)]
            case ast.Assign(targets=targets, value=value):
                return [statement for target in targets for statement in self._assign(target, value, place)]
            case ast.AnnAssign(target=target, value=value) if value is not None:
                return self._assign(target, value, place)
            case ast.AugAssign(target=target, op=op, value=value):
                read = ast.parse(ast.unparse(target), mode="eval").body
                combined = ast.copy_location(ast.BinOp(ast.copy_location(read, tree), op, value), tree)
                return self._assign(target, combined, place)
            case ast.If(test=test, body=body, orelse=otherwise):
                condition, before = self.value(test), dict(self.scope.kinds)
                branch = m.Branch(condition, self._block(body, results), place=place)
                kinds, self.scope.kinds = self.scope.kinds, before
                statement = m.If((branch,), self._block(otherwise, results), place=place)
                self.scope.kinds = _merged(kinds, self.scope.kinds)
                return [statement]
            case ast.While() | ast.For():
                return self._loop(tree, results, place)
            case ast.Raise():
                # arguments of an exception are texts, whose values change nothing
                unset = [m.Assign((m.Name(name),), m.Number(math.nan), place=place) for name in results]
                return [m.Evaluate(m.Call(m.Name("py:raise"), ()), place=place), *unset, m.Jump("return", place=place)]
            case ast.FunctionDef():
                return self._define(tree)
            case ast.Break():
                noted = self._ends[-1]
                mark = [m.Assign((m.Name(noted),), m.Number(1.0), place=place)] if noted else []
                return [*mark, m.Jump("break", place=place)]
            case ast.Continue():
                return [m.Jump("continue", place=place)]
        raise untranslated(tree)

    def _return(self, value: ast.expr, results: tuple[str, ...], tree: ast.stmt) -> list[m.Statement]:
        values = value.elts if isinstance(value, ast.Tuple) else [value]
        if len(values) != len(results):
            raise UntranslatableError("it returns several values", tree.lineno)
        place = m.TextPosition(tree.lineno)
        statements: list[m.Statement] = [
            m.Assign((m.Name(name),), self.value(item), place=place) for name, item in zip(results, values, strict=True)
        ]
        kinds = [self.kind(item) for item in values]
        before = self._result_kinds or kinds
        self._result_kinds = [merged_kind(pair) for pair in zip(before, kinds, strict=True)]
        return statements

    def _define(self, tree: ast.FunctionDef) -> list[m.Statement]:
        if tree.name in self.scope.inner or any(isinstance(node, ast.Nonlocal | ast.Global) for node in ast.walk(tree)):
            raise untranslated(tree)
        self.scope.inner[tree.name] = tree
        return []

    # assignments

    def _assign(self, target: ast.expr, value: ast.expr, place: m.TextPosition) -> list[m.Statement]:
        match target, value:
            case ast.Name(id=name), ast.Lambda():
                return self._define(as_function(name, value))
            case ast.Name(id=name), _:
                return self._assign_name(name, value, place)
            case ast.Tuple(), ast.Call() if self._called(value) is not None:
                names = target_names(target, len(target.elts))
                call = self._call_function(value, len(names))
                self._note_numbers(names, value)
                return [m.Assign(tuple(map(m.Name, names)), call, place=place)]
            case ast.Tuple(), _:
                values = self.elements(value) or []
                names = target_names(target, len(values))
                self._note_numbers(names, value)
                return self._assign_all(names, values, place)
            case ast.Subscript(value=ast.Name(id=name)), _ if name in self.scope.lists:
                element = self.element(target)
                if isinstance(element, m.Name):
                    self._note_kinds({element.name: self.kind(value)})
                    return [m.Assign((element,), self.value(value), place=place)]
        raise untranslated(target)

    def _assign_name(self, name: str, value: ast.expr, place: m.TextPosition) -> list[m.Statement]:
        items = None if isinstance(value, ast.Name) else self.elements(value)
        if items is None:
            # of two names for one list, an element assigned by one name would be missing from the other
            number = self.value(value)
            self._note_numbers([name], value)
            return [m.Assign((m.Name(name),), number, place=place)]
        if name in self.scope.numbers or self.scope.lists.get(name, len(items)) != len(items):
            raise UntranslatableError(f"{name} is a number and a list, or changes its length", place.line)
        kinds = (
            [self.kind(item) for item in value.elts]
            if isinstance(value, ast.List | ast.Tuple)
            else [self.element_kind(value)] * len(items)
        )
        self.scope.lists[name] = len(items)
        names = [element_name(name, at) for at in range(len(items))]
        self._note_kinds(dict(zip(names, kinds, strict=True)))
        return self._assign_all(names, items, place)

    def _note_numbers(self, names: Sequence[str], value: ast.expr) -> None:
        """Note which names are numbers, and of which kind."""
        self._check_numbers(names, value)
        kinds = self._call_kinds.get(id(value), (value, ()))[1]
        if isinstance(value, ast.Tuple | ast.List) and len(value.elts) == len(names):
            kinds = tuple(map(self.kind, value.elts))
        elif len(kinds) != len(names):
            kinds = (self.kind(value) if len(names) == 1 else self.element_kind(value),) * len(names)
        self._note_kinds(dict(zip(names, kinds, strict=True)))

    def _check_numbers(self, names: Sequence[str], value: ast.expr) -> None:
        if lists := [name for name in names if name in self.scope.lists]:
            raise UntranslatableError(f"{lists[0]} is a number and a list", value.lineno)
        self.scope.numbers.update(names)

    def _assign_all(
        self, names: Sequence[str], values: Sequence[m.Expression], place: m.TextPosition
    ) -> list[m.Statement]:
        """Assign values that are all computed before the first assignment, as in `a, b = b, a`."""
        # a single value, like numbers, reads nothing that is assigned before it
        kept, statements = self._kept(values, place) if len(values) > 1 else (values, [])
        assigned = zip(names, kept, strict=True)
        return [*statements, *(m.Assign((m.Name(name),), value, place=place) for name, value in assigned)]

    def _kept(
        self, values: Sequence[m.Expression], place: m.TextPosition
    ) -> tuple[list[m.Expression], list[m.Statement]]:
        """Return variables that keep values, and the statements that assign them; numbers stay as they are."""
        kept: list[m.Expression] = []
        statements: list[m.Statement] = []
        for value in values:
            if isinstance(value, m.Number):
                kept.append(value)
                continue
            variable = m.Name(f"%kept{next(self._numbers)}")
            statements.append(m.Assign((variable,), value, place=place))
            kept.append(variable)
        return kept, statements

    # loops

    def _loop(self, tree: ast.While | ast.For, results: tuple[str, ...], place: m.TextPosition) -> list[m.Statement]:
        """Translate a loop; what follows behind `else` runs unless `break` has ended it."""
        ended = f"%ended{next(self._numbers)}" if tree.orelse else ""
        self._ends.append(ended)
        loop = self._settled_loop(tree, results, place)
        self._ends.pop()
        if not ended:
            return loop
        branch = m.Branch(m.Unary("~", m.Name(ended)), self._block(tree.orelse, results), place=place)
        return [m.Assign((m.Name(ended),), m.Number(0.0), place=place), *loop, m.If((branch,), place=place)]

    def _settled_loop(
        self, tree: ast.While | ast.For, results: tuple[str, ...], place: m.TextPosition
    ) -> list[m.Statement]:
        """Translate a loop until the kinds of numbers at the start of a pass are those at the end of any."""
        self._depth += 1
        for _ in range(_MOST_KINDS):
            before, inner = dict(self.scope.kinds), dict(self.scope.inner)
            if isinstance(tree, ast.For):
                loop = self._for(tree, results, place)
            else:
                loop = [m.While(self.value(tree.test), self._block(tree.body, results), place=place)]
            if all(self.scope.kinds[name] == kind for name, kind in before.items()):
                break
            self.scope.inner = inner
        self._depth -= 1
        return loop

    def _note_kinds(self, kinds: dict[str, NumberKind]) -> None:
        """Note which kinds of numbers names hold from here on; within a loop, at the start of its passes as well."""
        self.scope.kinds = _merged(self.scope.kinds, kinds) if self._depth else self.scope.kinds | kinds

    def _for(self, tree: ast.For, results: tuple[str, ...], place: m.TextPosition) -> list[m.Statement]:
        match tree.target, tree.iter:
            case ast.Name(id=name), ast.Call(func=ast.Name(id="range"), args=args) if not self.scope.is_local("range"):
                span = self._range([self.value(item) for item in args], args, tree)
                self._note_numbers([name], tree.iter)
                self._note_kinds({name: "integer"})
                return [m.For(m.Name(name), span, self._block(tree.body, results), place=place)]
        rows = self.rows(tree.iter)
        if rows is None:
            raise untranslated(tree)
        names = target_names(tree.target, len(rows[0]) if rows else 1)
        self._check_numbers(names, tree.iter)
        self._note_kinds(self.kinds_of_targets(tree.target, tree.iter))
        at, start, body = m.Name(f"%pass{next(self._numbers)}"), list[m.Statement](), list[m.Statement]()
        for column, name in zip(zip(*rows, strict=True), names, strict=True) if rows else ():
            # a list is read pass by pass, as it is then; other expressions once, before the first pass
            items, statements = (list(column), []) if all(map(_is_element, column)) else self._kept(column, place)
            start += statements
            body.append(m.Assign((m.Name(name),), m.Call(m.Name("py:element"), (at, *items)), place=place))
        span = m.Range(m.Number(0.0), m.Number(1.0), m.Number(len(rows) - 1.0))
        return [*start, m.For(at, span, (*body, *self._block(tree.body, results)), place=place)]

    def _range(self, values: list[m.Expression], args: Sequence[ast.expr], tree: ast.stmt) -> m.Range:
        first = values[0] if len(values) > 1 else m.Number(0.0)
        step = number_of(args[2], self.source.constants) if len(values) > 2 else 1.0
        if not values or not step:
            raise UntranslatableError("the step of range is not a number", tree.lineno)
        # range ends before its limit, the range of the tree at it
        last = m.Binary("-", values[min(len(values) - 1, 1)], m.Number(math.copysign(1.0, step)))
        return m.Range(first, m.Number(float(step)), last)

    # calls

    def special_call(self, tree: ast.Call) -> m.Expression | None:
        """See `NumberTranslation`."""
        return self.sequence_call(tree) if self._called(tree) is None else self._call_function(tree, 1)

    def _called(self, tree: ast.Call) -> ast.FunctionDef | None:
        """Return the function of the file that a call leads to."""
        if not isinstance(tree.func, ast.Name):
            return None
        name = tree.func.id
        if name in self.scope.inner:
            return self.scope.inner[name]
        if self.scope.is_local(name):
            return None
        return self.source.functions.get(name) or self.source.closures.get(name)

    def _call_function(self, tree: ast.Call, results: int) -> m.Call:
        called = self._called(tree)
        assert called is not None
        if self._result_count(called) != results:
            raise UntranslatableError(f"{called.name} returns another number of values", tree.lineno)
        is_inner = isinstance(tree.func, ast.Name) and tree.func.id in self.scope.inner
        around = [*self._names_around(called)] if is_inner else []
        # names of the enclosing function become arguments in addition to its own
        arguments = [ast.copy_location(ast.Name(name, ast.Load()), tree) for name in around]
        scope = FunctionScope(names=set(around), inner=dict(self.scope.inner) if is_inner else {})
        passed: list[m.Expression] = []
        own = parameters_of(called)
        names = [*own, *(name for name in scope.names if name not in own)]
        by_name = dict(zip(around, arguments, strict=True)) | dict(
            zip(own, _arguments(called, tree, self.source.constants), strict=True)
        )
        for name in names:
            items = self.elements(by_name[name])
            passed += [self.value(by_name[name])] if items is None else items
            if items is not None:
                kind = self.element_kind(by_name[name])
                scope.kinds |= {element_name(name, at): kind for at in range(len(items))}
                scope.lists[name] = len(items)
                _check_kept(called, name)
            scope.kinds[name] = self.kind(by_name[name])
        name = self.function(called, scope)
        self._call_kinds[id(tree)] = tree, self.kinds_of_results.get(name, ())
        return m.Call(m.Name(name), tuple(passed))

    def _kind_of_call(self, tree: ast.Call) -> NumberKind:
        if self._called(tree) is None:
            return super()._kind_of_call(tree)
        kinds = self._call_kinds.get(id(tree), (tree, ()))[1]
        return kinds[0] if len(kinds) == 1 else "unknown"

    def _names_around(self, tree: ast.FunctionDef) -> Iterator[str]:
        """Yield the names of this function that an inner one reads, also through others that it calls."""
        waiting, seen = [tree], {tree.name}
        names: dict[str, None] = {}
        while waiting:
            for name in sorted(read_names(waiting.pop())):
                if name in self.scope.inner:
                    if name not in seen:
                        seen.add(name)
                        waiting.append(self.scope.inner[name])
                elif self.scope.is_local(name):
                    names[name] = None
        yield from names


def _merged(left: dict[str, NumberKind], right: dict[str, NumberKind]) -> dict[str, NumberKind]:
    """Return which kinds names hold behind one of two paths; a name that one of them does not assign has one kind."""
    return left | {name: merged_kind([kind, left.get(name, kind)]) for name, kind in right.items()}


def _variables(name: str, scope: FunctionScope) -> list[str]:
    """Return the variables of an argument: one for each element of a list."""
    return [element_name(name, at) for at in range(scope.lists[name])] if name in scope.lists else [name]


def _arguments(called: ast.FunctionDef, tree: ast.Call, constants: dict[str, float]) -> list[ast.expr]:
    """Return the arguments of a call in the order of the function, with its defaults."""
    names = parameters_of(called)
    if len(tree.args) > len(called.args.posonlyargs) + len(called.args.args) or any(
        isinstance(argument, ast.Starred) for argument in tree.args
    ):
        raise untranslated(tree)
    positional = names[: len(names) - len(called.args.kwonlyargs)]
    defaults = called.args.defaults
    values = dict(zip(positional[len(positional) - len(defaults) :], defaults, strict=True))
    by_keyword = zip(called.args.kwonlyargs, called.args.kw_defaults, strict=True)
    values |= {each.arg: default for each, default in by_keyword if default is not None}
    # Python computes a default where the function is defined: only a number is the same at each call
    if any(number_of(default, constants) is None for default in values.values()):
        raise UntranslatableError(f"a default of {called.name} is not a number", called.lineno)
    values |= dict(zip(names, tree.args, strict=False)) | {str(each.arg): each.value for each in tree.keywords}
    if set(values) != set(names):
        raise untranslated(tree)
    return [values[name] for name in names]


def _check_kept(called: ast.FunctionDef, name: str) -> None:
    """Raise `UntranslatableError` if a function changes a list that it is called with, which its caller would see."""
    for node in ast.walk(called):
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store) and ast.unparse(node.value) == name:
            raise UntranslatableError(f"{called.name} changes its argument {name}", node.lineno)


def _is_element(tree: m.Expression) -> bool:
    return isinstance(tree, m.Number) or (isinstance(tree, m.Name) and tree.name.endswith("]"))


@dataclass(frozen=True)
class TranslatedPython:
    """A function, with those that it calls, in the shared syntax tree."""

    name: str
    functions: dict[str, m.FunctionDefinition]

    def write(
        self,
        builder: GraphBuilder,
        arguments: Sequence[int],
        remark: Callable[[str, int], None] = lambda text, line: None,
    ) -> list[int]:
        """Add the nodes of a call to a graph; return those of the results. `remark` gets remarks with their lines."""
        context = EvaluationContext(builder, functions=dict(self.functions), library=LIBRARY, remark=remark)
        interpreter = StatementInterpreter(context)
        definition = self.functions[self.name]
        values = [np.array([[node]], dtype=np.int64) for node in arguments]
        results = interpreter.call(definition, values, len(definition.results))
        fails = reduce(partial(logical_or, builder), interpreter.state.failures, builder.const(0.0))
        nodes = [int(s.as_array(value, "its result").item()) for value in results]
        return [builder.call("select", fails, builder.const(math.nan), node) for node in nodes]


def translate(source: PythonFunction) -> tuple[TranslatedPython, tuple[Finding, ...]]:
    """Translate a function to a graph; return it with remarks.

    Raises:
        UntranslatableError: a graph cannot express it.
    """
    try:
        translation = PythonTranslation(source)
        name = translation.function(source.tree, FunctionScope())
        translated = TranslatedPython(name, translation.functions)
        builder = BoundedGraphBuilder()
        arguments = [builder.input(item.name) for item in source.inputs]
        lines: dict[str, int] = {}  # of each remark the first one
        translated.write(builder, arguments, lambda text, line: lines.update({text: lines.get(text, line)}))
    except ProgramError as error:
        raise UntranslatableError(error.message, error.line or source.tree.lineno) from None
    except (AbortedPathError, GraphTooLargeError, RecursionError):
        raise UntranslatableError("it is too large or nested too deeply", source.tree.lineno) from None
    remarks = tuple(Finding(Location(source.path.name, lines[text]), text, severity="remark") for text in lines)
    return translated, remarks
