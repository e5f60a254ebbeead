"""Translation of calls: methods, functions, conversions, and the intrinsic methods of tables, arrays and states."""

import math
from collections.abc import Sequence
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.base.formatting import count_noun, nearest
from kennfeld.importers.ascet.c_methods import changes_nothing, is_calculated, known_rule, required_c_file
from kennfeld.importers.ascet.expression_translation import (
    ExpressionTranslation,
    arithmetic_type,
    call_of,
)
from kennfeld.importers.ascet.functions import FUNCTIONS
from kennfeld.importers.ascet.instances import ClassInstance, searched_label, searched_labels
from kennfeld.importers.ascet.name_resolution import EnumerationLabel, MachineName, Named, state_place
from kennfeld.importers.ascet.program_code import MethodCode, Operand, Place, leaf_names
from kennfeld.importers.ascet.resolved_types import (
    INTEGER,
    REAL,
    Dimension,
    NumberType,
    ResolvedArray,
    ResolvedAxis,
    ResolvedTable,
    StructType,
    Type,
    describe_type,
    leaves_of,
    with_sizes,
)
from kennfeld.importers.ascet.type_resolution import dotted
from kennfeld.importers.ascet.unsupported import UnsupportedEsdlError
from kennfeld.importers.rules import RuleFunction
from kennfeld.program import tree as m

_INTRINSIC: Final = ("abs", "min", "max", "between", "sqrt", "exp", "log", "sin", "cos", "tan", "pow")


