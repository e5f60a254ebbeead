"""Translation of ESDL expressions to the shared syntax tree, with their types."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any, Final, TypeVar

from kennfeld.ascet import syntax as e
from kennfeld.ascet.expression_parser import EsdlExpressionParser, EsdlSyntaxError
from kennfeld.ascet.lexer import tokens_of
from kennfeld.importers.ascet.instances import ClassInstance
from kennfeld.importers.ascet.name_resolution import (
    DependentParameter,
    EnumerationLabel,
    Named,
    NameResolver,
)
from kennfeld.importers.ascet.program_code import DependentCode, Operand, Place, ProgramCode
from kennfeld.importers.ascet.resolved_types import (
    BOOLEAN,
    INTEGER,
    REAL,
    Dimension,
    NumberType,
    ResolvedArray,
    Type,
    describe_type,
)
from kennfeld.importers.ascet.type_resolution import dotted
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError, unsupported_error
from kennfeld.program import tree as m
from kennfeld.program.traversal import calls_in

_COMPARISONS: Final = {"==": "==", "!=": "~=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}
_BITS: Final = {"&": "and", "|": "or", "^": "xor", "<<": "shift", ">>": "shift"}
Result = TypeVar("Result")


def call_of(name: str, *arguments: m.Expression) -> m.Call:
    """Return a call of a function of the library."""
    return m.Call(m.Name(f"esdl:{name}"), arguments)


class ExpressionTranslation:
    """Translates expressions of the methods of an instance.

    `pending` are statements that must run before the one that contains the expression. In code of C, integers that a
    type cannot hold wrap around (`wraps`).
    """

    wraps = False

    def __init__(self, code: ProgramCode, instance: ClassInstance) -> None:
        self.code, self.program = code, code.program
        self.names = NameResolver(self.program, instance)
        self.used: set[str] = set()
        self.pending: list[m.Statement] = []
        self._lazy = 0
        self._temporaries = 0

    @property
    def instance(self) -> ClassInstance:
        """The instance whose method is translated."""
        return self.names.instance

    # values

    def operand(self, tree: e.Expression) -> Operand:
        """Translate an expression to a number."""
        value = self.value(tree)
        if isinstance(value, Operand):
            return value
        if isinstance(value, Place):
            return self.read(value, tree)
        raise UnsupportedEsdlError(f"{dotted(tree) or 'this'} is not a number", place=tree.place)

    def read(self, place: Place, tree: e.Expression) -> Operand:
        """Return the number at a place."""
        if not isinstance(place.type, NumberType):
            name = dotted(tree) or place.leaf()
            raise UnsupportedEsdlError(f"{name} is {describe_type(place.type)}, not a number", place=tree.place)
        return Operand(self.leaf_tree(place), place.type)

    def leaf_tree(self, place: Place, path: tuple[str, ...] = ()) -> m.Expression:
        """Return the tree that reads the numbers of a leaf."""
        name = place.leaf(path)
        if not place.is_local:
            variable = self.program.variables.get(name)
            if variable is not None and variable.storage == "constant" and variable.initial.ndim == 0:
                return m.Number(float(variable.initial))
            self.used.add(name)
        return m.Call(m.Name(name), place.indices) if place.indices else m.Name(name)

    def value(self, tree: e.Expression) -> Operand | Place | e.Braces:
        """Translate an expression to a number, a place, or elements in braces."""
        match tree:
            case e.Unsupported():
                raise unsupported_error(tree)
            case e.Number(value, is_real):
                # the range of a literal is its value, so that conversions of it need no limit
                kind = REAL if is_real else NumberType("integer", value, value)
                return Operand(m.Number(value), kind)
            case e.Truth(value):
                return Operand(m.Number(float(value)), BOOLEAN)
            case e.Braces():
                return tree
            case e.Name() | e.Field() | e.Index():
                return self._named_value(tree)
            case e.Call():
                return self._call(tree)
            case e.Unary(operator, operand):
                return self._unary(operator, self.operand(operand))
            case e.Binary():
                return self._binary(tree)
            case e.Between(operand, low, high):
                return self._between(*map(self.operand, (operand, low, high)))
            case e.Conditional(condition, yes, no):
                return self._conditional(self.operand(condition), yes, no)
            case e.Choice():
                return self._choice(tree)
            case e.Cast(kind, operand):
                return self._cast(kind, self.operand(operand), tree)
        raise UnsupportedEsdlError("this expression is not supported", place=tree.place)

    def named(self, tree: e.Expression) -> Named:
        """Return what a name, a member or an element refers to."""
        match tree:
            case e.Unsupported():
                raise unsupported_error(tree)
            case e.Name():
                return self.names.name(tree)
            case e.Field(of, _):
                # from the outside in: `a.b[i].c` may begin with a package, an interface or an instance
                around = self.named(of)
                return self.names.member(around, tree)
            case e.Index(of, index):
                around = self.named(of)
                if not isinstance(around, Place):
                    raise UnsupportedEsdlError(f"{dotted(of) or 'this'} is not an array", place=tree.place)
                return self._element(around, index)
            case e.Call():
                value = self._call(tree)
                if isinstance(value, Place):
                    return value
        raise UnsupportedEsdlError("a name is required here", place=tree.place)

    def _named_value(self, tree: e.Expression) -> Operand | Place:
        named = self.named(tree)
        match named:
            case Place():
                return named
            case EnumerationLabel(value, kind):
                return Operand(m.Number(float(value)), kind)
            case DependentParameter(instance, holder):
                return self._dependent(instance, holder.element, tree)
        raise UnsupportedEsdlError(f"{dotted(tree)} is not a value", place=tree.place)

    def _element(self, place: Place, index: e.Expression) -> Place:
        """Return an element of an array."""
        if not isinstance(place.type, ResolvedArray):
            raise UnsupportedEsdlError(f"{place.leaf()} is not an array", place=index.place)
        dimension, *rest = place.type.dimensions
        kind: Type = ResolvedArray(tuple(rest), place.type.element) if rest else place.type.element
        at = self._index(dimension, self.operand(index), index)
        return replace(place, type=kind, indices=(*place.indices, at))

    def _index(self, dimension: Dimension, operand: Operand, tree: e.Expression) -> m.Expression:
        """Return an index from 1; one out of range takes the nearest element, as generated code does."""
        if operand.type.kind == "real":
            raise UnsupportedEsdlError("an index must be an integer", place=tree.place)
        if dimension.size is None:
            raise UnsupportedEsdlError("the size of the array is not known here", place=tree.place)
        labels = dimension.enumeration.labels if dimension.enumeration is not None else ()
        # the index is the number of the label less that of the first one
        if labels and [number for _, number in labels] != list(range(dimension.first, dimension.first + len(labels))):
            raise UnsupportedEsdlError("the numbers of the enumeration have gaps", place=tree.place)
        if isinstance(operand.tree, m.Number):
            at = operand.tree.value - dimension.first
            return m.Number(min(max(at, 0.0), dimension.size - 1.0) + 1.0)
        return call_of("index", operand.tree, m.Number(float(dimension.first)), m.Number(float(dimension.size)))

    def _dependent(self, instance: ClassInstance, element: e.Element, tree: e.Expression) -> Operand:
        """Translate a dependent characteristic; its formula is translated and evaluated once."""
        label = f"{instance.label}.{element.name}"
        dependents = self.code.dependents
        if label not in dependents:
            # None while it is translated: a formula that leads back to it depends on itself
            dependents[label] = None
            dependents[label] = self._formula(instance, element, tree)
        if dependents[label] is None:
            raise UnsupportedEsdlError(f"the dependent parameter {element.name} depends on itself", place=tree.place)
        self.used.add(label)
        return Operand(m.Name(label), REAL)

    def _formula(self, instance: ClassInstance, element: e.Element, tree: e.Expression) -> DependentCode:
        assert element.formula is not None
        text, letters = element.formula
        parser = EsdlExpressionParser(tokens_of(text))
        try:
            formula = parser.expression()
            if parser.token.kind != "end":
                raise parser.fault(f"unexpected {parser.token.text!r}")
        except EsdlSyntaxError as error:
            message = f"the formula of {element.name} is wrong: {error.message}"
            raise UnsupportedEsdlError(message, place=tree.place) from None
        # its names are those of the instance that declares it; the variables in it are noted apart
        names, used = self.names, self.used
        self.names, self.used = NameResolver(self.program, instance), set()
        try:
            operand = self.lazily(partial(self.operand, _substituted(formula, dict(letters), element.place)))
            self.code.read |= self.used
            return DependentCode(operand.tree, frozenset(self.used))
        finally:
            self.names, self.used = names, used

    # operators

    def _unary(self, operator: str, operand: Operand) -> Operand:
        match operator:
            case "+":
                return operand
            case "-":
                if isinstance(operand.tree, m.Number):
                    kind = operand.type if operand.type.kind == "real" else _literal(-operand.tree.value)
                    return Operand(m.Number(-operand.tree.value), kind)
                return Operand(m.Unary("-", operand.tree), arithmetic_type(operand.type, operand.type))
            case "!":
                return Operand(m.Unary("~", operand.tree), BOOLEAN)
        self._require_whole(operand)
        if self.wraps and not _is_unsigned(operand.type):
            # C promotes smaller types to int before: ~(uint8) 1 is -2
            return Operand(m.Binary("-", m.Unary("-", operand.tree), m.Number(1.0)), INTEGER)
        if operand.type.low >= 0:
            # ~x = mask - x, with as many bits as the largest number of the type needs
            mask = 2.0 ** max(1, int(operand.type.high).bit_length()) - 1.0
            return Operand(m.Binary("-", m.Number(mask), operand.tree), operand.type)
        # ~x = -x - 1 in two's complement
        return Operand(m.Binary("-", m.Unary("-", operand.tree), m.Number(1.0)), INTEGER)

    def _require_whole(self, *operands: Operand) -> None:
        kinds = ("integer", "enumeration", "boolean") if self.wraps else ("integer", "enumeration")
        if not all(operand.type.kind in kinds for operand in operands):
            raise UnsupportedEsdlError("bit operators require integers")
        # results of arithmetic have an unlimited range, and are those of 32 bits
        if any(INTEGER.high * 2.0 + 1.0 < operand.type.high < math.inf for operand in operands):
            raise UnsupportedEsdlError("bit operators of integers of more than 32 bits")

    def _binary(self, tree: e.Binary) -> Operand:
        operator = tree.operator
        left = self.operand(tree.left)
        # the right operand may call a method, which must not run if the left one decides
        if operator in ("&&", "||"):
            right = self.lazily(lambda: self.operand(tree.right))
            return Operand(m.Binary(operator, left.tree, right.tree), BOOLEAN)
        return self.combined(operator, left, self.operand(tree.right), tree.place)

    def combined(self, operator: str, left: Operand, right: Operand, place: e.TextPosition) -> Operand:
        """Return the result of an operator that evaluates both operands."""
        if operator in _COMPARISONS:
            return Operand(m.Binary(_COMPARISONS[operator], left.tree, right.tree, place=place), BOOLEAN)
        if operator in _BITS:
            return self._bits(operator, left, right)
        kind = arithmetic_type(left.type, right.type)
        if kind.kind == "boolean":
            # C counts truth values
            kind = NumberType("integer")
        self.code.has_integer_arithmetic |= kind.is_whole
        if operator == "/":
            return Operand(call_of("quotient" if kind.is_whole else "divide", left.tree, right.tree), kind)
        if operator == "%":
            return Operand(call_of("remainder", left.tree, right.tree), kind)
        return Operand(m.Binary(f".{operator}" if operator == "*" else operator, left.tree, right.tree), kind)

    def _bits(self, operator: str, left: Operand, right: Operand) -> Operand:
        if left.type.kind == right.type.kind == "boolean" and operator in "&|^":
            return Operand(m.Binary("~=" if operator == "^" else operator, left.tree, right.tree), BOOLEAN)
        self._require_whole(left, right)
        # one function shifts both ways: to the right by a negative number of bits
        by = m.Unary("-", right.tree) if operator == ">>" else right.tree
        is_signed = left.type.low < 0 or right.type.low < 0
        if self.wraps:
            is_signed = not (_is_unsigned(left.type) or (_is_unsigned(right.type) and operator in "&|^"))
        sign = m.Number(float(is_signed))
        kind = INTEGER if sign.value else NumberType("integer", 0.0, 2.0**32 - 1)
        return Operand(call_of(_BITS[operator], left.tree, by, sign), kind)

    def _between(self, operand: Operand, low: Operand, high: Operand) -> Operand:
        # a function, as its arguments are evaluated once: the operand may be the call of a method
        return Operand(call_of("between", operand.tree, low.tree, high.tree), BOOLEAN)

    def once(self, tree: m.Expression, place: e.TextPosition) -> m.Expression:
        """Return a tree that may be used several times: the name of a variable if the tree calls a method."""
        if not any(name in self.code.functions for name, _ in calls_in(tree)):
            return tree
        # a statement before the expression would run although the condition does not hold
        if self._lazy:
            message = "the result of a method is used several times within a condition"
            raise UnsupportedEsdlError(message, "Store it in a variable first.", place)
        self._temporaries += 1
        name = m.Name(f"%{self._temporaries}")
        self.pending.append(m.Assign((name,), tree, place=place))
        return name

    def lazily(self, translate: Callable[[], Result]) -> Result:
        """Translate an expression that is evaluated only under a condition."""
        self._lazy += 1
        try:
            return translate()
        finally:
            self._lazy -= 1

    def _conditional(self, condition: Operand, yes: e.Expression, no: e.Expression) -> Operand:
        first, second = (self.lazily(partial(self.operand, tree)) for tree in (yes, no))
        return _conditional(condition.tree, first, second)

    def _choice(self, tree: e.Choice) -> Operand:
        if tree.otherwise is None:
            raise UnsupportedEsdlError("a switch expression without default", place=tree.place)
        subject = self.operand(tree.subject)
        subject = replace(subject, tree=self.once(subject.tree, tree.place))
        result = self.lazily(partial(self.operand, tree.otherwise))
        # from the last case to the first, as each becomes the one that the conditions before it leave
        for keys, value in reversed(tree.cases):
            condition = self.matches(subject, keys)
            chosen = self.lazily(partial(self.operand, value))
            result = _conditional(condition, chosen, result)
        return result

    def matches(self, subject: Operand, keys: Sequence[e.Expression]) -> m.Expression:
        """Return the condition that a number is one of the keys of a case."""
        result: m.Expression | None = None
        for key in keys:
            if isinstance(key, e.Range) and key.first is not None and key.last is not None:
                condition = self._between(subject, self.operand(key.first), self.operand(key.last)).tree
            else:
                condition = m.Binary("==", subject.tree, self._key(subject, key).tree)
            result = condition if result is None else m.Binary("|", result, condition)
        assert result is not None
        return result

    def _key(self, subject: Operand, key: e.Expression) -> Operand:
        """Return a key of a case; a label of the enumeration may stand alone."""
        labels = dict(subject.type.labels)
        if isinstance(key, e.Name) and key.name in labels:
            return Operand(m.Number(float(labels[key.name])), subject.type)
        return self.operand(key)

    def _cast(self, kind: e.TypeExpression, operand: Operand, tree: e.Expression) -> Operand:
        own = self.program.types.resolve(kind, self.instance.scope)
        if not isinstance(own, NumberType):
            raise UnsupportedEsdlError(f"a conversion to {describe_type(own)}", place=tree.place)
        return Operand(self.converted(operand, own), own)

    # calls and conversions, in `call_translation`

    def converted(self, operand: Operand, kind: NumberType) -> m.Expression:
        """Return a number converted to a type."""
        raise NotImplementedError

    def _call(self, tree: e.Call) -> Operand | Place:
        result = self.call(tree)
        if result is None:
            raise UnsupportedEsdlError("the method returns no value", place=tree.place)
        return result

    def call(self, tree: e.Call) -> Operand | Place | None:
        """Translate a call; None for a method without a result, whose call is then pending."""
        raise UnsupportedEsdlError("a call is not supported here", place=tree.place)


def _conditional(condition: m.Expression, yes: Operand, no: Operand) -> Operand:
    kind = yes.type if yes.type == no.type else arithmetic_type(yes.type, no.type)
    return Operand(m.Conditional(condition, yes.tree, no.tree), kind)


def arithmetic_type(left: NumberType, right: NumberType) -> NumberType:
    """Return the type of a sum or product; its range is that of the type to which it is assigned."""
    if left.kind == right.kind == "boolean":
        return BOOLEAN
    is_real = "real" in (left.kind, right.kind)
    return REAL if is_real else NumberType("integer")


def _is_unsigned(kind: NumberType) -> bool:
    """Return True for a number that C keeps in an unsigned word, as it does not fit into a signed one."""
    return kind.low >= 0.0 and kind.high > INTEGER.high


def _literal(value: float) -> NumberType:
    return NumberType("integer", value, value)


def _substituted(tree: Any, letters: Mapping[str, e.Expression], place: e.TextPosition) -> Any:
    """Return a tree with the letters of a formula replaced by what they stand for."""
    if isinstance(tree, e.Name):
        return letters.get(tree.name, tree)
    if isinstance(tree, tuple):
        return tuple(_substituted(part, letters, place) for part in tree)
    if is_dataclass(tree) and not isinstance(tree, type):
        names = [item.name for item in fields(tree)]
        changes = {
            # positions in the text of the formula are none of the file
            name: place if name == "place" else _substituted(getattr(tree, name), letters, place)
            for name in names
        }
        return replace(tree, **changes)
    return tree
