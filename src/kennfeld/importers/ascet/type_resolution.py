"""Resolution of ESDL types and evaluation of constant expressions."""

import math
from collections.abc import Mapping
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.base.formatting import nearest
from kennfeld.importers.ascet.declarations import Declared, FileScope
from kennfeld.importers.ascet.resolved_types import (
    BOOLEAN,
    INTEGER,
    REAL,
    ClassType,
    Dimension,
    NumberType,
    ResolvedArray,
    ResolvedAxis,
    ResolvedTable,
    StructType,
    Type,
    size_of,
)
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError, unsupported_error

_BUILTIN: Final[Mapping[str, NumberType]] = {"real": REAL, "integer": INTEGER, "boolean": BOOLEAN}
_DATATYPES: Final[Mapping[str, tuple[float, float]]] = {
    **{f"uint{bits}": (0.0, 2.0**bits - 1) for bits in (8, 16, 32, 64)},
    **{f"sint{bits}": (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
}
_MAX_SIZE: Final = 100_000  # elements of an array
_MAX_REFERENCES: Final = 40  # types that are defined by each other


class TypeResolver:
    """Resolves types, each declared one once.

    Args:
        limits: whether reals are limited to the ranges of their types when they are assigned; None as generated code.
    """

    def __init__(self, limits: bool | None = None) -> None:
        self._limits_reals = limits
        self._known: dict[int, Type] = {}
        self._open: list[str] = []

    def named(self, name: str, scope: FileScope) -> Type:
        """Resolve the name of a type; raises `UnsupportedEsdlError` if it is not a type."""
        if name in _BUILTIN:
            return _BUILTIN[name]
        declared = scope.find(name)
        if declared is None:
            names = [*_BUILTIN, *scope.tree.package(scope.file.package)]
            remedy = scope.remedy_for(name) or nearest(name, names) or "Import it, or name its folder under folders."
            raise UnsupportedEsdlError(f"unknown type {name}", remedy)
        return self.declared(declared)

    def declared(self, declared: Declared) -> Type:
        """Return the type that a declaration defines."""
        key = id(declared.declaration)
        if key not in self._known:
            if declared.label in self._open or len(self._open) > _MAX_REFERENCES:
                raise UnsupportedEsdlError(f"the type {declared.label} is defined by itself")
            self._open.append(declared.label)
            try:
                self._known[key] = self._defined(declared)
            finally:
                self._open.pop()
        return self._known[key]

    def _defined(self, declared: Declared) -> Type:
        match declared.declaration:
            case e.TypeDeclaration(name, kind):
                return self.resolve(kind, declared.scope, name)
            case e.UnitDeclaration(name, _):
                return NumberType("real", unit=name, name=name)
            case e.ClassDeclaration():
                return ClassType(declared)
        raise UnsupportedEsdlError(f"{declared.label} is not a type")

    def resolve(self, kind: e.TypeExpression, scope: FileScope, name: str = "") -> Type:
        """Resolve the type that an expression defines."""
        match kind:
            case e.TypeName(other):
                return self.named(other, scope)
            case e.ScalarType():
                return self._number(kind, scope, name)
            case e.EnumType(labels):
                return self._enumeration(labels, scope, name)
            case e.StructType(elements):
                return self._struct(elements, scope, name)
            case e.ArrayType(sizes, element):
                return self._array(sizes, self.resolve(element, scope), scope)
            case e.TableType(axes, value, form):
                return self._table(axes, value, form, scope)
            case e.AxisType(element):
                return ResolvedAxis(self._as_number(self.resolve(element, scope)), name)
            case e.UnsupportedType(word):
                raise UnsupportedEsdlError(f"types of the kind {word} are not supported")

    def _struct(self, elements: tuple[e.Element, ...], scope: FileScope, name: str) -> StructType:
        kinds = tuple((item.name, self.element(item, scope)) for item in elements)
        size = sum(size_of(kind) for _, kind in kinds)
        if size > _MAX_SIZE:
            raise UnsupportedEsdlError(f"the struct {name} has more than {_MAX_SIZE} elements")
        return StructType(name, kinds, size)

    def element(self, element: e.Element, scope: FileScope) -> Type:
        """Return the type of an element; sizes behind its name fill the open dimensions of its type."""
        kind = self.resolve(element.type, scope)
        if not element.sizes or isinstance(kind, ResolvedTable | ResolvedAxis):
            return kind
        if isinstance(kind, ResolvedArray) and len(kind.dimensions) == len(element.sizes):
            return ResolvedArray(tuple(self.dimension(size, scope) for size in element.sizes), kind.element)
        return self._array(element.sizes, kind, scope)

    def _number(self, kind: e.ScalarType, scope: FileScope, name: str) -> NumberType:
        base = self._as_number(self.named(kind.base, scope))
        low, high = base.low, base.high
        # `using` states the representation, whose range holds unless one is written
        if kind.using in _DATATYPES and base.kind == "integer":
            low, high = _DATATYPES[kind.using]
        is_limited = base.is_limited
        if kind.range is not None:
            low, high = self._limits(kind.range, scope, base)
        if kind.range is not None and base.kind == "real":
            # generated code keeps a real with a range and a resolution as an integer, and limits it there
            has_resolution = kind.delta is not None or base.is_limited
            by_default = has_resolution if kind.is_limited is None else kind.is_limited
            is_limited = by_default if self._limits_reals is None else self._limits_reals
        return NumberType(base.kind, low, high, kind.unit or base.unit, base.labels, name, is_limited)

    def _limits(self, limits: e.Range, scope: FileScope, base: NumberType) -> tuple[float, float]:
        low = base.low if limits.first is None else self.constant(limits.first, scope)
        if limits.last is not None:
            high = self.constant(limits.last, scope)
        else:
            # a range without an end: an integer that is never negative may be unsigned
            high = 2.0**32 - 1 if base.kind == "integer" and low >= 0 else base.high
        if not low <= high:
            raise UnsupportedEsdlError(f"the range {low:g} .. {high:g} is empty")
        return low, high

    def _as_number(self, kind: Type) -> NumberType:
        if not isinstance(kind, NumberType):
            raise UnsupportedEsdlError("a type of numbers is required here")
        return kind

    def _enumeration(
        self, labels: tuple[tuple[str, e.Expression | None], ...], scope: FileScope, name: str
    ) -> NumberType:
        numbers: list[tuple[str, int]] = []
        following = 0
        for label, value in labels:
            # a label without a number has the next one
            following = following if value is None else int(self.constant(value, scope))
            numbers.append((label, following))
            following += 1
        if not numbers:
            raise UnsupportedEsdlError(f"the enumeration {name} has no labels")
        values = [number for _, number in numbers]
        return NumberType("enumeration", min(values), max(values), "", tuple(numbers), name)

    def _array(self, sizes: tuple[e.Expression | None, ...], element: Type, scope: FileScope) -> ResolvedArray:
        own = tuple(self.dimension(size, scope) for size in sizes)
        # an array of arrays is one of more dimensions
        inner, element = (element.dimensions, element.element) if isinstance(element, ResolvedArray) else ((), element)
        dimensions = (*own, *inner)
        result = ResolvedArray(dimensions, element)
        if size_of(result) > _MAX_SIZE or len(dimensions) > 3:
            raise UnsupportedEsdlError(f"an array of more than {_MAX_SIZE} elements or 3 dimensions")
        return result

    def dimension(self, size: e.Expression | None, scope: FileScope) -> Dimension:
        """Return a dimension: a size, a range, or the values of a type."""
        if size is None:
            return Dimension()
        if isinstance(size, e.Range):
            if size.first is None or size.last is None:
                raise UnsupportedEsdlError("the dimension of an array is open")
            return _checked(self.constant(size.first, scope), self.constant(size.last, scope))
        # the name of a type stands for its values, such as the labels of an enumeration
        if isinstance(size, e.Name | e.Field) and (kind := self._index_type(dotted(size), scope)) is not None:
            return _checked(kind.low, kind.high, kind if kind.labels else None)
        return _checked(0, self.constant(size, scope) - 1)

    def _index_type(self, name: str, scope: FileScope) -> NumberType | None:
        declared = scope.find(name)
        if declared is None or not isinstance(declared.declaration, e.TypeDeclaration):
            return None
        return self._as_number(self.declared(declared))

    def _table(
        self, axes: tuple[e.TypeExpression, ...], value: e.TypeExpression, form: str, scope: FileScope
    ) -> ResolvedTable:
        kinds, names = list[NumberType](), list[str]()
        for axis in axes:
            kind = self.resolve(axis, scope)
            names.append(kind.name if isinstance(kind, ResolvedAxis) else "")
            kinds.append(kind.element if isinstance(kind, ResolvedAxis) else self._as_number(kind))
        if len(kinds) > 4:
            raise UnsupportedEsdlError(f"a table of {len(kinds)} axes; tables have at most 4")
        return ResolvedTable(tuple(kinds), self._as_number(self.resolve(value, scope)), form, tuple(names))

    # constants

    def constant(self, tree: e.Expression, scope: FileScope) -> float:
        """Evaluate a constant expression."""
        match tree:
            case e.Number(value):
                return value
            case e.Truth(value):
                return float(value)
            case e.Unary(operator, operand) if operator in "+-!":
                value = self.constant(operand, scope)
                return -value if operator == "-" else float(not value) if operator == "!" else value
            case e.Binary(operator, left, right) if operator in ("+", "-", "*", "/"):
                return _arithmetic(operator, self.constant(left, scope), self.constant(right, scope))
            case e.Name() | e.Field() if name := dotted(tree):
                return self._named_constant(name, scope)
            case e.Unsupported():
                raise unsupported_error(tree)
        raise UnsupportedEsdlError("a constant is required here", place=tree.place)

    def _named_constant(self, name: str, scope: FileScope) -> float:
        declared = scope.find(name)
        if declared is not None and isinstance(declared.declaration, e.Constant):
            value = declared.declaration.element.value
            if value is None or len(self._open) > _MAX_REFERENCES:
                raise UnsupportedEsdlError(f"the constant {name} has no value")
            self._open.append(name)
            try:
                return self.constant(value, declared.scope)
            finally:
                self._open.pop()
        of, _, label = name.rpartition(".")
        kind = self._index_type(of, scope) if of else None
        if kind is not None and label in dict(kind.labels):
            return float(dict(kind.labels)[label])
        raise UnsupportedEsdlError(f"{name} is not a constant")


def dotted(tree: e.Expression) -> str:
    """Return `a.b.c` as a text; empty if the expression is not a chain of names."""
    names: list[str] = []
    while isinstance(tree, e.Field):
        names.append(tree.name)
        tree = tree.of
    return ".".join([tree.name, *reversed(names)]) if isinstance(tree, e.Name) else ""


def _arithmetic(operator: str, a: float, b: float) -> float:
    if operator == "/" and b == 0:
        raise UnsupportedEsdlError("division by zero in a constant")
    result = {"+": a + b, "-": a - b, "*": a * b, "/": a / (b or 1.0)}[operator]
    if not math.isfinite(result):
        raise UnsupportedEsdlError("a constant is too large")
    return result


def _checked(first: float, last: float, enumeration: NumberType | None = None) -> Dimension:
    if not (math.isfinite(first) and math.isfinite(last)) or not first <= last < first + _MAX_SIZE:
        raise UnsupportedEsdlError(f"an array with indices {first:g} .. {last:g}")
    return Dimension(int(first), int(last) - int(first) + 1, enumeration)
