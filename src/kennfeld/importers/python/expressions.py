"""Translation of expressions of Python that are numbers."""

import ast
import math
from collections.abc import Sequence
from functools import reduce
from typing import Final

from kennfeld.importers.python.mathematics import MAX_DIGITS, library_name
from kennfeld.importers.python.reading import PythonFunction, number_of
from kennfeld.importers.python.scope import FunctionScope, NumberKind, UntranslatableError, merged_kind, untranslated
from kennfeld.program import tree as m

_BINARY: Final[dict[type[ast.operator], str]] = {ast.Add: "+", ast.Sub: "-", ast.Mult: ".*"}
# operators that raise exceptions for some numbers of Python, and those that NumPy applies to its own
_PYTHON: Final[dict[type[ast.operator], str]] = {
    ast.Div: "py:divide", ast.Pow: "py:pow", ast.FloorDiv: "py:floor_divide", ast.Mod: "py:modulo",
}  # fmt: skip
_NUMPY: Final[dict[type[ast.operator], str]] = {
    ast.Pow: "c:pow", ast.FloorDiv: "py:numpy_floor_divide", ast.Mod: "py:numpy_modulo",
}  # fmt: skip
# operators whose results are exact for integers of Python, but not as doubles beyond 2^53
_INTEGER: Final[dict[type[ast.operator], str]] = {
    ast.Add: "py:integer_add", ast.Sub: "py:integer_sub", ast.Mult: "py:integer_mul", ast.Pow: "py:integer_pow",
}  # fmt: skip
_COMPARISONS: Final[dict[type[ast.cmpop], str]] = {
    ast.Eq: "==", ast.NotEq: "~=", ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=",
}  # fmt: skip
_CONSTANTS: Final = {"pi": math.pi, "e": math.e, "inf": math.inf, "nan": math.nan, "tau": math.tau}
_BUILT_IN: Final = ("abs", "min", "max", "float", "int", "bool", "pow", "round")
# functions whose results are integers, also of numbers of NumPy; `round` only without a number of digits
_WHOLE: Final = {
    ("builtins", "int"), ("builtins", "bool"), ("builtins", "round"), ("math", "floor"), ("math", "ceil"),
    ("math", "trunc"),
}  # fmt: skip
_PASSING: Final = ("abs", "min", "max", "pow", "round")  # whose results are of the kind of their arguments
_TRUTHS: Final = ("isnan", "isinf", "isfinite", "signbit")
_CONVERSIONS: Final = {("builtins", "float"), ("numpy", "float64")}


