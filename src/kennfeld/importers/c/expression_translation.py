"""Translation of C expressions to the shared syntax tree, with their types."""

import math
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from pycparser import c_ast

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.c.addresses import AddressTranslation
from kennfeld.importers.c.declarations import CFile, line_of
from kennfeld.importers.c.number_types import (
    BOOL,
    DOUBLE,
    FLOAT,
    INT,
    LONG_DOUBLE,
    LONG_LONG,
    UNSIGNED,
    CType,
    UnsupportedCError,
    common_type,
    holds,
    promoted,
)
from kennfeld.importers.c.places import CPlace, kind_of, parts_of
from kennfeld.importers.c.sizes import size_of
from kennfeld.importers.c.struct_types import TAG, CStructType, DeclaredType, ObjectType, integer_literal
from kennfeld.program import tree as m

_COMPARISONS: Final = {"==": "==", "!=": "~=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}
_BITS: Final = {"&": "and", "|": "or", "^": "xor"}
_LONG_WORDS: Final = "64-bit integers are exact up to 2^53, and NaN beyond"
_SPECIAL: Final = {"__infinity": float("inf"), "__nan": float("nan")}


@dataclass(frozen=True)
class COperand:
    """A number: the tree that calculates it, and its type."""

    tree: m.Expression
    type: CType


def call_of(name: str, *arguments: m.Expression) -> m.Call:
    """Return a call of a function of the library."""
    return m.Call(m.Name(f"c:{name}"), arguments)


def converted(operand: COperand, target: CType) -> m.Expression:
    """Return the number in another type: cut off towards zero, then the lowest bits."""
    source = operand.type
    if target.single and not source.single:
        return rounded(operand.tree)
    if target.word is None or target == source:
        return operand.tree
    if target.truth:
        return m.Binary("~=", operand.tree, m.Number(0.0))
    if source.word is not None and holds(target.word, source.word):
        return operand.tree
    # NaN has no integer
    if isinstance(operand.tree, m.Number) and operand.tree.value == operand.tree.value:
        # limited before, since infinity has no integer; C does not define the result of numbers out of range
        return m.Number(float(target.word.wrapped(int(max(min(operand.tree.value, 2.0**64), -(2.0**64))))))
    whole = operand.tree if source.word is not None else call_of("truncate", operand.tree)
    return _wrapped("wrap", target, whole)


def rounded(tree: m.Expression) -> m.Expression:
    """Return a number in single precision."""
    return m.Number(float(np.float32(tree.value))) if isinstance(tree, m.Number) else call_of("single", tree)


def _wrapped(name: str, kind: CType, *operands: m.Expression) -> m.Expression:
    assert kind.word is not None
    return call_of(name, *operands, m.Number(float(kind.word.bits)), m.Number(float(kind.word.signed)))


class PassedNames(NamedTuple):
    """The numbers whose addresses a call of a function passes, and those of them that it may change."""

    function: str
    names: tuple[str, ...]
    changed: tuple[str, ...]
    line: int


class CExpressionTranslation(AddressTranslation):
    """Translates expressions of a function."""

    def __init__(self, file: CFile) -> None:
        super().__init__(file)
        self.calls: dict[str, None] = {}
        self.passed: list[PassedNames] = []
        self.remarks: dict[str, None] = {}

    def operand(self, tree: c_ast.Node) -> COperand:
        """Translate an expression to a number."""
        try:
            result = self._operand(tree)
        except UnsupportedCError as error:
            raise error if error.line else UnsupportedCError(error.message, line_of(tree), wrong=error.wrong) from None
        # 2.0f is the same number in double precision, 0.1f is another one
        if not (isinstance(tree, c_ast.Constant) and isinstance(result.tree, m.Number) and _is_single(result.tree)):
            self.note_precision(result.type)
        return result

    def note_precision(self, kind: ObjectType | None) -> None:
        """Note that numbers of a type are computed in another precision."""
        if kind is FLOAT:
            self.remarks["float is computed in double precision"] = None
        if kind is LONG_DOUBLE:
            self.remarks["long double is computed in double precision"] = None

    def _operand(self, tree: c_ast.Node) -> COperand:
        match tree:
            case c_ast.Constant(type=kind, value=text):
                return self._constant(kind, text)
            case c_ast.ID(name=name) if name in _SPECIAL:
                return COperand(m.Number(_SPECIAL[name]), DOUBLE)
            case c_ast.ID() | c_ast.ArrayRef() | c_ast.StructRef() | c_ast.UnaryOp(op="*") | c_ast.CompoundLiteral():
                return self._read(tree)
            case c_ast.UnaryOp(op=("++" | "--" | "p++" | "p--") as op, expr=target):
                return self._step(op, target, tree)
            case c_ast.UnaryOp(op="sizeof", expr=expr):
                return COperand(m.Number(float(self._bytes(expr))), self.file.types.number("size_t"))
            case c_ast.UnaryOp(op=op, expr=expr):
                return self._unary(op, expr)
            case c_ast.BinaryOp():
                return self._binary(tree)
            case c_ast.TernaryOp(cond=condition, iftrue=yes, iffalse=no):
                return self._conditional(condition, yes, no)
            case c_ast.Cast(to_type=target, expr=expr):
                return self._cast(target, expr)
            case c_ast.Assignment():
                # a = b as a value: the assignment runs before the expression around it
                target, statements = self._assignment(tree)
                self.pending += statements
                return self.read(target)
            case c_ast.ExprList(exprs=exprs):
                return [self.operand(expr) for expr in exprs][-1]
            case c_ast.FuncCall():
                return self.call(tree)
        raise UnsupportedCError(f"{kind_of(tree)} is not supported", line_of(tree))

    def _bytes(self, tree: c_ast.Node) -> int:
        """Return the size in bytes of a type, or of what an expression names."""
        declared: DeclaredType | CPlace
        if isinstance(tree, c_ast.Typename):
            declared = self.file.types.declared(tree)
        elif _is_number(tree):
            return self.operand(tree).type.bytes
        else:
            declared = self.place(tree)
        return size_of(self.file.types, declared.type, declared.sizes, is_pointer=declared.is_pointer)

    # variables

    def index(self, tree: c_ast.Node) -> m.Expression:
        operand = self.operand(tree)
        if operand.type.word is None:
            raise UnsupportedCError("an index must be an integer", line_of(tree), wrong=True)
        if isinstance(operand.tree, m.Number):
            # indices count from 0 in C, from 1 in the tree
            return m.Number(operand.tree.value + 1.0)
        return m.Binary("+", operand.tree, m.Number(1.0))

    def _read(self, tree: c_ast.Node) -> COperand:
        if isinstance(tree, c_ast.ID) and isinstance(number := self.lookup(tree.name, tree), int):
            return COperand(m.Number(float(number)), INT)
        return self.read(self.number(tree))

    def read(self, place: CPlace) -> COperand:
        """Return the number at a place."""
        assert isinstance(place.type, CType)
        return COperand(self.value_of(place), place.type)

    def value_of(self, place: CPlace) -> m.Expression:
        """Return the tree of numbers that are read; a member of a union must be the one written last."""
        tree = self.used(place)
        for part in reversed(place.unions):
            struct = part.union.type
            assert isinstance(struct, CStructType)
            names = " ".join(member.name for member in struct.members[:-1])
            label = part.union.label or struct.name
            texts = m.Text(label, True), m.Text(names, True)
            tree = call_of("member", tree, self.used(part.tag(place.indices)), m.Number(float(part.number)), *texts)
        return tree

    def marked(self, place: CPlace, line: int, *, keeps: bool = False) -> list[m.Statement]:
        """Return the statements that make a place a part of the members of unions that were written last.

        Numbers of such a member that the place does not cover are not known, if another member was written before, nor
        are those that it covers if it `keeps` its numbers.
        """
        result: list[m.Statement] = []
        position = m.TextPosition(line)
        for part in place.unions:
            tag, number = self.used(part.tag(place.indices)), m.Number(float(part.number))
            member = replace(part.member, indices=place.indices[: len(part.member.indices)])
            is_whole = member.name == place.name and member.indices == place.indices and place.offset is None
            for each in () if is_whole and not keeps else parts_of(member):
                if not each.path.rpartition(".")[2].startswith(TAG):
                    tree = self.used(each)
                    result.append(m.Assign((tree,), call_of("overlapped", tree, tag, number), place=position))
            result.append(m.Assign((tag,), number, place=position))
        return result

    def stored(self, place: CPlace, operand: COperand, line: int) -> m.Assign:
        """Return the statement that assigns a number to a place."""
        if place.is_constant:
            raise UnsupportedCError(f"{place.label} is const and cannot be assigned", line, wrong=True)
        assert isinstance(place.type, CType)
        self.note_precision(place.type)
        value, position = converted(operand, place.type), m.TextPosition(line)
        if place.unions:  # the value may be of the member that it replaces
            name = m.Name(self.temporary())
            self.pending += [m.Assign((name,), value, place=position), *self.marked(place, line)]
            value = name
        return m.Assign((self.used(place),), value, place=position)

    def assignment(self, tree: c_ast.Assignment) -> list[m.Statement]:
        """Return the statements of `target op= value`, behind those that its value needs."""
        copies = self.copies(tree)
        _, statements = self._assignment(tree) if copies is None else (None, copies)
        pending, self.pending = self.pending, []
        return [*pending, *statements]

    def copies(self, tree: c_ast.Assignment) -> list[m.Statement] | None:
        """Return the statements that copy a struct; None if the target is a number."""
        raise NotImplementedError

    def _assignment(self, tree: c_ast.Assignment) -> tuple[CPlace, list[m.Statement]]:
        """Return the target of an assignment, whose indices are evaluated once, and its statement."""
        # C leaves open which side is evaluated first
        operand = self.operand(tree.rvalue)
        target = self.number(tree.lvalue)
        if tree.op != "=":
            operand = self._combined(tree.op[:-1], self.read(target), operand)
        return target, [self.stored(target, operand, line_of(tree))]

    def _step(self, op: str, target: c_ast.Node, tree: c_ast.Node) -> COperand:
        """Translate ++ and --; with the operator behind it, the value is that before."""
        place = self.number(target)
        before = self.read(place)
        name = self.temporary()
        if op.startswith("p"):
            self.pending.append(m.Assign((m.Name(name),), before.tree, place=m.TextPosition(line_of(tree))))
        self.pending.append(self._stepped(op, place, line_of(tree)))
        # in front of the operand, the tree reads the place again, which has the new number by then
        return COperand(m.Name(name), before.type) if op.startswith("p") else before

    def stepped(self, op: str, target: c_ast.Node, line: int) -> m.Assign:
        """Return the statement of ++ or --."""
        return self._stepped(op, self.number(target), line)

    def _stepped(self, op: str, place: CPlace, line: int) -> m.Assign:
        operand = self._combined(op[-1], self.read(place), COperand(m.Number(1.0), INT))
        return self.stored(place, operand, line)

    # operators

    def condition(self, tree: c_ast.Node) -> COperand:
        """Translate a condition; an address holds unless it is null."""
        return COperand(self.is_set(tree), INT) if self.is_address(tree) else self.operand(tree)

    def _null_test(self, op: str, left: c_ast.Node, right: c_ast.Node) -> COperand | None:
        """Translate the comparison of an address with NULL; None for other operators."""
        for address, other in ((left, right), (right, left)):
            if op in ("==", "!=") and is_null(other) and self.is_address(address):
                tested = self.is_set(address)
                if isinstance(tested, m.Number):
                    return COperand(m.Number(float(op == "!=")), INT)
                return COperand(tested if op == "!=" else m.Unary("~", tested), INT)
        return None

    def _unary(self, op: str, expr: c_ast.Node) -> COperand:
        operand = self.condition(expr) if op == "!" else self.operand(expr)
        kind = promoted(operand.type)
        match op:
            case "+":
                return COperand(operand.tree, kind)
            case "-" if isinstance(operand.tree, m.Number) and (kind.word is None or kind.word.signed):
                return COperand(m.Number(-operand.tree.value), kind)
            case "-":
                return self._fitted(m.Unary("-", operand.tree), kind)
            case "!":
                return COperand(m.Unary("~", operand.tree), INT)
            case "~" if kind.word is not None and (kind.word.bits <= 32 or kind.word.signed):
                # ~x = -1 - x in signed words, 2^bits - 1 - x in unsigned ones
                top = m.Number(-1.0 if kind.word.signed else 2.0**kind.word.bits - 1.0)
                return COperand(m.Binary("-", top, operand.tree), kind)
        raise UnsupportedCError(f"the operator {op} is not supported here")

    def _fitted(self, tree: m.Expression, kind: CType) -> COperand:
        """Return the result of an operation, which wraps in integer types."""
        if kind.word is None:
            # the sum, product or quotient of two floats has a double that is rounded to the same float
            return COperand(rounded(tree) if kind.single else tree, kind)
        if kind.word.bits > 32:
            self.remarks[_LONG_WORDS] = None
        return COperand(_wrapped("wrap", kind, tree), kind)

    def _binary(self, tree: c_ast.BinaryOp) -> COperand:
        if tree.op not in ("&&", "||"):
            tested = self._null_test(tree.op, tree.left, tree.right)
            if tested is None and (between := self.between(tree.op, tree.left, tree.right)) is not None:
                tested = COperand(between, self.file.types.number("ptrdiff_t") if tree.op == "-" else INT)
            return tested or self._combined(tree.op, self.operand(tree.left), self.operand(tree.right))
        left = self.condition(tree.left)
        right, statements = self.apart(lambda: self.condition(tree.right))
        if not statements:
            # evaluates the right side only if the left one does not decide
            return COperand(m.Binary(tree.op, left.tree, right.tree), INT)
        result, place = m.Name(self.temporary()), m.TextPosition(line_of(tree))
        decides = left.tree if tree.op == "&&" else m.Unary("~", left.tree)
        body = (*statements, m.Assign((result,), m.Binary("~=", right.tree, m.Number(0.0)), place=place))
        self.pending += [
            m.Assign((result,), m.Number(float(tree.op == "||")), place=place),
            m.If((m.Branch(decides, body, place=place),), place=place),
        ]
        return COperand(result, INT)

    def _combined(self, op: str, left: COperand, right: COperand) -> COperand:
        kind = common_type(left.type, right.type)
        if op in ("<<", ">>"):
            return self._shifted(op, left, right)
        a, b = converted(left, kind), converted(right, kind)
        if op in _COMPARISONS:
            return COperand(m.Binary(_COMPARISONS[op], a, b), INT)
        if op in _BITS:
            if kind.word is None:
                raise UnsupportedCError(f"{op} of {kind.name} is not supported", wrong=True)
            if kind.word.bits > 32:
                self.remarks[_LONG_WORDS] = None
            return COperand(_wrapped(_BITS[op], kind, a, b), kind)
        if kind.word is None:
            if op == "%":
                raise UnsupportedCError("% requires integers, use fmod", wrong=True)
            return self._fitted(m.Binary({"*": ".*", "/": "./"}.get(op, op), a, b), kind)
        match op:
            case "*" if kind.word.bits <= 32:
                # a product of 32-bit words has up to 64 bits, more than a double holds
                return COperand(_wrapped("multiply", kind, a, b), kind)
            case "/" if kind.word.bits > 32 and (parts := _product_of(a)) is not None:
                return self._fitted(call_of("product_quotient", *parts, b, m.Number(float(kind.word.signed))), kind)
            case "/" | "%":
                return self._fitted(call_of("quotient" if op == "/" else "rest", a, b), kind)
            case "+" | "-" | "*":
                return self._fitted(m.Binary(".*" if op == "*" else op, a, b), kind)
        raise UnsupportedCError(f"the operator {op} is not supported")

    def _shifted(self, op: str, left: COperand, right: COperand) -> COperand:
        kind = promoted(left.type)
        if kind.word is None or right.type.word is None:
            raise UnsupportedCError(f"{op} of {left.type.name} is not supported")
        # C11, 6.5.7: the type is that of the left operand, promoted
        if op == ">>" and kind.word.bits > 32 and (terms := _product_and_addend(left.tree)) is not None:
            signed = m.Number(float(kind.word.signed))
            return self._fitted(call_of("upper_bits", *terms, right.tree, signed), kind)
        name = "left" if op == "<<" else "right"
        return self._fitted(call_of(name, left.tree, right.tree), kind)

    def _conditional(self, condition: c_ast.Node, yes: c_ast.Node, no: c_ast.Node) -> COperand:
        first = self.condition(condition)
        sides = [self.apart(lambda side=side: self.operand(side)) for side in (yes, no)]  # type: ignore[misc]
        kind = common_type(sides[0][0].type, sides[1][0].type)
        values = [converted(side, kind) for side, _ in sides]
        if not any(statements for _, statements in sides):
            return COperand(m.Conditional(first.tree, *values), kind)
        result, place = m.Name(self.temporary()), m.TextPosition(line_of(condition))
        bodies = [
            (*statements, m.Assign((result,), value, place=place))
            for (_, statements), value in zip(sides, values, strict=True)
        ]
        self.pending.append(m.If((m.Branch(first.tree, bodies[0], place=place),), bodies[1], place=place))
        return COperand(result, kind)

    def _cast(self, target: c_ast.Node, expr: c_ast.Node) -> COperand:
        declared = self.file.types.declared(target)
        if declared.is_pointer or declared.sizes or not isinstance(declared.type, CType):
            raise UnsupportedCError("only conversions to numbers are supported", line_of(expr))
        return COperand(converted(self.operand(expr), declared.type), declared.type)

    def _constant(self, kind: str, text: str) -> COperand:
        """Return the number of a literal, in the first type of C that has it."""
        if "int" in kind or kind == "char":
            number = integer_literal(text)
            ends = text[len(text.rstrip("uUlL")) :].casefold()
            result = INT
            # C11, 6.4.4.1: a decimal literal beyond int is long, an octal or hexadecimal one unsigned first
            if "l" in ends or number >= 2**32 or (number >= 2**31 and "u" not in ends and not text.startswith("0")):
                long = self.file.types.number("long")
                is_small = "ll" not in ends and long.word is not None and number <= long.word.most
                wide = long if is_small else LONG_LONG
                result = replace(wide, word=replace(wide.word, signed="u" not in ends)) if wide.word else wide
            elif "u" in ends or number >= 2**31:
                result = UNSIGNED
            return COperand(m.Number(float(number)), result)
        if kind in ("double", "float", "long double"):
            # f is a digit of hexadecimal numbers, but not of their exponents, which all of these have
            plain = text.rstrip("fFlL")
            try:
                number_value = float.fromhex(plain) if plain.casefold().startswith("0x") else float(plain)
            except OverflowError:
                number_value = math.inf
            if kind == "float":
                float_type = self.file.types.number("float")
                return COperand(
                    rounded(m.Number(number_value)) if float_type.single else m.Number(number_value), float_type
                )
            return COperand(m.Number(number_value), DOUBLE if kind == "double" else LONG_DOUBLE)
        if kind in ("bool", "_Bool"):
            return COperand(m.Number(float(text == "true")), BOOL)
        raise UnsupportedCError("text is not supported")

    # calls

    def call(self, tree: c_ast.FuncCall, *, wants_result: bool = True) -> COperand:
        """Translate a call of a function of the file or of the C library."""
        raise NotImplementedError


def _product_of(tree: m.Expression) -> tuple[m.Expression, m.Expression] | None:
    """Return the factors of a product of 64-bit integers; None for other expressions."""
    match tree:
        case m.Call(m.Name("c:wrap"), (m.Binary(".*", left, right), m.Number(64.0), m.Number())):
            return left, right
    return None


def _product_and_addend(tree: m.Expression) -> tuple[m.Expression, m.Expression, m.Expression] | None:
    """Return the factors of a product of 64-bit integers, and what is added to it, such as half of the last bit."""
    if (factors := _product_of(tree)) is not None:
        return *factors, m.Number(0.0)
    match tree:
        case m.Call(m.Name("c:wrap"), (m.Binary("+", left, right), m.Number(64.0), m.Number())):
            for product, addend in ((left, right), (right, left)):
                if (factors := _product_of(product)) is not None:
                    return *factors, addend
    return None


def _is_number(tree: c_ast.Node) -> bool:
    """Return True for an expression of which `sizeof` needs the type only, not a place."""
    return isinstance(tree, c_ast.Constant | c_ast.BinaryOp | c_ast.Cast)


def _is_single(tree: m.Number) -> bool:
    """Return True for a number that single precision represents."""
    with np.errstate(over="ignore"):
        return float(np.float32(tree.value)) == tree.value


def is_null(tree: c_ast.Node) -> bool:
    """Return True for 0, and for NULL as it is written or as headers define it."""
    if isinstance(tree, c_ast.Cast):
        return is_null(tree.expr)
    return (isinstance(tree, c_ast.ID) and tree.name == "NULL") or getattr(tree, "value", "") in ("0", "0L", "0U")
