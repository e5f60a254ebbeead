"""Assignments to the elements that a mask chooses where the mask depends on signals: `x(x > 1) = 2*x(x > 1)`.

Where each element of the right side depends on the same element of its arrays alone, all elements may be computed, and
each one takes its new value or keeps its old one.

Values of expressions in code: operators, arrays, structs, and which function a call means.

A name means a variable, else a function of the code or beside it, else one of the library, else a parameter of the
model, else what the host of the code knows.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.matlab.traversal import field_path
from kennfeld.models.imperative.element_access import fixed_element, index_value
from kennfeld.models.imperative.evaluation_context import evaluate_constant_call
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.graph_operators import BINARY, range_between
from kennfeld.models.imperative.library.elementwise_functions import ELEMENTWISE_NAMES
from kennfeld.models.imperative.library.function_registry import SYMBOLIC_FUNCTIONS, TAKES_TABLES
from kennfeld.models.imperative.library.reduction_functions import (
    checked_matrix_product,
    matrix_divide,
    matrix_power,
    transposed,
)
from kennfeld.models.imperative.node_arrays import Nodes, elementwise
from kennfeld.models.imperative.path_facts import logical_and, logical_or, truth_of
from kennfeld.models.imperative.symbolic_values import (
    EMPTY,
    ConditionalValue,
    DeferredValue,
    EnumerationStruct,
    FunctionHandleValue,
    LogicalNodes,
    String,
    SymbolicCell,
    SymbolicStruct,
    SymbolicValue,
    as_array,
    as_logical,
    constants,
    describe,
    field_of,
    force,
    integers,
    word_of,
)

if TYPE_CHECKING:
    from kennfeld.models.imperative.statement_interpreter import StatementInterpreter

__all__ = ["ExpressionEvaluator", "assign_masked", "is_masked_assignment"]

_OPERATORS = frozenset({"+", "-", ".*", "./", ".^", "==", "~=", "!=", "<", "<=", ">", ">=", "&", "|", "*", "/", "^"})

_MEND = "Write it as a loop over all elements with if."

_TRUE_OR_FALSE = frozenset({"==", "~=", "!=", "<", "<=", ">", ">=", "&", "|", "&&", "||"})
_ELEMENTWISE = {"*": ".*", "/": "./", "^": ".^"}


def is_masked_assignment(calls: "ExpressionEvaluator", target: m.Expression, tree: m.Expression) -> bool:
    """Whether elements are assigned that a mask chooses by signals, from what may be so chosen too."""
    if not isinstance(target, m.Call) or len(target.arguments) != 1 or not isinstance(target.of, m.Name):
        return False
    if target.of.name not in calls.body.names or not _selects(tree):
        return False
    found = calls.value(target.arguments[0]) if _says_truth(calls, target.arguments[0]) else None
    return isinstance(found, LogicalNodes) and calls.context.numbers(found, "a mask") is None


def _says_truth(calls: "ExpressionEvaluator", tree: m.Expression) -> bool:
    """Whether an index is a mask by its form: a comparison, or a variable that is logical."""
    if isinstance(tree, m.Name):
        return isinstance(calls.body.names.get(tree.name), LogicalNodes)
    return isinstance(tree, m.Binary | m.Unary) and not _ranged(tree)


def _ranged(tree: m.Expression) -> bool:
    return isinstance(tree, m.End | m.Range | m.Colon) or any(map(_ranged, m.children(tree)))


def _selects(tree: m.Expression) -> bool:
    return isinstance(tree, m.Call) or any(map(_selects, m.children(tree)))


def assign_masked(calls: "ExpressionEvaluator", target: m.Call, tree: m.Expression) -> SymbolicValue:
    """The variable after the assignment."""
    assert isinstance(target.of, m.Name)
    old = as_array(calls.body.read(target.of.name))
    mask = as_array(calls.value(target.arguments[0]))
    if mask.shape != old.shape:
        raise ProgramError("a mask that depends on signals has another size than what it chooses from")
    if not _alone(calls, tree):
        raise ProgramError("elements that a mask chooses by signals are not used one by one", _MEND)
    calls.mask = mask
    try:
        new = as_array(calls.value(tree))
    finally:
        calls.mask = None
    if new.size != 1 and new.shape != old.shape:
        raise ProgramError("a mask that depends on signals chooses where several elements are assigned", _MEND)
    made = elementwise(calls.builder, "select", np.asarray(mask), np.broadcast_to(np.asarray(new), old.shape), old)
    return as_logical(made) if isinstance(old, LogicalNodes) and isinstance(new, LogicalNodes) else made


def _alone(calls: "ExpressionEvaluator", tree: m.Expression) -> bool:
    """Whether each element of an expression depends on the same element of its arrays alone."""
    match tree:
        case m.Number() | m.Name():
            return True
        case m.Unary(_, operand):
            return _alone(calls, operand)
        case m.Binary(operator, left, right):
            return operator in _OPERATORS and _alone(calls, left) and _alone(calls, right)
        case m.Call(m.Name(name), arguments) if name in calls.body.names:
            return not isinstance(calls.body.names[name], FunctionHandleValue)
        case m.Call(m.Name(name), arguments):
            alone = name in ELEMENTWISE_NAMES or (name in ("min", "max") and len(arguments) == 2)
            return alone and all(_alone(calls, one) for one in arguments)
    return False


def elementwise_operation(builder: object, op: str, left: Nodes, right: Nodes) -> Nodes:
    """An operation of the graph element by element; raises `CodeError` where the sizes do not fit."""
    try:
        return elementwise(builder, op, left, right)  # type: ignore[arg-type]
    except ValueError:
        sizes = " and ".join("x".join(map(str, one.shape)) for one in (left, right))
        raise ProgramError(f"arrays of {sizes} do not fit each other") from None


class ExpressionEvaluator:
    """The values of expressions over the variables of a body."""

    def __init__(self, body: "StatementInterpreter") -> None:
        self.body, self.context, self.builder = body, body.context, body.builder
        self.mask: Nodes | None = None  # elements that it chooses stand for all elements, where that is the same
        self.ends: list[tuple[Nodes, int, int]] = []  # the arrays that `end` may belong to, with place and count

    def value(self, tree: m.Expression) -> SymbolicValue:
        """The value of an expression."""
        match tree:
            case m.Number(number, suffix):
                if suffix in ("i", "j"):
                    raise ProgramError("complex numbers are not supported")
                return constants(self.builder, number)
            case m.Text(text):
                return String(text) if tree.is_string else text
            case m.Name(name):
                return self._name(name)
            case m.Field() | m.DynamicField():
                return self._field(tree)
            case m.Unary(operator, operand):
                return self._unary(operator, self.nodes(operand))
            case m.Binary(operator, left, right):
                return self._binary(operator, left, right)
            case m.Transpose(operand):
                return transposed(self.nodes(operand))
            case m.Matrix(rows):
                return self._matrix(rows)
            case m.Range():
                return range_between(self, tree)
            case m.Call():
                return self._call(tree)
            case m.CellArray(rows):
                return self._cells(rows)
            case m.CellIndex(of, arguments):
                return self._cell(self.value(of), arguments)
            case m.AnonymousFunction():
                return FunctionHandleValue(tree, dict(self.body.names))
            case m.FunctionHandle():
                return FunctionHandleValue(tree, {})
            case m.End():
                return self._end()
        raise ProgramError(f"{type(tree).__name__} is not supported here")

    def nodes(self, tree: m.Expression) -> Nodes:
        """The value of an expression as an array of nodes."""
        return as_array(force(self.value(tree)), _short(tree))

    def number(self, tree: m.Expression, message: str = "a size or place") -> float:
        """One number that depends on no signal."""
        found = self.context.numbers(self.nodes(tree), message)
        if found is None or found.size != 1:
            raise ProgramError(f"{message} is not one fixed number")
        return float(found.item())

    # names

    def _name(self, name: str) -> SymbolicValue:
        if name in self.body.names:
            return self.body.read(name)
        results = self.several(name, (), 1)
        if not results:
            raise ProgramError(f"{name} gives no value")
        return results[0]

    def _field(self, tree: m.Field | m.DynamicField) -> SymbolicValue:
        if isinstance(tree, m.Field):
            return field_of(self.value(tree.of), tree.name, _short(tree.of))
        name = self.value(tree.name)
        if not isinstance(name, str):
            raise ProgramError("the name of a field is no text")
        return field_of(self.value(tree.of), name, _short(tree.of))

    def _end(self) -> Nodes:
        if not self.ends:
            raise ProgramError("end stands outside of an index")
        array, at, count = self.ends[-1]
        if count == 1:
            return constants(self.builder, array.size)
        size = array.shape[at] if at < count - 1 else int(np.prod(array.shape[at:]))
        return constants(self.builder, size)

    # operators

    def _unary(self, operator: str, operand: Nodes) -> Nodes:
        if operator == "+":
            return operand
        made = elementwise(self.builder, "neg" if operator == "-" else "not", operand)
        return integers(made, word_of(operand)) if operator == "-" else as_logical(made)

    def _binary(self, operator: str, left: m.Expression, right: m.Expression) -> SymbolicValue:
        if operator in ("&&", "||"):
            return self._short_circuit(operator, left, right)
        return self.operation(operator, self._operand(left), self._operand(right))

    def _operand(self, tree: m.Expression) -> Nodes:
        held = force(self.value(tree))
        if isinstance(held, String):
            raise ProgramError("a string in double quotes stands in arithmetic", "Compare it by strcmp.")
        if isinstance(held, str):
            return constants(self.builder, [[float(ord(one)) for one in held]]) if held else EMPTY
        return as_array(held, _short(tree))

    def operation(self, operator: str, left: Nodes, right: Nodes) -> Nodes:
        """What an operator makes of two arrays."""
        single = left.size == 1 or right.size == 1
        if operator == "*" and not single:
            self.context.room(float(left.size) * right.shape[-1])
            return checked_matrix_product(self.builder, left, right)
        if (operator == "/" and right.size != 1) or (operator == "\\" and left.size != 1):
            return matrix_divide(self.builder, operator, left, right)
        if operator == "^" and max(left.size, right.size) > 1:
            return matrix_power(self, left, right)
        if operator in ("\\", ".\\"):
            return elementwise_operation(self.builder, "div", right, left)
        operator = _ELEMENTWISE.get(operator, operator)
        if operator not in BINARY:
            raise ProgramError(f"the operator {operator} is not supported")
        if left.size > 1 and right.size > 1 and left.shape != right.shape:
            self.context.room(float(left.size) * right.size)
        made = elementwise_operation(self.builder, BINARY[operator], left, right)
        return as_logical(made) if operator in _TRUE_OR_FALSE else integers(made, word_of(left, right))

    def _short_circuit(self, operator: str, left: m.Expression, right: m.Expression) -> Nodes:
        """The right side is only looked at where the left one does not decide."""
        body, found = self.body, list[int]()
        first = body.truth(self.value(left))

        def more() -> None:
            found.append(body.truth(self.value(right)))

        if operator == "&&":
            body.decide(first, more)
            made = logical_and(self.builder, first, found[0]) if found else self.builder.const(0.0)
        else:
            body.decide(first, lambda: None, more)
            made = logical_or(self.builder, first, found[0]) if found else self.builder.const(1.0)
        return as_logical(np.array([[truth_of(self.builder, made)]], dtype=np.int64))

    # arrays

    def _matrix(self, rows: tuple[tuple[m.Expression, ...], ...]) -> SymbolicValue:
        made = [[force(self.value(one)) for one in row] for row in rows]
        flat = [one for row in made for one in row]
        if len(flat) > 1 and any(isinstance(one, String) for one in flat):
            raise ProgramError("arrays of strings are not supported", "Write texts in single quotes.")
        if flat and all(isinstance(one, str) for one in flat) and len(made) == 1:
            return flat[0] if len(flat) == 1 else "".join(str(one) for one in flat)
        if len(flat) == 1 and isinstance(flat[0], (SymbolicStruct, SymbolicCell)):
            return flat[0]
        arrays = [[part for one in row if (part := as_array(one, "an element")).size] for row in made]
        try:
            lines = [np.concatenate([np.asarray(one) for one in row], axis=1) for row in arrays if row]
            whole = np.concatenate(lines, axis=0) if lines else EMPTY
        except ValueError:
            raise ProgramError("the rows of a matrix have different lengths") from None
        logical = bool(flat) and all(isinstance(one, LogicalNodes) for row in arrays for one in row)
        if logical and whole.size:
            return as_logical(whole)
        return integers(whole, word_of(*(one for row in arrays for one in row)))

    def _cells(self, rows: tuple[tuple[m.Expression, ...], ...]) -> SymbolicCell:
        made = [[self.value(one) for one in row] for row in rows if row]
        width = len(made[0]) if made else 0
        if any(len(row) != width for row in made):
            raise ProgramError("the rows of a cell array have different lengths")
        columns = (made[row][column] for column in range(width) for row in range(len(made)))
        return SymbolicCell(tuple(columns), (len(made), width))

    def _cell(self, held: SymbolicValue, arguments: Sequence[m.Expression]) -> SymbolicValue:
        if not isinstance(held, SymbolicCell):
            raise ProgramError(f"curly brackets index {describe(held)}, not a cell array")
        shape = np.arange(len(held.cells), dtype=np.int64).reshape(held.shape, order="F")
        places = self.arguments(shape, arguments)
        at = [self.context.numbers(as_array(one), "the place of a cell") for one in places]
        if any(one is None or one.size != 1 for one in at):
            raise ProgramError("the place of a cell is not one fixed number")
        return force(held.cells[fixed_element(shape, [int(one.item()) - 1 for one in at if one is not None])])

    def arguments(self, array: Nodes, trees: Sequence[m.Expression]) -> list[SymbolicValue]:
        """The arguments of an index into an array, in which `end` has a meaning; ":" stands for all."""
        made: list[SymbolicValue] = []
        for at, tree in enumerate(trees):
            if isinstance(tree, m.Colon):
                made.append(":")
                continue
            self.ends.append((array, at, len(trees)))
            made.append(self.value(tree))
            self.ends.pop()
        return made

    # calls

    def _call(self, tree: m.Call) -> SymbolicValue:
        if isinstance(tree.of, m.Name) and tree.of.name not in self.body.names:
            results = self.several(tree.of.name, tree.arguments, 1)
            if not results:
                raise ProgramError(f"{tree.of.name} gives no value")
            return results[0]
        dotted = _dotted(tree.of)
        if dotted.startswith("coder.") and "coder" not in self.body.names:
            return self._coder(dotted, tree.arguments)
        of = self.value(tree.of)
        if isinstance(of, FunctionHandleValue):
            return self.applied(of, [self.value(one) for one in tree.arguments], 1)[0]
        return index_value(self, of, tree.arguments, _short(tree.of))

    def _coder(self, name: str, arguments: Sequence[m.Expression]) -> SymbolicValue:
        """What coder functions that give a value stand for: the code is run by the model, not generated."""
        if name in ("coder.const", "coder.nullcopy", "coder.ignoreConst") and len(arguments) == 1:
            return self.value(arguments[0])
        if name == "coder.target" and len(arguments) == 1:
            return as_logical(constants(self.builder, float(self.value(arguments[0]) in ("Sfun", "MATLAB", ""))))
        raise ProgramError(f"{name} is not supported")

    def several(self, name: str, arguments: Sequence[m.Expression], wanted: int) -> tuple[SymbolicValue, ...]:
        """The results of a function by its name, as many as are wanted, or fewer."""
        held = self.body.names.get(name)
        if isinstance(held, FunctionHandleValue):
            return self.applied(held, self.given(arguments), wanted)
        own = self._own(name, arguments)
        if own is not None:
            return own
        if self._function(name) is not None or name in SYMBOLIC_FUNCTIONS:
            given = self._unmade(arguments) if self._takes_tables(name) else self.given(arguments)
            return self.named(name, given, wanted)
        parameter = self.context.workspace(name)
        if isinstance(parameter, EnumerationStruct) and len(arguments) == 1:
            return (self.value(arguments[0]),)
        if parameter is not None:
            return (index_value(self, force(parameter), arguments, name) if arguments else parameter,)
        found = self.context.unknown(self.body, name, tuple(arguments), wanted)
        return found if found is not None else self.named(name, self.given(arguments), wanted)

    def _takes_tables(self, name: str) -> bool:
        return name in TAKES_TABLES or self._function(name) is not None

    def _unmade(self, arguments: Sequence[m.Expression]) -> list[SymbolicValue]:
        """The arguments of a function, parameters that are arrays as they are: they may become tables there."""
        if any(isinstance(tree, m.CellIndex | m.Colon) for tree in arguments):
            return self.given(arguments)
        return [self.parameter(tree) or self.value(tree) for tree in arguments]

    def parameter(self, tree: m.Expression) -> DeferredValue | None:
        """A parameter that is an array and that nothing has been taken of yet; None for anything else."""
        held: SymbolicValue | None = None
        if isinstance(tree, m.Name):
            held = self.body.names.get(tree.name)
        elif isinstance(tree, m.Field) and _dotted(tree.of) and _dotted(tree).split(".")[0] in self.body.names:
            of = self.value(tree.of)
            held = of.fields.get(tree.name) if isinstance(of, SymbolicStruct) else None
        return held if isinstance(held, DeferredValue) and held.name else None

    def _function(self, name: str) -> m.FunctionDefinition | None:
        return self.context.function(name, self.body.frame.functions)

    def named(self, name: str, arguments: Sequence[SymbolicValue], wanted: int) -> tuple[SymbolicValue, ...]:
        """The results of a function of the code, beside it, or of the library; of others where all is fixed."""
        function = self._function(name)
        if function is not None:
            return self.body.call(function, arguments, wanted)
        if name in SYMBOLIC_FUNCTIONS:
            return SYMBOLIC_FUNCTIONS[name].results(self, arguments, wanted)
        found = evaluate_constant_call(self.context, name, arguments) if wanted == 1 else None
        if found is None:
            raise ProgramError(_unknown(name))
        return (found,)

    def given(self, trees: Sequence[m.Expression]) -> list[SymbolicValue]:
        """The arguments of a function; `c{:}` stands for all cells."""
        made: list[SymbolicValue] = []
        for tree in trees:
            if isinstance(tree, m.CellIndex) and tree.arguments == (m.Colon(),):
                held = self.value(tree.of)
                made += held.cells if isinstance(held, SymbolicCell) else ()
            elif isinstance(tree, m.Colon):
                made.append(":")
            else:
                made.append(self.value(tree))
        return made

    def _own(self, name: str, arguments: Sequence[m.Expression]) -> tuple[SymbolicValue, ...] | None:
        """What depends on how a function was called or on whether a variable has a value."""
        if name in ("nargin", "nargout") and not arguments:
            frame = self.body.frame
            return (constants(self.builder, frame.given if name == "nargin" else frame.wanted),)
        if name == "isempty" and len(arguments) == 1 and isinstance(arguments[0], m.Name):
            return self._is_empty(arguments[0].name)
        if name == "exist" and arguments and isinstance(arguments[0], m.Text):
            return (self._exists(arguments[0].value),)
        return None

    def _exists(self, name: str) -> SymbolicValue:
        """Whether there is a variable of a name, which may depend on a decision."""
        held = self.body.names.get(name)
        if isinstance(held, ConditionalValue) and name not in self.body.frame.persistent:
            return np.array([[held.defined]], dtype=np.int64)
        return constants(self.builder, float(held is not None))

    def _is_empty(self, name: str) -> tuple[SymbolicValue, ...] | None:
        held = self.body.names.get(name)
        if name not in self.body.frame.persistent:
            return None
        if not isinstance(held, ConditionalValue):
            return None
        if self.builder.value(held.defined) == 0.0:
            self.body.questions += 1
        return (as_logical(np.array([[self.builder.call("not", held.defined)]], dtype=np.int64)),)

    def applied(
        self, handle: FunctionHandleValue, arguments: Sequence[SymbolicValue], wanted: int
    ) -> tuple[SymbolicValue, ...]:
        """The results of a function that a variable holds."""
        function = handle.function
        if isinstance(function, m.FunctionHandle):
            return self.named(function.name, arguments, wanted)
        names = {**handle.names, **dict(zip(function.parameters, arguments, strict=False))}
        return (self.body.within(names, lambda: self.value(function.body)),)


def _dotted(tree: m.Expression) -> str:
    return ".".join(field_path(tree) or ())


def _short(tree: m.Expression) -> str:
    return _dotted(tree) or "it"


def _unknown(name: str) -> str:
    if name in ("i", "j"):
        return f"{name} is no variable here, and complex numbers are not supported"
    return f"the function or variable {name} is not known"