class NumberTranslation:
    """Translates expressions of a function; `scope` are the names of the function at hand."""

    def __init__(self, source: PythonFunction) -> None:
        self.source = source
        self.scope = FunctionScope()

    def special_call(self, tree: ast.Call) -> m.Expression | None:
        """Translate a call of a function of the file, or one that takes lists; None for others."""
        raise NotImplementedError

    def element(self, tree: ast.Subscript) -> m.Expression:
        """Translate an element of a list."""
        raise NotImplementedError

    def value(self, tree: ast.expr) -> m.Expression:
        """Translate an expression to a number."""
        number = number_of(tree, {}) if isinstance(tree, ast.Constant | ast.UnaryOp) else None
        match tree:
            case ast.Constant() | ast.UnaryOp() if number is not None:
                return m.Number(float(number))
            case ast.Name(id=name) if name in self.scope.fixed:
                return self.scope.fixed[name]
            case ast.Name(id=name) if name in self.scope.names and name not in self.scope.lists:
                return m.Name(name)
            case ast.Name(id=name) if name in self.source.constants and not self.scope.is_local(name):
                return m.Number(float(self.source.constants[name]))
            case ast.Name() | ast.Attribute() if self.qualified(tree)[1] in _CONSTANTS:
                return m.Number(_CONSTANTS[self.qualified(tree)[1]])
            case ast.Attribute() if (path := ast.unparse(tree)) in self.source.constants and self._is_of_file(path):
                return m.Number(float(self.source.constants[path]))
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() | ast.Not() as op, operand=operand):
                sign = {ast.USub: "-", ast.UAdd: "+", ast.Not: "~"}[type(op)]
                return m.Unary(sign, self.value(operand))
            case ast.BinOp():
                return self._binary(tree)
            case ast.Compare(left=left, ops=ops, comparators=comparators):
                return self._compare([left, *comparators], ops, tree)
            case ast.BoolOp(op=op, values=values):
                return self._of_truths(op, values)
            case ast.IfExp(test=test, body=yes, orelse=no):
                return m.Conditional(self.value(test), self.value(yes), self.value(no))
            case ast.Subscript():
                return self.element(tree)
            case ast.Call():
                return self._call(tree)
        raise untranslated(tree)

    def _is_of_file(self, path: str) -> bool:
        return not self.scope.is_local(path.partition(".")[0])

    def _of_truths(self, op: ast.boolop, values: list[ast.expr]) -> m.Expression:
        """Translate `a and b` and `a or b`, whose value is that of the side that decides."""
        items = [self.value(value) for value in values]
        is_and = isinstance(op, ast.And)
        if all(_is_truth(value) for value in values):
            return reduce(lambda a, b: m.Binary("&&" if is_and else "||", a, b), items)
        return reduce(lambda rest, a: m.Conditional(a, *((rest, a) if is_and else (a, rest))), items[::-1])

    def kind(self, tree: ast.expr) -> NumberKind:
        """Return which kind of number an expression is, as far as the text tells."""
        match tree:
            case ast.Constant(value=int()):
                return "integer"
            case ast.Name(id=name) if self.scope.is_local(name):
                return self.scope.kinds.get(name, "float")
            case ast.Name(id=name):
                return "integer" if isinstance(self.source.constants.get(name), int) else "float"
            case ast.Compare(left=left, comparators=others):
                return "numpy truth" if self._common_kind([left, *others]) == "numpy" else "integer"
            case ast.UnaryOp(op=ast.Not()):
                return "integer"
            case ast.UnaryOp(operand=operand):
                return self.kind(operand)
            case ast.BinOp(left=left, op=op, right=right):
                kind = self._common_kind([left, right])
                return "float" if kind == "integer" and isinstance(op, ast.Div) else kind
            case ast.IfExp(body=yes, orelse=no):
                return self._kind_of_any([yes, no])
            case ast.BoolOp(values=values):
                return self._kind_of_any(values)
            case ast.Attribute():
                return "integer" if isinstance(self.source.constants.get(ast.unparse(tree)), int) else "float"
            case ast.Call():
                return self._kind_of_call(tree)
            case ast.Subscript(value=of):
                return self.element_kind(of)
        return "float"

    def _kind_of_any(self, trees: list[ast.expr]) -> NumberKind:
        return merged_kind(map(self.kind, trees))

    def element_kind(self, tree: ast.expr) -> NumberKind:
        """Return which kind of numbers a list has."""
        raise NotImplementedError

    def _kind_of_call(self, tree: ast.Call) -> NumberKind:
        module, name = self.qualified(tree.func)
        if module == "numpy":
            return "numpy truth" if name in _TRUTHS else "numpy"
        if (module, name) in _WHOLE and len(tree.args) == 1:
            return "integer"
        if module == "builtins" and name in ("min", "max", "sum") and len(tree.args) == 1:
            return self.element_kind(tree.args[0])
        if module == "builtins" and name in ("min", "max"):
            return self._kind_of_any(tree.args)
        passes_on = module == "builtins" and name in _PASSING and tree.args
        return self._common_kind(tree.args) if passes_on else "float"

    def _common_kind(self, trees: Sequence[ast.expr]) -> NumberKind:
        """Return the kind of a result of numbers of several kinds."""
        kinds = {self.kind(tree) for tree in trees}
        if kinds & {"numpy", "numpy truth"}:  # whatever the others are
            return "numpy"
        if "unknown" in kinds:
            return "unknown"
        return "integer" if kinds == {"integer"} else "float"

    def _binary(self, tree: ast.BinOp) -> m.Expression:
        op, left, right = type(tree.op), self.value(tree.left), self.value(tree.right)
        kind = self.kind(tree)
        if self.kind(tree.left) == self.kind(tree.right) == "numpy truth":
            raise UntranslatableError(f"{ast.unparse(tree)[:40]} adds up truth values of NumPy", tree.lineno)
        if kind == "unknown" and op in (*_PYTHON, *_NUMPY):
            message = f"{ast.unparse(tree)[:40]} is computed by NumPy on some paths and by Python on others"
            raise UntranslatableError(message, tree.lineno)
        if kind == "integer" and op in _INTEGER:
            return m.Call(m.Name(_INTEGER[op]), (left, right, m.Number(float(tree.lineno))))
        if kind == "integer" and op is ast.Mod:
            return m.Call(m.Name("py:integer_modulo"), (left, right))
        names = _NUMPY if kind == "numpy" else _PYTHON
        if op in names:
            return m.Call(m.Name(names[op]), (left, right))
        # of what is left, only a division of NumPy's numbers is an operator of its own
        sign = _BINARY.get(op, "./" if op is ast.Div else "")
        if not sign:
            raise untranslated(tree)
        return m.Binary(sign, left, right)

    def _compare(self, parts: list[ast.expr], ops: list[ast.cmpop], tree: ast.expr) -> m.Expression:
        if not all(type(op) in _COMPARISONS for op in ops):
            raise untranslated(tree)
        values = [self.value(part) for part in parts]
        # a < b < c is a < b and b < c
        pairs = [m.Binary(_COMPARISONS[type(op)], a, b) for op, a, b in zip(ops, values[:-1], values[1:], strict=True)]
        return reduce(lambda a, b: m.Binary("&&", a, b), pairs)

    def qualified(self, tree: ast.expr) -> tuple[str, str]:
        """Return the module and the name of a function or constant of a library; empty for those of the file."""
        names = ast.unparse(tree).split(".")
        if self.scope.is_local(names[0]) or len(names) > 2:
            return "", ""
        if names[0] in _BUILT_IN and len(names) == 1 and names[0] not in self.source.modules:
            return "builtins", names[0]
        whole = ".".join((self.source.modules.get(names[0], ""), *names[1:]))
        owner, _, name = whole.rpartition(".")
        return (owner, name) if owner in ("math", "numpy") else ("", "")

    def _call(self, tree: ast.Call) -> m.Expression:
        result = self.special_call(tree)
        if result is not None:
            return result
        module, name = self.qualified(tree.func)
        if tree.keywords or not module or not tree.args:
            raise untranslated(tree)
        arguments = [self.value(item) for item in tree.args]
        if (module, name) in _CONVERSIONS and len(arguments) == 1:
            return arguments[0]
        return self._composed(module, name, arguments, tree) or self._library(module, name, arguments, tree)

    def _library(self, module: str, name: str, arguments: list[m.Expression], tree: ast.Call) -> m.Expression:
        plain = library_name(module, name, len(arguments))
        if not plain:
            raise untranslated(tree)
        return m.Call(m.Name(plain), tuple(arguments))

    def _composed(self, module: str, name: str, arguments: list[m.Expression], tree: ast.Call) -> m.Expression | None:
        """Return functions of another number of arguments than those of the library; None for others."""
        match module, name, arguments:
            case "numpy", "where", [condition, yes, no]:
                return m.Conditional(condition, yes, no)
            case "numpy", "clip", [x, low, high]:
                return m.Call(m.Name("py:minimum"), (m.Call(m.Name("py:maximum"), (x, low)), high))
            case "builtins", ("min" | "max"), [_, _, _, *_]:
                return fold(f"py:{name}", arguments)
            case "builtins", "bool", [x]:
                return m.Binary("~=", x, m.Number(0.0))
            case "numpy", "square", [x]:
                return m.Binary(".*", x, x)
            case "math", "log", [x, base]:
                return m.Call(m.Name("py:logarithm"), (x, base))
            case ("builtins", "round", [x, digits]) | ("numpy", ("round" | "around"), [x, digits]):
                return self._round(module, x, digits, tree)
        return None

    def _round(self, module: str, x: m.Expression, digits: m.Expression, tree: ast.Call) -> m.Expression:
        places = number_of(tree.args[1], self.source.constants)
        if places is None or places != math.floor(places) or abs(places) > MAX_DIGITS:
            raise untranslated(tree)
        is_numpy = module == "numpy" or self.kind(tree.args[0]) == "numpy"
        name = "py:round_by_product" if is_numpy else "py:round_to_digits"
        return m.Call(m.Name(name), (x, m.Number(float(places))))


def fold(name: str, values: list[m.Expression]) -> m.Expression:
    """Return a function of two arguments of the library, applied to values from first to last."""
    return reduce(lambda a, b: m.Call(m.Name(name), (a, b)), values)


def _is_truth(tree: ast.expr) -> bool:
    """Return True if a value is True or False, so that `and` and `or` return the same as conditions."""
    if isinstance(tree, ast.BoolOp):
        return all(_is_truth(value) for value in tree.values)
    return isinstance(tree, ast.Compare) or (isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.Not))
