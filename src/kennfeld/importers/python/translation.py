"""Translation of functions in Python to the shared syntax tree: numbers, conditions, loops and mathematics."""

import ast
import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Final

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import BoundedGraphBuilder, GraphBuilder, GraphTooLargeError
from kennfeld.importers.c.functions import LIBRARY, MATHEMATICS
from kennfeld.importers.python.reading import PythonFunction, number_of
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import EvaluationContext
from kennfeld.models.imperative.evaluation_errors import AbortedPathError, ProgramError
from kennfeld.models.imperative.statement_interpreter import StatementInterpreter
from kennfeld.program import tree as m

_BINARY: Final[dict[type[ast.operator], str]] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: ".*", ast.Div: "./", ast.Pow: ".^",
}  # fmt: skip
_COMPARISONS: Final[dict[type[ast.cmpop], str]] = {
    ast.Eq: "==", ast.NotEq: "~=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
}  # fmt: skip
_CONSTANTS: Final = {"pi": math.pi, "e": math.e, "inf": math.inf, "nan": math.nan, "tau": math.tau}
_NAMES: Final = {
    "arcsin": "asin", "arccos": "acos", "arctan": "atan", "arctan2": "atan2", "arcsinh": "asinh", "arccosh": "acosh",
    "arctanh": "atanh", "abs": "fabs", "absolute": "fabs", "power": "pow", "fix": "trunc", "float": "", "int": "trunc",
    "minimum": "fmin", "maximum": "fmax", "float64": "", "min": "fmin", "max": "fmax",
}  # fmt: skip
_BUILT_IN: Final = ("abs", "min", "max", "float", "int", "pow")
_NOT_SAME: Final = ("round",)  # Python rounds halves to even


