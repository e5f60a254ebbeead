"""Evaluation of expressions in code: operators, arrays, structs, calls, and masked assignments.

A name is resolved as a variable, else a function of the code or of a file, else a library function, else a parameter of
the model, else by the host of the code.

In `x(x > 1) = 2*x(x > 1)` the mask depends on signals. If each element of the right side depends only on the same
element of its arrays, all elements are computed, and each takes its new value or keeps its old one.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.matlab import syntax as m
from kennfeld.matlab.traversal import children, field_path
from kennfeld.models.imperative.element_access import MASK_REMEDY, fixed_element, index_value
from kennfeld.models.imperative.evaluation_context import evaluate_constant_call
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.graph_operators import BINARY, range_between
from kennfeld.models.imperative.library.elementwise_functions import ELEMENTWISE_NAMES
from kennfeld.models.imperative.library.function_registry import SYMBOLIC_FUNCTIONS, TAKES_TABLES
from kennfeld.models.imperative.library.reduction_functions import (
    checked_matrix_product,
    matrix_divide,
    matrix_power,
    transpose,
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


_OPERATORS = frozenset({"+", "-", ".*", "./", ".^", "==", "~=", "!=", "<", "<=", ">", ">=", "&", "|", "*", "/", "^"})

_TRUE_OR_FALSE = frozenset({"==", "~=", "!=", "<", "<=", ">", ">=", "&", "|", "&&", "||"})
_ELEMENTWISE = {"*": ".*", "/": "./", "^": ".^"}


class ExpressionEvaluator:
    """Evaluator of expressions over the variables of a statement interpreter."""

    def __init__(self, body: "StatementInterpreter") -> None:
        self.body, self.context, self.builder = body, body.context, body.builder
        self.mask: Nodes | None = None  # the elements it selects may be computed as all elements
        self.ends: list[tuple[Nodes, int, int]] = []  # the arrays that `end` may belong to, with place and count

    def value(self, tree: m.Expression) -> SymbolicValue:
        """Evaluate an expression."""
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
                return transpose(self.nodes(operand))
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
        """Evaluate an expression to an array of nodes."""
        return as_array(force(self.value(tree)), _short(tree))

    def number(self, tree: m.Expression, message: str = "a size or index") -> float:
        """Evaluate an expression to a number that depends on no signal."""
        numbers = self.context.numbers(self.nodes(tree), message)
        if numbers is None or numbers.size != 1:
            raise ProgramError(f"{message} is not a constant scalar")
        return float(numbers.item())

    # names

    def _name(self, name: str) -> SymbolicValue:
        if name in self.body.names:
            return self.body.read(name)
        results = self.several(name, (), 1)
        if not results:
            raise ProgramError(f"{name} returns no value")
        return results[0]

    def _field(self, tree: m.Field | m.DynamicField) -> SymbolicValue:
        if isinstance(tree, m.Field):
            return field_of(self.value(tree.of), tree.name, _short(tree.of))
        name = self.value(tree.name)
        if not isinstance(name, str):
            raise ProgramError("the name of a field is not a text")
        return field_of(self.value(tree.of), name, _short(tree.of))

    def _end(self) -> Nodes:
        if not self.ends:
            raise ProgramError("end outside of an index")
        array, at, count = self.ends[-1]
        if count == 1:
            return constants(self.builder, array.size)
        size = array.shape[at] if at < count - 1 else int(np.prod(array.shape[at:]))
        return constants(self.builder, size)

    # operators

    def _unary(self, operator: str, operand: Nodes) -> Nodes:
        if operator == "+":
            return operand
        result = elementwise(self.builder, "neg" if operator == "-" else "not", operand)
        return integers(result, word_of(operand)) if operator == "-" else as_logical(result)

    def _binary(self, operator: str, left: m.Expression, right: m.Expression) -> SymbolicValue:
        if operator in ("&&", "||"):
            return self._short_circuit(operator, left, right)
        return self.operation(operator, self._operand(left), self._operand(right))

    def _operand(self, tree: m.Expression) -> Nodes:
        held = force(self.value(tree))
        if isinstance(held, String):
            raise ProgramError("a double-quoted string is used in arithmetic", "Compare it with strcmp.")
        if isinstance(held, str):
            return constants(self.builder, [[float(ord(value)) for value in held]]) if held else EMPTY
        return as_array(held, _short(tree))

    def operation(self, operator: str, left: Nodes, right: Nodes) -> Nodes:
        """Apply an operator to two arrays."""
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
        result = elementwise_operation(self.builder, BINARY[operator], left, right)
        return as_logical(result) if operator in _TRUE_OR_FALSE else integers(result, word_of(left, right))

    def _short_circuit(self, operator: str, left: m.Expression, right: m.Expression) -> Nodes:
        """Evaluate `&&` or `||`; the right side only if the left one does not decide."""
        body, second = self.body, list[int]()
        first = body.truth(self.value(left))

        def more() -> None:
            second.append(body.truth(self.value(right)))

        if operator == "&&":
            body.decide(first, more)
            result = logical_and(self.builder, first, second[0]) if second else self.builder.const(0.0)
        else:
            body.decide(first, lambda: None, more)
            result = logical_or(self.builder, first, second[0]) if second else self.builder.const(1.0)
        return as_logical(np.array([[truth_of(self.builder, result)]], dtype=np.int64))

    # arrays

    def _matrix(self, rows: tuple[tuple[m.Expression, ...], ...]) -> SymbolicValue:
        result = [[force(self.value(element)) for element in row] for row in rows]
        flat = [element for row in result for element in row]
        if len(flat) > 1 and any(isinstance(element, String) for element in flat):
            raise ProgramError("arrays of strings are not supported", "Use single quotes.")
        if flat and all(isinstance(element, str) for element in flat) and len(result) == 1:
            return flat[0] if len(flat) == 1 else "".join(str(element) for element in flat)
        if len(flat) == 1 and isinstance(flat[0], (SymbolicStruct, SymbolicCell)):
            return flat[0]
        arrays = [[part for element in row if (part := as_array(element, "an element")).size] for row in result]
        try:
            lines = [np.concatenate([np.asarray(element) for element in row], axis=1) for row in arrays if row]
            whole = np.concatenate(lines, axis=0) if lines else EMPTY
        except ValueError:
            raise ProgramError("the rows of a matrix have different lengths") from None
        logical = bool(flat) and all(isinstance(element, LogicalNodes) for row in arrays for element in row)
        if logical and whole.size:
            return as_logical(whole)
        return integers(whole, word_of(*(element for row in arrays for element in row)))

    def _cells(self, rows: tuple[tuple[m.Expression, ...], ...]) -> SymbolicCell:
        result = [[self.value(element) for element in row] for row in rows if row]
        width = len(result[0]) if result else 0
        if any(len(row) != width for row in result):
            raise ProgramError("the rows of a cell array have different lengths")
        columns = (result[row][column] for column in range(width) for row in range(len(result)))
        return SymbolicCell(tuple(columns), (len(result), width))

    def _cell(self, held: SymbolicValue, arguments: Sequence[m.Expression]) -> SymbolicValue:
        if not isinstance(held, SymbolicCell):
            raise ProgramError(f"braces index {describe(held)}, not a cell array")
        shape = np.arange(len(held.cells), dtype=np.int64).reshape(held.shape, order="F")
        places = self.arguments(shape, arguments)
        at = [self.context.numbers(as_array(item), "the index of a cell") for item in places]
        if any(item is None or item.size != 1 for item in at):
            raise ProgramError("the index of a cell is not a constant scalar")
        return force(held.cells[fixed_element(shape, [int(item.item()) - 1 for item in at if item is not None])])

    def arguments(self, array: Nodes, trees: Sequence[m.Expression]) -> list[SymbolicValue]:
        """Evaluate the indices into an array, within which `end` is defined; ":" stands for all."""
        result: list[SymbolicValue] = []
        for at, tree in enumerate(trees):
            if isinstance(tree, m.Colon):
                result.append(":")
                continue
            self.ends.append((array, at, len(trees)))
            result.append(self.value(tree))
            self.ends.pop()
        return result

    # calls

    def _call(self, tree: m.Call) -> SymbolicValue:
        if isinstance(tree.of, m.Name) and tree.of.name not in self.body.names:
            results = self.several(tree.of.name, tree.arguments, 1)
            if not results:
                raise ProgramError(f"{tree.of.name} returns no value")
            return results[0]
        dotted = _dotted(tree.of)
        if dotted.startswith("coder.") and "coder" not in self.body.names:
            return self._coder(dotted, tree.arguments)
        of = self.value(tree.of)
        if isinstance(of, FunctionHandleValue):
            return self.applied(of, [self.value(argument) for argument in tree.arguments], 1)[0]
        return index_value(self, of, tree.arguments, _short(tree.of))

    def _coder(self, name: str, arguments: Sequence[m.Expression]) -> SymbolicValue:
        """Evaluate coder functions as in simulation, not in generated code."""
        if name in ("coder.const", "coder.nullcopy", "coder.ignoreConst") and len(arguments) == 1:
            return self.value(arguments[0])
        if name == "coder.target" and len(arguments) == 1:
            return as_logical(constants(self.builder, float(self.value(arguments[0]) in ("Sfun", "MATLAB", ""))))
        raise ProgramError(f"{name} is not supported")

    def several(self, name: str, arguments: Sequence[m.Expression], wanted: int) -> tuple[SymbolicValue, ...]:
        """Call a function by name; it may return fewer results than wanted."""
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
        result = self.context.unknown(self.body, name, tuple(arguments), wanted)
        return result if result is not None else self.named(name, self.given(arguments), wanted)

    def _takes_tables(self, name: str) -> bool:
        return name in TAKES_TABLES or self._function(name) is not None

    def _unmade(self, arguments: Sequence[m.Expression]) -> list[SymbolicValue]:
        """Return the arguments of a function, with array parameters deferred: they may become tables."""
        if any(isinstance(tree, m.CellIndex | m.Colon) for tree in arguments):
            return self.given(arguments)
        return [self.parameter(tree) or self.value(tree) for tree in arguments]

    def parameter(self, tree: m.Expression) -> DeferredValue | None:
        """Return an array parameter that is not used yet; None for anything else."""
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
        """Call a function of the code, of a file or of the library; if all is constant, any other numerically."""
        function = self._function(name)
        if function is not None:
            return self.body.call(function, arguments, wanted)
        if name in SYMBOLIC_FUNCTIONS:
            return SYMBOLIC_FUNCTIONS[name].results(self, arguments, wanted)
        result = evaluate_constant_call(self.context, name, arguments) if wanted == 1 else None
        if result is None:
            raise ProgramError(_unknown(name))
        return (result,)

    def given(self, trees: Sequence[m.Expression]) -> list[SymbolicValue]:
        """Evaluate the arguments of a function; `c{:}` stands for all cells."""
        result: list[SymbolicValue] = []
        for tree in trees:
            if isinstance(tree, m.CellIndex) and tree.arguments == (m.Colon(),):
                held = self.value(tree.of)
                result += held.cells if isinstance(held, SymbolicCell) else ()
            elif isinstance(tree, m.Colon):
                result.append(":")
            else:
                result.append(self.value(tree))
        return result

    def _own(self, name: str, arguments: Sequence[m.Expression]) -> tuple[SymbolicValue, ...] | None:
        """Evaluate functions that depend on the call, such as nargin, or on whether a variable is defined."""
        if name in ("nargin", "nargout") and not arguments:
            frame = self.body.frame
            return (constants(self.builder, frame.given if name == "nargin" else frame.wanted),)
        if name == "isempty" and len(arguments) == 1 and isinstance(arguments[0], m.Name):
            return self._is_empty(arguments[0].name)
        if name == "exist" and arguments and isinstance(arguments[0], m.Text):
            return (self._exists(arguments[0].value),)
        return None

    def _exists(self, name: str) -> SymbolicValue:
        """Return the condition that a variable exists, which may depend on a decision."""
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
        """Call the function that a variable holds."""
        function = handle.function
        if isinstance(function, m.FunctionHandle):
            return self.named(function.name, arguments, wanted)
        names = {**handle.names, **dict(zip(function.parameters, arguments, strict=False))}
        return (self.body.within(names, lambda: self.value(function.body)),)


def is_masked_assignment(calls: "ExpressionEvaluator", target: m.Expression, tree: m.Expression) -> bool:
    """Return True if the target is indexed by a signal-dependent mask and the value may be so too."""
    if not isinstance(target, m.Call) or len(target.arguments) != 1 or not isinstance(target.of, m.Name):
        return False
    if target.of.name not in calls.body.names or not _selects(tree):
        return False
    result = calls.value(target.arguments[0]) if _is_mask_expression(calls, target.arguments[0]) else None
    return isinstance(result, LogicalNodes) and calls.context.numbers(result, "a mask") is None


def _is_mask_expression(calls: "ExpressionEvaluator", tree: m.Expression) -> bool:
    """Return True if an index is syntactically a mask: a comparison, or a logical variable."""
    if isinstance(tree, m.Name):
        return isinstance(calls.body.names.get(tree.name), LogicalNodes)
    return isinstance(tree, m.Binary | m.Unary) and not _ranged(tree)


def _ranged(tree: m.Expression) -> bool:
    return isinstance(tree, m.End | m.Range | m.Colon) or any(map(_ranged, children(tree)))


def _selects(tree: m.Expression) -> bool:
    return isinstance(tree, m.Call) or any(map(_selects, children(tree)))


def assign_masked(calls: "ExpressionEvaluator", target: m.Call, tree: m.Expression) -> SymbolicValue:
    """Return the variable after the assignment."""
    assert isinstance(target.of, m.Name)
    old = as_array(calls.body.read(target.of.name))
    mask = as_array(calls.value(target.arguments[0]))
    if mask.shape != old.shape:
        raise ProgramError("a mask that depends on signals differs in size from the indexed array")
    if not _is_elementwise(calls, tree):
        raise ProgramError("elements selected by a signal-dependent mask are not used element by element", MASK_REMEDY)
    calls.mask = mask
    try:
        new = as_array(calls.value(tree))
    finally:
        calls.mask = None
    if new.size != 1 and new.shape != old.shape:
        raise ProgramError("several elements are assigned through a mask that depends on signals", MASK_REMEDY)
    result = elementwise(calls.builder, "select", np.asarray(mask), np.broadcast_to(np.asarray(new), old.shape), old)
    return as_logical(result) if isinstance(old, LogicalNodes) and isinstance(new, LogicalNodes) else result


def _is_elementwise(calls: "ExpressionEvaluator", tree: m.Expression) -> bool:
    """Return True if each element of an expression depends only on the same element of its arrays."""
    match tree:
        case m.Number() | m.Name():
            return True
        case m.Unary(_, operand):
            return _is_elementwise(calls, operand)
        case m.Binary(operator, left, right):
            return operator in _OPERATORS and _is_elementwise(calls, left) and _is_elementwise(calls, right)
        case m.Call(m.Name(name), arguments) if name in calls.body.names:
            return not isinstance(calls.body.names[name], FunctionHandleValue)
        case m.Call(m.Name(name), arguments):
            alone = name in ELEMENTWISE_NAMES or (name in ("min", "max") and len(arguments) == 2)
            return alone and all(_is_elementwise(calls, argument) for argument in arguments)
    return False


def elementwise_operation(builder: object, op: str, left: Nodes, right: Nodes) -> Nodes:
    """Apply an operation element by element; raises `ProgramError` if the sizes do not match."""
    try:
        return elementwise(builder, op, left, right)  # type: ignore[arg-type]
    except ValueError:
        sizes = " and ".join("x".join(map(str, item.shape)) for item in (left, right))
        raise ProgramError(f"arrays of sizes {sizes} are not compatible") from None


def _dotted(tree: m.Expression) -> str:
    return ".".join(field_path(tree) or ())


def _short(tree: m.Expression) -> str:
    return _dotted(tree) or "it"


def _unknown(name: str) -> str:
    if name in ("i", "j"):
        return f"{name} is not a variable here, and complex numbers are not supported"
    return f"unknown function or variable {name}"