class CallTranslation(ExpressionTranslation):
    """Translates expressions with calls."""

    def call(self, tree: e.Call) -> Operand | Place | None:
        """Translate a call; None for a method without a result, whose call is then pending."""
        if isinstance(tree.of, e.Name):
            return self._call_by_name(tree, tree.of.name)
        if not isinstance(tree.of, e.Field):
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
                kind = arithmetic_type(result.type, other.type)
                result = Operand(call_of(name, result.tree, other.tree), kind)
            return result
        if name not in FUNCTIONS or FUNCTIONS[name].count != len(operands):
            raise UnsupportedEsdlError(f"{name} with {count_noun(len(operands), 'argument')}", place=tree.place)
        # abs of an integer is one; the other functions are those of reals, whatever they are called with
        kind = arithmetic_type(operands[0].type, operands[0].type) if name == "abs" else REAL
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
            return Operand(call_of("ratio", *operand.tree.arguments), kind)
        return Operand(self.converted(operand, kind), kind)

    def converted(self, operand: Operand, kind: NumberType) -> m.Expression:
        """Return a number converted to a type: integers are cut off towards 0 and limited to the range of the type.

        In C they keep the lowest bits of the type instead. Reals are limited if generated code limits them.
        """
        tree = operand.tree
        if self.wraps and kind.kind == "boolean" and operand.type.kind != "boolean":
            # C takes any other number than 0 as true
            return m.Binary("~=", tree, m.Number(0.0))
        if kind.is_limited and not self.wraps and not (kind.low <= operand.type.low and operand.type.high <= kind.high):
            return _within(tree, kind)
        if not kind.is_whole or operand.type.kind == "boolean":
            return tree
        if operand.type.kind == "real":
            tree = call_of("truncate", tree)
        # a sum of integers has an unlimited range, and is limited where it is converted
        elif kind.low <= operand.type.low and operand.type.high <= kind.high:
            return tree
        if self.wraps:
            return _wrapped(tree, kind)
        return call_of("limit", tree, m.Number(kind.low), m.Number(kind.high))

    def _method(self, instance: ClassInstance, name: str, tree: e.Call) -> Operand | Place | None:
        method = instance.method(name)
        if method is None:
            known = [method.name for method in instance.declaration.methods]
            message = f"{instance.declared.name} has no method {name}"
            raise UnsupportedEsdlError(message, nearest(name, known), tree.place)
        if len(method.arguments) != len(tree.arguments):
            expected = count_noun(len(method.arguments), "argument")
            raise UnsupportedEsdlError(f"{name} takes {expected}, got {len(tree.arguments)}", place=tree.place)
        if method.is_in_c:
            rule = known_rule(instance, method)
            if rule is not None:
                return self._external(instance, method, rule, tree)
            # code that writes a log or drives hardware cannot be translated, and need not be
            if changes_nothing(instance, method) and not is_calculated(instance, method):
                self._skipped(instance, method, tree)
                return None
            required_c_file(instance, method, tree.place)
        values = [self.value(argument) for argument in tree.arguments]
        kinds = [
            self._argument_type(instance, argument, value)
            for argument, value in zip(method.arguments, values, strict=True)
        ]
        # each combination of array sizes is a function of its own
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
        if not isinstance(kind, ResolvedArray | StructType):
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
            # a part of an array: its numbers are copied to arrays of their own
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
        call = m.Call(m.Name(code.name), tuple(trees), place=tree.place)
        # one number and no changed arguments: the call is an expression
        if isinstance(code.result, NumberType) and not code.outputs:
            return Operand(call, code.result)
        # statements before the expression would run although the condition does not hold
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
            self.pending.append(m.Assign(tuple(targets), call, place=tree.place))
        else:
            self.pending.append(m.Evaluate(call, place=tree.place))
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

    def _skipped(self, instance: ClassInstance, method: e.Method, tree: e.Call) -> None:
        """Skip a call of a method in C that has nothing to change, such as an assertion."""
        for argument in tree.arguments:
            # methods that the arguments call run all the same
            self.once(self.operand(argument).tree, tree.place)
        self.code.skipped.setdefault(f"{instance.declared.label}.{method.name}")

    def _external(self, instance: ClassInstance, method: e.Method, rule: RuleFunction, tree: e.Call) -> Operand:
        """Translate a call of a function in C that is known: of the mathematics library, or of bits."""
        kind = self.program.types.resolve(method.result, instance.scope) if method.result is not None else REAL
        if not isinstance(kind, NumberType):
            raise UnsupportedEsdlError(f"{method.name} returns {describe_type(kind)}", place=tree.place)
        operands = [self.operand(argument) for argument in tree.arguments]
        return Operand(call_of(rule.name, *(operand.tree for operand in operands)), kind)

    # intrinsic methods

    def _intrinsic(self, of: Named, name: str, tree: e.Call) -> Operand | Place | None:
        match of:
            case MachineName(instance, machine) if name == "getState":
                return self._state(instance, machine)
            case EnumerationLabel(value, _) if name == "value":
                return Operand(m.Number(float(value)), INTEGER)
            case Place(_, ResolvedTable(axes)) if name == "search" and len(tree.arguments) == len(axes):
                self._search(searched_labels(self.program.tables[of.label]), tree)
                return None
            case Place(_, ResolvedTable()):
                return self._lookup(of, name, tree)
            case Place(_, ResolvedAxis()) if name == "search" and len(tree.arguments) == 1:
                self._search((searched_label(of.label),), tree)
                return None
            case Place(_, ResolvedArray(dimensions)) if name == "length":
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
        assert isinstance(of.type, ResolvedTable)
        table = self.program.tables[of.label]
        if name == "getAt" and len(tree.arguments) == len(of.type.axes):
            coordinates = [self.operand(argument).tree for argument in tree.arguments]
        elif name == "interpolate" and not tree.arguments:
            # interpolate() takes no arguments: the axes keep what was searched on them
            labels = searched_labels(table)
            self.used |= set(labels)
            coordinates = [m.Name(label) for label in labels]
        else:
            raise UnsupportedEsdlError(f"{dotted(tree.of)}() is not supported", "Use getAt.", tree.place)
        return Operand(call_of("lookup", m.Text(of.label), *coordinates), of.type.value)

    def _search(self, labels: Sequence[str], tree: e.Call) -> None:
        """Translate `axis.search(x)` or `table.search(x, y)`: tables are interpolated at the last values searched."""
        if self._lazy:
            raise UnsupportedEsdlError("search within a condition", place=tree.place)
        self.used |= set(labels)
        self.code.assigned |= set(labels)
        for label, argument in zip(labels, tree.arguments, strict=True):
            value = self.operand(argument)
            self.pending.append(m.Assign((m.Name(label),), value.tree, place=tree.place))


def _wrapped(tree: m.Expression, kind: NumberType) -> m.Expression:
    """Return an integer with the bits of a type; unchanged for a range that is not that of a type of C."""
    size = kind.high - kind.low + 1.0
    is_word = size in (2.0**8, 2.0**16, 2.0**32) and kind.low in (0.0, -size / 2)
    return call_of("wrap", tree, m.Number(kind.low), m.Number(size)) if is_word else tree


def _within(tree: m.Expression, kind: NumberType) -> m.Expression:
    """Return a real number limited to the ends of a range that are finite."""
    if math.isfinite(kind.low) and math.isfinite(kind.high):
        return call_of("limit", tree, m.Number(kind.low), m.Number(kind.high))
    return (
        call_of("max", tree, m.Number(kind.low))
        if math.isfinite(kind.low)
        else call_of("min", tree, m.Number(kind.high))
    )