class UntranslatableError(Exception):
    """Python that a graph cannot express; `line` is its line."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message)
        self.message, self.line = message, line


class PythonTranslation:
    """Translates a function of a file, and those that it calls."""

    def __init__(self, source: PythonFunction) -> None:
        self.source = source
        self.functions: dict[str, m.FunctionDefinition] = {}
        self._names: set[str] = set()

    def function(self, tree: ast.FunctionDef) -> str:
        """Translate a function; return its name in the tree."""
        name = f"{tree.name}()"
        if name in self.functions:
            return name
        arguments = tree.args
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs or tree.decorator_list:
            raise UntranslatableError(f"{tree.name} has decorators or special arguments", tree.lineno)
        parameters = tuple(item.arg for item in (*arguments.posonlyargs, *arguments.args))
        self.functions[name] = m.FunctionDefinition(name, parameters, (), ())  # a call of itself ends there
        outer, self._names = self._names, {*parameters, *_stored(tree)}
        count = len(self.source.results) if tree is self.source.tree else 1
        results = tuple(f"%return{at}" for at in range(count))
        body = self._block(tree.body, results)
        self._names = outer
        self.functions[name] = m.FunctionDefinition(name, parameters, results, body)
        return name

    # statements

    def _block(self, body: Sequence[ast.stmt], results: tuple[str, ...]) -> tuple[m.Statement, ...]:
        return tuple(statement for item in body for statement in self._statement(item, results))

    def _statement(self, tree: ast.stmt, results: tuple[str, ...]) -> list[m.Statement]:
        place = m.TextPosition(tree.lineno)
        match tree:
            case ast.Pass() | ast.Expr(value=ast.Constant()):
                return []
            case ast.Return(value=value) if value is not None:
                values = value.elts if isinstance(value, ast.Tuple) else [value]
                if len(values) != len(results):
                    raise UntranslatableError("it returns several values", tree.lineno)
                pairs = zip(results, values, strict=True)
                assigned = [m.Assign((m.Name(name),), self.value(item), place=place) for name, item in pairs]
                return [*assigned, m.Jump("return", place=place)]
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                return [m.Assign((m.Name(name),), self.value(value), place=place)]
            case ast.AnnAssign(target=ast.Name(id=name), value=value) if value is not None:
                return [m.Assign((m.Name(name),), self.value(value), place=place)]
            case ast.AugAssign(target=ast.Name(id=name), op=op, value=value):
                combined = ast.BinOp(ast.Name(name, ast.Load()), op, value)
                return [m.Assign((m.Name(name),), self.value(ast.copy_location(combined, tree)), place=place)]
            case ast.If(test=test, body=body, orelse=otherwise):
                branch = m.Branch(self.value(test), self._block(body, results), place=place)
                return [m.If((branch,), self._block(otherwise, results), place=place)]
            case ast.While(test=test, body=body, orelse=[]):
                return [m.While(self.value(test), self._block(body, results), place=place)]
            case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=args), orelse=[]):
                span = self._range([self.value(item) for item in args], args, tree)
                return [m.For(m.Name(name), span, self._block(tree.body, results), place=place)]
            case ast.Break():
                return [m.Jump("break", place=place)]
            case ast.Continue():
                return [m.Jump("continue", place=place)]
        raise UntranslatableError(f"{ast.unparse(tree)[:40].splitlines()[0]} is not translated", tree.lineno)

    def _range(self, values: list[m.Expression], args: Sequence[ast.expr], tree: ast.stmt) -> m.Range:
        first = values[0] if len(values) > 1 else m.Number(0.0)
        step = number_of(args[2], self.source.constants) if len(values) > 2 else 1.0
        if not values or not step:
            raise UntranslatableError("the step of range is not a number", tree.lineno)
        # range ends before its limit, the range of the tree at it
        last = m.Binary("-", values[min(len(values) - 1, 1)], m.Number(math.copysign(1.0, step)))
        return m.Range(first, m.Number(step), last)

    # expressions

    def value(self, tree: ast.expr) -> m.Expression:
        """Translate an expression to a number."""
        number = number_of(tree, {}) if isinstance(tree, ast.Constant) else None
        match tree:
            case ast.Constant() if number is not None:
                return m.Number(number)
            case ast.Name(id=name) if name in self._names:
                return m.Name(name)
            case ast.Name(id=name) if name in self.source.constants:
                return m.Number(self.source.constants[name])
            case ast.Name() | ast.Attribute() if (constant := self._qualified(tree)) in _CONSTANTS:
                return m.Number(_CONSTANTS[constant])
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() | ast.Not() as op, operand=operand):
                sign = {ast.USub: "-", ast.UAdd: "+", ast.Not: "~"}[type(op)]
                return m.Unary(sign, self.value(operand))
            case ast.BinOp(left=left, op=op, right=right):
                return self._binary(op, self.value(left), self.value(right), tree)
            case ast.Compare(left=left, ops=ops, comparators=comparators):
                return self._compare([left, *comparators], ops, tree)
            case ast.BoolOp(op=op, values=values) if all(_is_truth(value) for value in values):
                sign = "&&" if isinstance(op, ast.And) else "||"
                return reduce(lambda a, b: m.Binary(sign, a, b), map(self.value, values))
            case ast.IfExp(test=test, body=yes, orelse=no):
                return m.Conditional(self.value(test), self.value(yes), self.value(no))
            case ast.Call(keywords=[]):
                return self._call(tree)
        raise UntranslatableError(f"{ast.unparse(tree)[:40]} is not translated", tree.lineno)

    def _binary(self, op: ast.operator, left: m.Expression, right: m.Expression, tree: ast.expr) -> m.Expression:
        if type(op) in _BINARY:
            return m.Binary(_BINARY[type(op)], left, right)
        whole = m.Call(m.Name("c:floor"), (m.Binary("./", left, right),))
        if isinstance(op, ast.FloorDiv):
            return whole
        if isinstance(op, ast.Mod):
            # a - floor(a / b) b has the sign of b, as in Python
            return m.Binary("-", left, m.Binary(".*", whole, right))
        raise UntranslatableError(f"{ast.unparse(tree)[:40]} is not translated", tree.lineno)

    def _compare(self, parts: list[ast.expr], ops: list[ast.cmpop], tree: ast.expr) -> m.Expression:
        if not all(type(op) in _COMPARISONS for op in ops):
            raise UntranslatableError(f"{ast.unparse(tree)[:40]} is not translated", tree.lineno)
        values = [self.value(part) for part in parts]
        # a < b < c is a < b and b < c
        pairs = [m.Binary(_COMPARISONS[type(op)], a, b) for op, a, b in zip(ops, values[:-1], values[1:], strict=True)]
        return reduce(lambda a, b: m.Binary("&&", a, b), pairs)

    def _qualified(self, tree: ast.expr) -> str:
        """Return the name of a function or constant of `math` or `numpy` without its module; else empty."""
        names = ast.unparse(tree).split(".")
        if names[0] in self._names or not 0 < len(names) < 3:
            return ""
        module = self.source.modules.get(names[0], "")
        whole = ".".join((module, *names[1:])) if module else ""
        owner, _, name = whole.rpartition(".")
        return name if owner in ("math", "numpy") else ""

    def _call(self, tree: ast.Call) -> m.Expression:
        if isinstance(tree.func, ast.Name) and tree.func.id in self.source.functions:
            called = self.source.functions[tree.func.id]
            if len(tree.args) != len(called.args.args) + len(called.args.posonlyargs):
                raise UntranslatableError(f"{called.name} is called with defaults", tree.lineno)
            return m.Call(m.Name(self.function(called)), tuple(map(self.value, tree.args)))
        name = self._qualified(tree.func)
        if not name and isinstance(tree.func, ast.Name) and tree.func.id in _BUILT_IN:
            name = tree.func.id
        arguments = [self.value(item) for item in tree.args]
        if result := self._composed(name, arguments):
            return result
        plain = _NAMES.get(name, name)
        if not name or name in _NOT_SAME or (plain and MATHEMATICS.get(plain) != len(arguments)) or not arguments:
            raise UntranslatableError(f"{ast.unparse(tree.func)[:40]} is not translated", tree.lineno)
        return m.Call(m.Name(f"c:{plain}"), tuple(arguments)) if plain else arguments[0]

    def _composed(self, name: str, arguments: list[m.Expression]) -> m.Expression | None:
        """Return functions that are not of C's library; None for others."""
        pair: Callable[[str], Callable[[m.Expression, m.Expression], m.Expression]] = lambda op: (  # noqa: E731
            lambda a, b: m.Call(m.Name(f"c:{op}"), (a, b))
        )
        match name, arguments:
            case "where", [condition, yes, no]:
                return m.Conditional(condition, yes, no)
            case "clip", [x, low, high]:
                return pair("fmin")(pair("fmax")(x, low), high)
            case (("min" | "max"), [_, _, _, *_]):
                return reduce(pair(f"f{name}"), arguments)
            case "square", [x]:
                return m.Binary(".*", x, x)
        return None


