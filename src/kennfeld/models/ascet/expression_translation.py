"""Translation of ESDL expressions to the shared syntax tree, with their types."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, Final, TypeVar

from kennfeld.ascet import syntax as e
from kennfeld.ascet.expression_parser import EsdlExpressionParser, EsdlSyntaxError
from kennfeld.ascet.lexer import tokens_of
from kennfeld.formatting import count_noun, nearest
from kennfeld.matlab import syntax as m
from kennfeld.models.ascet.functions import EXTERNAL, FUNCTIONS
from kennfeld.models.ascet.instances import ClassInstance, Program, searched_label
from kennfeld.models.ascet.name_resolution import (
    DependentParameter,
    EnumerationLabel,
    EnumerationName,
    MachineName,
    Named,
    NameResolver,
    state_place,
)
from kennfeld.models.ascet.program_code import MethodCode, Operand, Place, ProgramCode, leaf_names
from kennfeld.models.ascet.resolved_types import (
    BOOLEAN,
    INTEGER,
    REAL,
    ArrayType,
    AxisType,
    Dimension,
    NumberType,
    StructType,
    TableType,
    Type,
    describe_type,
    leaves_of,
    with_sizes,
)
from kennfeld.models.ascet.type_resolution import dotted
from kennfeld.models.ascet.unsupported import UnsupportedEsdlError

_COMPARISONS: Final = {"==": "==", "!=": "~=", "<": "<", "<=": "<=", ">": ">", ">=": ">="}
_BITS: Final = {"&": "and", "|": "or", "^": "xor", "<<": "shift", ">>": "shift"}
_INTRINSIC: Final = ("abs", "min", "max", "between", "sqrt", "exp", "log", "sin", "cos", "tan", "pow")
Result = TypeVar("Result")


def position(place: e.TextPosition) -> m.SourcePosition:
    """Return a position for the shared syntax tree."""
    return m.SourcePosition(place.line, place.column)


def call_of(name: str, *arguments: m.Expression) -> m.Call:
    """Return a call of a function of the library."""
    return m.Call(m.Name(f"esdl:{name}"), arguments)


class ExpressionTranslation:
    """Translates expressions of the methods of an instance.

    `pending` are statements that must run before the one that contains the expression.
    """

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
            case e.Number(value, is_real):
                kind = REAL if is_real else NumberType("integer", value, value)
                return Operand(m.Number(value), kind)
            case e.Truth(value):
                return Operand(m.Number(float(value)), BOOLEAN)
            case e.Braces():
                return tree
            case e.Name() | e.Member() | e.Index():
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
        raise UnsupportedEsdlError("this expression is not supported", place=tree.place)

    def named(self, tree: e.Expression) -> Named:
        """Return what a name, a member or an element refers to."""
        match tree:
            case e.Name():
                return self.names.name(tree)
            case e.Member(of, _):
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
        if not isinstance(place.type, ArrayType):
            raise UnsupportedEsdlError(f"{place.leaf()} is not an array", place=index.place)
        dimension, *rest = place.type.dimensions
        kind: Type = ArrayType(tuple(rest), place.type.element) if rest else place.type.element
        at = self._index(dimension, self.operand(index), index)
        return replace(place, type=kind, indices=(*place.indices, at))

    def _index(self, dimension: Dimension, operand: Operand, tree: e.Expression) -> m.Expression:
        """Return an index from 1; one out of range takes the nearest element, as generated code does."""
        if operand.type.kind == "real":
            raise UnsupportedEsdlError("an index must be an integer", place=tree.place)
        if dimension.size is None:
            raise UnsupportedEsdlError("the size of the array is not known here", place=tree.place)
        labels = dimension.enumeration.labels if dimension.enumeration is not None else ()
        if labels and [number for _, number in labels] != list(range(dimension.first, dimension.first + len(labels))):
            raise UnsupportedEsdlError("the numbers of the enumeration have gaps", place=tree.place)
        if isinstance(operand.tree, m.Number):
            at = operand.tree.value - dimension.first
            return m.Number(min(max(at, 0.0), dimension.size - 1.0) + 1.0)
        return call_of("index", operand.tree, m.Number(float(dimension.first)), m.Number(float(dimension.size)))

    def _dependent(self, instance: ClassInstance, element: e.Element, tree: e.Expression) -> Operand:
        """Translate the formula of a dependent parameter."""
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
        outer, self.names = self.names, NameResolver(self.program, instance)
        try:
            return self.nested(element.name, lambda: self.operand(_substituted(formula, dict(letters), element.place)))
        finally:
            self.names = outer

    def nested(self, name: str, read: Callable[[], Result]) -> Result:
        """Call `read`; raises `UnsupportedEsdlError` if dependent parameters depend on each other."""
        open_names: list[str] = self.__dict__.setdefault("_open_names", [])
        if name in open_names:
            raise UnsupportedEsdlError(f"the dependent parameter {name} depends on itself")
        open_names.append(name)
        try:
            return read()
        finally:
            open_names.pop()

    # operators

    def _unary(self, operator: str, operand: Operand) -> Operand:
        match operator:
            case "+":
                return operand
            case "-":
                if isinstance(operand.tree, m.Number):
                    kind = operand.type if operand.type.kind == "real" else _literal(-operand.tree.value)
                    return Operand(m.Number(-operand.tree.value), kind)
                return Operand(m.Unary("-", operand.tree), _arithmetic_type(operand.type, operand.type))
            case "!":
                return Operand(m.Unary("~", operand.tree), BOOLEAN)
        self._require_whole(operand)
        if operand.type.low >= 0:
            mask = 2.0 ** max(1, int(operand.type.high).bit_length()) - 1.0
            return Operand(m.Binary("-", m.Number(mask), operand.tree), operand.type)
        return Operand(m.Binary("-", m.Unary("-", operand.tree), m.Number(1.0)), INTEGER)

    def _require_whole(self, *operands: Operand) -> None:
        if not all(operand.type.kind in ("integer", "enumeration") for operand in operands):
            raise UnsupportedEsdlError("bit operators require integers")

    def _binary(self, tree: e.Binary) -> Operand:
        operator = tree.operator
        left = self.operand(tree.left)
        if operator in ("&&", "||"):
            right = self.lazily(lambda: self.operand(tree.right))
            return Operand(m.Binary(operator, left.tree, right.tree), BOOLEAN)
        right = self.operand(tree.right)
        place = position(tree.place)
        if operator in _COMPARISONS:
            return Operand(m.Binary(_COMPARISONS[operator], left.tree, right.tree, place=place), BOOLEAN)
        if operator in _BITS:
            return self._bits(operator, left, right)
        kind = _arithmetic_type(left.type, right.type)
        if operator == "/":
            return Operand(call_of("quotient" if kind.is_whole else "divide", left.tree, right.tree), kind)
        if operator == "%":
            return Operand(call_of("remainder", left.tree, right.tree), kind)
        return Operand(m.Binary(f".{operator}" if operator == "*" else operator, left.tree, right.tree), kind)

    def _bits(self, operator: str, left: Operand, right: Operand) -> Operand:
        if left.type.kind == right.type.kind == "boolean" and operator in "&|^":
            return Operand(m.Binary("~=" if operator == "^" else operator, left.tree, right.tree), BOOLEAN)
        self._require_whole(left, right)
        by = m.Unary("-", right.tree) if operator == ">>" else right.tree
        sign = m.Number(float(left.type.low < 0 or right.type.low < 0))
        kind = INTEGER if sign.value else NumberType("integer", 0.0, 2.0**32 - 1)
        return Operand(call_of(_BITS[operator], left.tree, by, sign), kind)

    def _between(self, operand: Operand, low: Operand, high: Operand) -> Operand:
        above = m.Binary(">=", operand.tree, low.tree)
        return Operand(m.Binary("&", above, m.Binary("<=", operand.tree, high.tree)), BOOLEAN)

    def lazily(self, translate: Callable[[], Result]) -> Result:
        """Translate an expression that is evaluated only under a condition."""
        self._lazy += 1
        try:
            return translate()
        finally:
            self._lazy -= 1

    def _conditional(self, condition: Operand, yes: e.Expression, no: e.Expression) -> Operand:
        first, second = (self.lazily(lambda tree=tree: self.operand(tree)) for tree in (yes, no))  # type: ignore[misc]
        return _conditional(condition.tree, first, second)

    def _choice(self, tree: e.Choice) -> Operand:
        if tree.otherwise is None:
            raise UnsupportedEsdlError("a switch expression without default", place=tree.place)
        subject = self.operand(tree.subject)
        result = self.lazily(lambda: self.operand(tree.otherwise))  # type: ignore[arg-type]
        for keys, value in reversed(tree.cases):
            condition = self.matches(subject, keys)
            chosen = self.lazily(lambda value=value: self.operand(value))  # type: ignore[misc]
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

    # calls

    def _call(self, tree: e.Call) -> Operand | Place:
        result = self.call(tree)
        if result is None:
            raise UnsupportedEsdlError("the method returns no value", place=tree.place)
        return result

    def call(self, tree: e.Call) -> Operand | Place | None:
        """Translate a call; None for a method without a result, whose call is then pending."""
        if isinstance(tree.of, e.Name):
            return self._call_by_name(tree, tree.of.name)
        if not isinstance(tree.of, e.Member):
            raise UnsupportedEsdlError("this call is not supported", place=tree.place)
        of, name = self.named(tree.of.of), tree.of.name
        if isinstance(of, ClassInstance):
            return self._method(of, name, tree)
        return self._intrinsic(of, name, tree)

    def _call_by_name(self, tree: e.Call, name: str) -> Operand | Place | None:
        if self.instance.method(name) is not None:
            return self._method(self.instance, name, tree)
        if name in _INTRINSIC or name in FUNCTIONS:
            return self._function(name, tree)
        return self._conversion(name, tree)

    def _function(self, name: str, tree: e.Call) -> Operand:
        operands = [self.operand(argument) for argument in tree.arguments]
        if name == "between" and len(operands) == 3:
            return self._between(*operands)
        if name in ("min", "max") and len(operands) > 1:
            result = operands[0]
            for other in operands[1:]:
                kind = _arithmetic_type(result.type, other.type)
                result = Operand(call_of(name, result.tree, other.tree), kind)
            return result
        if name not in FUNCTIONS or FUNCTIONS[name].count != len(operands):
            raise UnsupportedEsdlError(f"{name} with {count_noun(len(operands), 'argument')}", place=tree.place)
        kind = _arithmetic_type(operands[0].type, operands[0].type) if name == "abs" else REAL
        return Operand(call_of(name, *(operand.tree for operand in operands)), kind)

    def _conversion(self, name: str, tree: e.Call) -> Operand:
        """Translate `real(x)`, or the conversion to another type of numbers."""
        try:
            kind = self.program.types.named(name, self.instance.scope)
        except UnsupportedEsdlError:
            known = [*(method.name for method in self.instance.declaration.methods), *_INTRINSIC]
            raise UnsupportedEsdlError(f"unknown method {name}", nearest(name, known), tree.place) from None
        if not isinstance(kind, NumberType) or len(tree.arguments) != 1:
            raise UnsupportedEsdlError(f"a conversion to {describe_type(kind)}", place=tree.place)
        operand = self.operand(tree.arguments[0])
        if kind.kind == "real" and isinstance(operand.tree, m.Call) and operand.tree.of == m.Name("esdl:quotient"):
            # generated code divides integers as reals if the quotient is converted at once
            return Operand(call_of("divide", *operand.tree.arguments), kind)
        return Operand(self.converted(operand, kind), kind)

    def converted(self, operand: Operand, kind: NumberType) -> m.Expression:
        """Return a number converted to a type: integers are cut off towards 0 and limited to the range of the type."""
        tree = operand.tree
        if not kind.is_whole or operand.type.kind == "boolean":
            return tree
        if operand.type.kind == "real":
            tree = call_of("truncate", tree)
        elif kind.low <= operand.type.low and operand.type.high <= kind.high:
            return tree
        return call_of("limit", tree, m.Number(kind.low), m.Number(kind.high))

    def _method(self, instance: ClassInstance, name: str, tree: e.Call) -> Operand | Place | None:
        method = instance.method(name)
        if method is None:
            known = [method.name for method in instance.declaration.methods]
            message = f"{instance.declared.name} has no method {name}"
            raise UnsupportedEsdlError(message, nearest(name, known), tree.place)
        if method.body is None and not method.triggers:
            return self._external(instance, method, tree)
        if len(method.arguments) != len(tree.arguments):
            expected = count_noun(len(method.arguments), "argument")
            raise UnsupportedEsdlError(f"{name} takes {expected}, got {len(tree.arguments)}", place=tree.place)
        values = [self.value(argument) for argument in tree.arguments]
        kinds = [
            self._argument_type(instance, argument, value)
            for argument, value in zip(method.arguments, values, strict=True)
        ]
        code = self.code.method(instance, method, kinds)
        trees: list[m.Expression] = []
        for argument, value, kind, written in zip(method.arguments, values, kinds, tree.arguments, strict=True):
            trees += self._argument_trees(instance, argument, value, kind, written)
        return self._called(code, method, trees, values, tree)

    def _argument_type(
        self, instance: ClassInstance, argument: e.Argument, value: Operand | Place | e.Braces
    ) -> Type | None:
        """Return the type of an argument with its sizes; None for a number."""
        kind = self.program.types.resolve(argument.type, instance.scope)
        if isinstance(kind, NumberType):
            return None
        if not isinstance(kind, ArrayType | StructType):
            raise UnsupportedEsdlError(f"{argument.name} is {describe_type(kind)}, which cannot be passed to a method")
        return with_sizes(kind, value.type) if isinstance(value, Place) else kind

    def _argument_trees(
        self,
        instance: ClassInstance,
        argument: e.Argument,
        value: Operand | Place | e.Braces,
        kind: Type | None,
        written: e.Expression,
    ) -> list[m.Expression]:
        if kind is None:
            own = self.program.types.resolve(argument.type, instance.scope)
            assert isinstance(own, NumberType)
            operand = value if isinstance(value, Operand) else self.operand(written)
            return [self.converted(operand, own)]
        if isinstance(value, e.Braces):
            value = self.temporary(kind, value)
        if not isinstance(value, Place):
            raise UnsupportedEsdlError(f"{argument.name} must be {describe_type(kind)}", place=written.place)
        if value.indices:
            value = self.temporary(kind, value)
        return [self.leaf_tree(value, path) for path, _, _ in leaves_of(kind)]

    def temporary(self, kind: Type, value: Place | e.Braces) -> Place:
        """Return a new local variable with the value; overridden where statements are translated."""
        raise UnsupportedEsdlError("this value is not supported here")

    def _called(
        self,
        code: MethodCode,
        method: e.Method,
        trees: list[m.Expression],
        values: Sequence[Operand | Place | e.Braces],
        tree: e.Call,
    ) -> Operand | Place | None:
        call = m.Call(m.Name(code.name), tuple(trees), place=position(tree.place))
        if isinstance(code.result, NumberType) and not code.outputs:
            return Operand(call, code.result)
        if self._lazy:
            message = f"{method.name} changes its arguments or returns several numbers within a condition"
            raise UnsupportedEsdlError(message, "Call it in a statement of its own.", tree.place)
        self._temporaries += 1
        name = f"%{self._temporaries}"
        targets: list[m.Expression | None] = []
        if code.result is not None:
            targets += [m.Name(leaf) for leaf in leaf_names(name, code.result)]
        for at in code.outputs:
            targets += self._changed(values[at], method.arguments[at], tree)
        if targets:
            self.pending.append(m.Assign(tuple(targets), call, place=position(tree.place)))
        else:
            self.pending.append(m.Evaluate(call, place=position(tree.place)))
        if code.result is None:
            return None
        result = Place(name, code.result, is_local=True)
        return self.operand_of(result) if isinstance(code.result, NumberType) else result

    def operand_of(self, place: Place) -> Operand:
        """Return the number of a place whose type is a number."""
        assert isinstance(place.type, NumberType)
        return Operand(self.leaf_tree(place), place.type)

    def _changed(self, value: Operand | Place | e.Braces, argument: e.Argument, tree: e.Call) -> list[m.Expression]:
        """Return the trees that an argument is assigned to after the call."""
        if not isinstance(value, Place) or value.is_fixed:
            raise UnsupportedEsdlError(f"the argument {argument.name} must be a variable", place=tree.place)
        self.note_assigned(value)
        return [self.leaf_tree(value, path) for path, _, _ in leaves_of(value.type)]

    def note_assigned(self, place: Place) -> None:
        """Remember that a variable is assigned."""
        if not place.is_local:
            names = {place.leaf(path) for path, _, _ in leaves_of(place.type)}
            self.code.assigned |= names
            self.used |= names

    def _external(self, instance: ClassInstance, method: e.Method, tree: e.Call) -> Operand:
        """Translate a call of a function in C that is known: of the mathematics library, or of bits."""
        symbol = method.annotation("symbol")
        argument = symbol.arguments[0] if symbol is not None and symbol.arguments else None
        name = argument.value if isinstance(argument, e.Text) else ""
        label = f"{instance.declared.label}.{method.name}"
        rule = EXTERNAL.get(label) or EXTERNAL.get(name)
        operands = [self.operand(argument) for argument in tree.arguments]
        if rule is None or rule.count != len(operands):
            message = f"{instance.declared.name}.{method.name} is implemented in C, which is not supported"
            raise UnsupportedEsdlError(message, place=tree.place)
        kind = self.program.types.resolve(method.result, instance.scope) if method.result is not None else REAL
        if not isinstance(kind, NumberType):
            raise UnsupportedEsdlError(f"{method.name} returns {describe_type(kind)}", place=tree.place)
        return Operand(call_of(rule.name, *(operand.tree for operand in operands)), kind)

    # intrinsic methods

    def _intrinsic(self, of: Named, name: str, tree: e.Call) -> Operand | Place | None:
        match of:
            case MachineName(instance, machine) if name == "getState":
                return self._state(instance, machine)
            case EnumerationLabel(value, _) if name == "value":
                return Operand(m.Number(float(value)), INTEGER)
            case Place(_, TableType()):
                return self._lookup(of, name, tree)
            case Place(_, AxisType()) if name == "search" and len(tree.arguments) == 1:
                self._search(of, tree)
                return None
            case Place(_, ArrayType(dimensions)) if name == "length":
                return Operand(m.Number(float(dimensions[self._dimension(tree, dimensions)].size or 0)), INTEGER)
            case Place(_, NumberType()) if name in ("value", "get"):
                operand = self.operand_of(of)
                return Operand(operand.tree, INTEGER if operand.type.is_whole else operand.type)
        raise UnsupportedEsdlError(f"{dotted(tree.of) or name}() is not supported", place=tree.place)

    def _dimension(self, tree: e.Call, dimensions: Sequence[Dimension]) -> int:
        at = int(self.program.types.constant(tree.arguments[0], self.instance.scope)) if tree.arguments else 0
        if not 0 <= at < len(dimensions):
            raise UnsupportedEsdlError(f"the array has no dimension {at}", place=tree.place)
        return at

    def _state(self, instance: ClassInstance, machine: e.StateMachine) -> Operand:
        kind: Type = INTEGER
        if machine.labels:
            kind = self.program.types.named(machine.labels, instance.scope)
        assert isinstance(kind, NumberType)
        return self.operand_of(state_place(instance, machine, kind))

    def _lookup(self, of: Place, name: str, tree: e.Call) -> Operand:
        assert isinstance(of.type, TableType)
        table = self.program.tables[of.label]
        if name == "getAt" and len(tree.arguments) == len(of.type.axes):
            coordinates = [self.operand(argument).tree for argument in tree.arguments]
        elif name == "interpolate" and table.shared and not tree.arguments:
            labels = [searched_label(axis) for axis in table.shared]
            self.used |= set(labels)
            coordinates = [m.Name(label) for label in labels]
        else:
            raise UnsupportedEsdlError(f"{dotted(tree.of)}() is not supported", "Use getAt.", tree.place)
        return Operand(call_of("lookup", m.Text(of.label), *coordinates), of.type.value)

    def _search(self, of: Place, tree: e.Call) -> None:
        """Translate `axis.search(x)`: group tables are interpolated at the last value searched."""
        if self._lazy:
            raise UnsupportedEsdlError("search within a condition", place=tree.place)
        label = searched_label(of.label)
        self.used.add(label)
        self.code.assigned.add(label)
        value = self.operand(tree.arguments[0])
        self.pending.append(m.Assign((m.Name(label),), value.tree, place=position(tree.place)))


def _conditional(condition: m.Expression, yes: Operand, no: Operand) -> Operand:
    kind = yes.type if yes.type == no.type else _arithmetic_type(yes.type, no.type)
    return Operand(m.Conditional(condition, yes.tree, no.tree), kind)


def _arithmetic_type(left: NumberType, right: NumberType) -> NumberType:
    """Return the type of a sum or product; its range is that of the type to which it is assigned."""
    if left.kind == right.kind == "boolean":
        return BOOLEAN
    is_real = "real" in (left.kind, right.kind)
    return REAL if is_real else NumberType("integer")


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
            name: place if name == "place" else _substituted(getattr(tree, name), letters, place) for name in names
        }
        return replace(tree, **changes)
    return tree


__all__ = ["EnumerationName", "ExpressionTranslation", "Program", "call_of", "position"]
