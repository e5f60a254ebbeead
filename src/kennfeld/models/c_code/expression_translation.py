"""Translation of C expressions to the shared syntax tree, with their types."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from pycparser import c_ast

from kennfeld.lazy_dataclass import dataclass
from kennfeld.matlab import syntax as m
from kennfeld.models.c_code.declarations import CFile, Variable, integer_literal, line_of
from kennfeld.models.c_code.functions import MATHEMATICS, TESTS
from kennfeld.models.c_code.number_types import (
    BOOL,
    DOUBLE,
    FLOAT,
    INT,
    LONG,
    UNSIGNED,
    CType,
    UnsupportedCError,
    common_type,
    holds,
    number_type,
    promoted,
)

_COMPARISONS: Final = {"==": "==", "!=": "~=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}
_BITS: Final = {"&": "and", "|": "or", "^": "xor"}
_SPECIAL: Final = {"__infinity": float("inf"), "__nan": float("nan")}


@dataclass(frozen=True)
class Operand:
    """A number: the tree that calculates it, and its type."""

    tree: m.Expression
    type: CType


def call_of(name: str, *arguments: m.Expression) -> m.Call:
    """Return a call of a function of the library."""
    return m.Call(m.Name(f"c:{name}"), arguments)


def converted(operand: Operand, target: CType) -> m.Expression:
    """Return the number in another type: cut off towards zero, then the lowest bits."""
    source = operand.type
    if target.word is None or target == source:
        return operand.tree
    if target.truth:
        return m.Binary("~=", operand.tree, m.Number(0.0))
    if source.word is not None and holds(target.word, source.word):
        return operand.tree
    if isinstance(operand.tree, m.Number) and operand.tree.value == operand.tree.value:
        return m.Number(float(target.word.wrapped(int(max(min(operand.tree.value, 2.0**64), -(2.0**64))))))
    whole = operand.tree if source.word is not None else call_of("truncate", operand.tree)
    return _wrapped("wrap", target, whole)


def _wrapped(name: str, kind: CType, *operands: m.Expression) -> m.Expression:
    assert kind.word is not None
    return call_of(name, *operands, m.Number(float(kind.word.bits)), m.Number(float(kind.word.signed)))


class ExpressionTranslation:
    """Translates expressions of a function; `pending` are statements that must run before the expression."""

    def __init__(self, file: CFile) -> None:
        self.file = file
        self.scopes: list[dict[str, Variable | int]] = [{}]
        self.pending: list[m.Statement] = []
        self.statics_used: dict[str, None] = {}
        self.calls: dict[str, None] = {}
        self.remarks: dict[str, None] = {}
        self._lazy = 0
        self._temporaries = 0

    def lookup(self, name: str, tree: c_ast.Node) -> Variable | int:
        """Return the variable, or the constant of an enumeration, of a name."""
        for scope in reversed(self.scopes):
            if name in scope:
                variable = scope[name]
                if isinstance(variable, Variable) and variable.is_static:
                    self.statics_used[variable.name] = None
                return variable
        if name in self.file.constants:
            return self.file.constants[name]
        raise UnsupportedCError(f"unknown name {name}", line_of(tree), wrong=True)

    def operand(self, tree: c_ast.Node) -> Operand:
        """Translate an expression to a number."""
        try:
            return self._operand(tree)
        except UnsupportedCError as error:
            raise error if error.line else UnsupportedCError(error.message, line_of(tree), wrong=error.wrong) from None

    def _operand(self, tree: c_ast.Node) -> Operand:
        match tree:
            case c_ast.Constant(type=kind, value=text):
                return _literal(kind, text)
            case c_ast.ID(name=name) if name in _SPECIAL:
                return Operand(m.Number(_SPECIAL[name]), DOUBLE)
            case c_ast.ID() | c_ast.ArrayRef() | c_ast.UnaryOp(op="*"):
                return self._read(tree)
            case c_ast.UnaryOp(op=("++" | "--" | "p++" | "p--") as op, expr=target):
                return self._step(op, target, tree)
            case c_ast.UnaryOp(op=op, expr=expr):
                return self._unary(op, expr)
            case c_ast.BinaryOp():
                return self._binary(tree)
            case c_ast.TernaryOp(cond=condition, iftrue=yes, iffalse=no):
                return self._conditional(condition, yes, no)
            case c_ast.Cast(to_type=target, expr=expr):
                return self._cast(target, expr)
            case c_ast.Assignment():
                self._eager("an assignment")
                self.pending += self.assignment(tree)
                return self._read(tree.lvalue)
            case c_ast.ExprList(exprs=exprs):
                return [self.operand(expr) for expr in exprs][-1]
            case c_ast.FuncCall():
                return self.call(tree)
        raise UnsupportedCError(f"{_kind(tree)} is not supported", line_of(tree))

    def _eager(self, what: str) -> None:
        if self._lazy:
            raise UnsupportedCError(f"{what} under a condition within an expression is not supported")

    def lazily(self, translate: Callable[[], Operand]) -> Operand:
        """Translate an expression that is evaluated only under a condition."""
        self._lazy += 1
        try:
            return translate()
        finally:
            self._lazy -= 1

    # variables

    def place(self, tree: c_ast.Node) -> tuple[m.Expression, Variable]:
        """Return the target tree of a number in a variable, and the variable."""
        match tree:
            case c_ast.ID(name=name):
                variable = self.lookup(name, tree)
                if isinstance(variable, int):
                    raise UnsupportedCError(f"{name} is a constant", wrong=True)
                if variable.is_pointer or variable.sizes:
                    raise UnsupportedCError(f"{name} is an address, which is not supported here")
                return m.Name(variable.name), variable
            case c_ast.UnaryOp(op="*", expr=c_ast.ID() as name):
                return self._element(self._array(name), [])
            case c_ast.ArrayRef():
                indices: list[c_ast.Node] = []
                of: c_ast.Node = tree
                while isinstance(of, c_ast.ArrayRef):
                    indices.insert(0, of.subscript)
                    of = of.name
                if isinstance(of, c_ast.ID):
                    return self._element(self._array(of), indices)
        raise UnsupportedCError(f"{_kind(tree)} is not supported here", line_of(tree))

    def _array(self, tree: c_ast.ID) -> Variable:
        variable = self.lookup(tree.name, tree)
        if isinstance(variable, int) or not (variable.is_pointer or variable.sizes):
            raise UnsupportedCError(f"{tree.name} is a number, not an array or address", line_of(tree), wrong=True)
        return variable

    def _element(self, variable: Variable, indices: Sequence[c_ast.Node]) -> tuple[m.Expression, Variable]:
        if variable.is_pointer and not variable.is_array:
            return m.Name(variable.name), variable
        count = max(len(variable.sizes), 1)
        if len(indices) not in (count, 0) or (not indices and count > 1):
            raise UnsupportedCError(f"{variable.name} has {count} dimensions, got {len(indices)} indices")
        at = tuple(self._index(self.operand(index)) for index in indices) or (m.Number(1.0),)
        return m.Call(m.Name(variable.name), at), variable

    def _index(self, operand: Operand) -> m.Expression:
        if operand.type.word is None:
            raise UnsupportedCError("an index must be an integer", wrong=True)
        if isinstance(operand.tree, m.Number):
            return m.Number(operand.tree.value + 1.0)
        return m.Binary("+", operand.tree, m.Number(1.0))

    def _read(self, tree: c_ast.Node) -> Operand:
        if isinstance(tree, c_ast.ID) and isinstance(number := self.lookup(tree.name, tree), int):
            return Operand(m.Number(float(number)), INT)
        target, variable = self.place(tree)
        return Operand(target, variable.type)

    def assigned(self, target: c_ast.Node, operand: Operand, line: int) -> m.Assign:
        """Return the statement that assigns a number."""
        tree, variable = self.place(target)
        if variable.is_constant:
            raise UnsupportedCError(f"{variable.name} is const and cannot be assigned", line, wrong=True)
        if variable.type is FLOAT:
            self.remarks["float is computed in double precision"] = None
        return m.Assign((tree,), converted(operand, variable.type), place=m.SourcePosition(line))

    def assignment(self, tree: c_ast.Assignment) -> list[m.Statement]:
        """Return the statements of `target op= value`, behind those that its value needs."""
        operand = self.operand(tree.rvalue)
        if tree.op != "=":
            operand = self._combined(tree.op[:-1], self._read(tree.lvalue), operand)
        statement = self.assigned(tree.lvalue, operand, line_of(tree))
        pending, self.pending = self.pending, []
        return [*pending, statement]

    def _step(self, op: str, target: c_ast.Node, tree: c_ast.Node) -> Operand:
        """Translate ++ and --; with the operator behind it, the value is that before."""
        self._eager("++ or --")
        before = self._read(target)
        if op.startswith("p"):
            name = self.temporary()
            self.pending.append(m.Assign((m.Name(name),), before.tree, place=m.SourcePosition(line_of(tree))))
        self.pending.append(self.stepped(op, target, line_of(tree)))
        return Operand(m.Name(name), before.type) if op.startswith("p") else self._read(target)

    def stepped(self, op: str, target: c_ast.Node, line: int) -> m.Assign:
        """Return the statement of ++ or --."""
        operand = self._combined(op[-1], self._read(target), Operand(m.Number(1.0), INT))
        return self.assigned(target, operand, line)

    def temporary(self) -> str:
        """Return the name of a new local variable."""
        self._temporaries += 1
        return f"%{self._temporaries}"

    # operators

    def _unary(self, op: str, expr: c_ast.Node) -> Operand:
        operand = self.operand(expr)
        kind = promoted(operand.type)
        match op:
            case "+":
                return Operand(operand.tree, kind)
            case "-" if isinstance(operand.tree, m.Number) and (kind.word is None or kind.word.signed):
                return Operand(m.Number(-operand.tree.value), kind)
            case "-":
                return self._fitted(m.Unary("-", operand.tree), kind)
            case "!":
                return Operand(m.Unary("~", operand.tree), INT)
            case "~" if kind.word is not None and kind.word.bits <= 32:
                top = m.Number(-1.0 if kind.word.signed else 2.0**kind.word.bits - 1.0)
                return Operand(m.Binary("-", top, operand.tree), kind)
        raise UnsupportedCError(f"the operator {op} is not supported here")

    def _fitted(self, tree: m.Expression, kind: CType) -> Operand:
        """Return the result of an operation, which wraps in integer types."""
        if kind.word is None:
            return Operand(tree, kind)
        if kind.word.bits > 32:
            if not kind.word.signed:
                raise UnsupportedCError("arithmetic of unsigned 64-bit integers is not supported")
            self.remarks["64-bit integers are exact up to 2^53"] = None
            return Operand(tree, kind)
        return Operand(_wrapped("wrap", kind, tree), kind)

    def _binary(self, tree: c_ast.BinaryOp) -> Operand:
        if tree.op in ("&&", "||"):
            left = self.operand(tree.left)
            right = self.lazily(lambda: self.operand(tree.right))
            return Operand(m.Binary(tree.op, left.tree, right.tree), INT)
        return self._combined(tree.op, self.operand(tree.left), self.operand(tree.right))

    def _combined(self, op: str, left: Operand, right: Operand) -> Operand:
        kind = common_type(left.type, right.type)
        if op in ("<<", ">>"):
            return self._shifted(op, left, right)
        a, b = converted(left, kind), converted(right, kind)
        if op in _COMPARISONS:
            return Operand(m.Binary(_COMPARISONS[op], a, b), INT)
        if op in _BITS:
            if kind.word is None or kind.word.bits > 32:
                raise UnsupportedCError(f"{op} of {kind.name} is not supported", wrong=kind.word is None)
            return Operand(_wrapped(_BITS[op], kind, a, b), kind)
        if kind.word is None:
            if op == "%":
                raise UnsupportedCError("% requires integers, use fmod", wrong=True)
            return Operand(m.Binary({"*": ".*", "/": "./"}.get(op, op), a, b), kind)
        match op:
            case "*" if kind.word.bits <= 32:
                return Operand(_wrapped("multiply", kind, a, b), kind)
            case "/" | "%":
                return self._fitted(call_of("quotient" if op == "/" else "remainder", a, b), kind)
            case "+" | "-" | "*":
                return self._fitted(m.Binary(".*" if op == "*" else op, a, b), kind)
        raise UnsupportedCError(f"the operator {op} is not supported")

    def _shifted(self, op: str, left: Operand, right: Operand) -> Operand:
        kind = promoted(left.type)
        if kind.word is None or right.type.word is None or kind.word.bits > 32:
            raise UnsupportedCError(f"{op} of {left.type.name} is not supported")
        name = "left" if op == "<<" else "right"
        return self._fitted(call_of(name, left.tree, right.tree), kind)

    def _conditional(self, condition: c_ast.Node, yes: c_ast.Node, no: c_ast.Node) -> Operand:
        first = self.operand(condition)
        sides = [self.lazily(lambda side=side: self.operand(side)) for side in (yes, no)]  # type: ignore[misc]
        kind = common_type(sides[0].type, sides[1].type)
        return Operand(m.Conditional(first.tree, *(converted(side, kind) for side in sides)), kind)

    def _cast(self, target: c_ast.Node, expr: c_ast.Node) -> Operand:
        kind = number_type(target, self.file.typedefs, line_of(expr))
        return Operand(converted(self.operand(expr), kind), kind)

    # calls

    def call(self, tree: c_ast.FuncCall, *, wants_result: bool = True) -> Operand:
        """Translate a call of a function of the file or of the C library."""
        if not isinstance(tree.name, c_ast.ID):
            raise UnsupportedCError("calls through pointers are not supported")
        name = str(tree.name.name)
        trees = list(tree.args.exprs) if tree.args is not None else []
        if name in self.file.unsupported:
            error = self.file.unsupported[name]
            raise UnsupportedCError(f"{name} is not supported: {error.message}", line_of(tree))
        if name in self.file.functions:
            self.calls[name] = None
            return self._call_own(name, trees, wants_result)
        plain = name if name in MATHEMATICS or name in TESTS else name.removesuffix("f")
        known = {**MATHEMATICS, **TESTS}
        if plain not in known:
            raise UnsupportedCError(f"unknown function {name}", line_of(tree), wrong=True)
        if len(trees) != known[plain]:
            raise UnsupportedCError(f"{name} takes {known[plain]} arguments, got {len(trees)}", wrong=True)
        operands = [self.operand(argument) for argument in trees]
        if plain in ("abs", "labs"):
            kind = INT if plain == "abs" else LONG
            return Operand(call_of(plain, *(converted(operand, kind) for operand in operands)), kind)
        kind = INT if plain in TESTS else DOUBLE
        return Operand(call_of(plain, *(operand.tree for operand in operands)), kind)

    def _call_own(self, name: str, trees: Sequence[c_ast.Node], wants_result: bool) -> Operand:
        function = self.file.functions[name]
        if len(trees) != len(function.arguments):
            raise UnsupportedCError(f"{name} takes {len(function.arguments)} arguments, got {len(trees)}", wrong=True)
        if wants_result and function.result is None:
            raise UnsupportedCError(f"{name} returns no value", wrong=True)
        targets: list[m.Expression | None] = []
        arguments: list[m.Expression] = []
        for argument, tree in zip(function.arguments, trees, strict=True):
            if argument.mode == "value":
                arguments.append(converted(self.operand(tree), argument.variable.type))
                continue
            target, variable = self._address(tree)
            if variable.type != argument.variable.type:
                raise UnsupportedCError(f"{name} takes the address of {argument.variable.type.name}", wrong=True)
            arguments.append(target)
            targets += [target] if argument.mode == "output" else []
        call = m.Call(m.Name(f"{name}()"), tuple(arguments))
        kind = function.result or INT
        if not targets and function.result is not None:
            return Operand(call, kind)
        self._eager(f"the call of {name}, which changes variables,")
        result = self.temporary()
        first: list[m.Expression | None] = [m.Name(result)] if function.result is not None else []
        if first or targets:
            self.pending.append(m.Assign((*first, *targets), call))
        else:
            self.pending.append(m.Evaluate(call))
        return Operand(m.Name(result), kind)

    def _address(self, tree: c_ast.Node) -> tuple[m.Expression, Variable]:
        """Return the variable, or the element, whose address an argument is."""
        if isinstance(tree, c_ast.UnaryOp) and tree.op == "&":
            return self.place(tree.expr)
        if isinstance(tree, c_ast.ID):
            variable = self._array(tree)
            return m.Name(variable.name), variable
        raise UnsupportedCError("only addresses of variables and arrays may be passed")


def _literal(kind: str, text: str) -> Operand:
    if "int" in kind or kind == "char":
        number = integer_literal(text)
        ends = text[len(text.rstrip("uUlL")) :].casefold()
        result = INT
        if "l" in ends or number >= 2**32 or (number >= 2**31 and "u" not in ends and not text.startswith("0")):
            result = replace(LONG, word=replace(LONG.word, signed="u" not in ends)) if LONG.word else LONG
        elif "u" in ends or number >= 2**31:
            result = UNSIGNED
        return Operand(m.Number(float(number)), result)
    if kind in ("double", "float", "long double"):
        plain = text.rstrip("fFlL") if not text.casefold().startswith("0x") else text.rstrip("lL")
        number_value = float.fromhex(plain) if plain.casefold().startswith("0x") else float(plain)
        return Operand(m.Number(number_value), FLOAT if kind == "float" else DOUBLE)
    if kind in ("bool", "_Bool"):
        return Operand(m.Number(float(text == "true")), BOOL)
    raise UnsupportedCError("text is not supported")


def _kind(tree: c_ast.Node) -> str:
    names = {"StructRef": "a member of a struct", "UnaryOp": "this address", "InitList": "a list of values"}
    return names.get(type(tree).__name__, f"{type(tree).__name__}")