@dataclass(frozen=True)
class TranslatedPython:
    """A function, with those that it calls, in the shared syntax tree."""

    name: str
    functions: dict[str, m.FunctionDefinition]

    def write(self, builder: GraphBuilder, arguments: Sequence[int]) -> list[int]:
        """Add the nodes of a call to a graph; return those of the results."""
        context = EvaluationContext(builder, functions=dict(self.functions), library=LIBRARY)
        interpreter = StatementInterpreter(context)
        definition = self.functions[self.name]
        values = [np.array([[node]], dtype=np.int64) for node in arguments]
        results = interpreter.call(definition, values, len(definition.results))
        return [int(s.as_array(value, "its result").item()) for value in results]


def translate(source: PythonFunction) -> TranslatedPython:
    """Translate a function to a graph.

    Raises:
        UntranslatableError: a graph cannot express it.
    """
    try:
        translation = PythonTranslation(source)
        name = translation.function(source.tree)
        translated = TranslatedPython(name, translation.functions)
        builder = BoundedGraphBuilder()
        translated.write(builder, [builder.input(item.name) for item in source.inputs])
    except ProgramError as error:
        raise UntranslatableError(error.message, error.line or source.tree.lineno) from None
    except (AbortedPathError, GraphTooLargeError, RecursionError):
        raise UntranslatableError("it is too large or nested too deeply", source.tree.lineno) from None
    return translated


def _stored(tree: ast.FunctionDef) -> set[str]:
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def _is_truth(tree: ast.expr) -> bool:
    """Return True if a value is True or False, so that `and` and `or` return the same as conditions."""
    if isinstance(tree, ast.BoolOp):
        return all(_is_truth(value) for value in tree.values)
    return isinstance(tree, ast.Compare) or (isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.Not))
