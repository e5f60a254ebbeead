"""Evaluation of expressions in code: operators, arrays, structs, calls, and masked assignments.

A name is resolved as a variable, else a function of the code or of a file, else a library function, else a parameter of
the model, else by the host of the code. The context may let parameters precede functions.

In `x(x > 1) = 2*x(x > 1)` the mask depends on signals. If each element of the right side depends only on the same
element of its arrays, all elements are computed, and each takes its new value or keeps its old one.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.matlab.simulink_objects import ENUMERATION
from kennfeld.matlab.values import MatlabCell, MatlabFunctionHandle, MatlabStruct
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.element_access import MASK_REMEDY, cell_indices, field_name, fixed_element, index_value
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.graph_operators import BINARY
from kennfeld.models.imperative.library.elementwise_functions import ELEMENTWISE_NAMES
from kennfeld.models.imperative.library.function_registry import SYMBOLIC_FUNCTIONS, TAKES_TABLES
from kennfeld.models.imperative.library.numeric_rules import evaluate_constant_call
from kennfeld.models.imperative.library.reduction_functions import (
    checked_matrix_product,
    matrix_power,
    transpose,
)
from kennfeld.models.imperative.linear_systems import matrix_divide
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, format_sizes
from kennfeld.models.imperative.path_facts import logical_and, logical_or, truth_of
from kennfeld.models.imperative.path_state import SymbolicInterpreter
from kennfeld.models.imperative.ranges import constant_distance, range_length
from kennfeld.program import tree as m
from kennfeld.program.traversal import children, dotted_name

_OPERATORS = frozenset({"+", "-", ".*", "./", ".^", "==", "~=", "!=", "<", "<=", ">", ">=", "&", "|", "*", "/", "^"})

_TRUE_OR_FALSE = frozenset({"==", "~=", "!=", "<", "<=", ">", ">=", "&", "|", "&&", "||"})
_ELEMENTWISE = {"*": ".*", "/": "./", "^": ".^"}
# comparisons of an index that `find` returns with itself, which NaN for none differs from
_OF_FOUND_INDEX = {"isempty": "ne", "numel": "eq", "length": "eq", "any": "eq"}


class ExpressionEvaluator:
    """SymbolicEvaluator of expressions over the variables of a statement interpreter."""

    def __init__(self, body: SymbolicInterpreter) -> None:
        self.body, self.context, self.builder = body, body.context, body.builder
        self.apply = Elementwise(self.builder)
        library = self.context.library
        self.library = SYMBOLIC_FUNCTIONS if library is None else library
        self.mask: Nodes | None = None  # the elements it selects may be computed as all elements
        self.ends: list[tuple[Nodes, int, int]] = []  # the arrays that `end` may belong to, with place and count

    def value(self, tree: m.Expression) -> s.SymbolicValue:
        """Evaluate an expression."""
        match tree:
            case m.Number(number, suffix):
                if suffix in ("i", "j"):
                    raise ProgramError("complex numbers are not supported")
                return s.constants(self.builder, number)
            case m.Text(text):
                return s.String(text) if tree.is_string else text
            case m.Name(name):
                return self.body.read(name) if name in self.body.names else self._first_result(name, ())
            case m.Field() | m.DynamicField():
                return self._field(tree)
            case m.Unary(operator, operand):
                return self._unary(operator, self.nodes(operand))
            case m.Binary(("&&" | "||") as operator, left, right):
                return self._short_circuit(operator, left, right)
            case m.Binary(operator, left, right):
                return self.operation(operator, self._operand(left), self._operand(right))
            case m.Conditional():
                return self._conditional(tree)
            case m.Transpose(operand):
                return transpose(self.nodes(operand))
            case m.Matrix(rows):
                return self._matrix(rows)
            case m.Range():
                return self._range(tree)
            case m.Call():
                return self._call(tree)
            case m.CellArray(rows):
                return self._cells(rows)
            case m.CellIndex(of, arguments):
                return self._cell(self.value(of), arguments)
            case m.AnonymousFunction():
                return MatlabFunctionHandle("", tree.parameters, tree.body, dict(self.body.names))
            case m.FunctionHandle():
                return MatlabFunctionHandle(tree.name)
            case m.End():
                return self._end()
        raise ProgramError(f"{type(tree).__name__} is not supported here")

    def nodes(self, tree: m.Expression) -> Nodes:
        """Evaluate an expression to an array of nodes."""
        return s.as_array(s.force(self.value(tree)), _short(tree))

    def number(self, tree: m.Expression, message: str = "a size or index") -> float:
        """Evaluate an expression to a number that depends on no signal."""
        numbers = self.context.numbers(self.nodes(tree), message)
        if numbers is None or numbers.size != 1:
            raise ProgramError(f"{message} is not a constant scalar")
        return float(numbers.item())

    def fail_where(self, condition: Nodes) -> None:
        """See `SymbolicEvaluator`."""
        for node in condition.ravel():
            self.body.fail_where(int(node))

    # names

    def _first_result(self, name: str, arguments: Sequence[m.Expression]) -> s.SymbolicValue:
        results = self.call(name, arguments, 1)
        if not results:
            raise ProgramError(f"{name} returns no value")
        return results[0]

    def _field(self, tree: m.Field | m.DynamicField) -> s.SymbolicValue:
        if isinstance(tree, m.Field):
            path = dotted_name(tree) if self.context.parameters_first else ""
            if path and path.partition(".")[0] not in self.body.names:
                parameter = self.context.workspace(path)
                if parameter is not None:
                    return parameter
        value = s.field_of(self.value(tree.of), field_name(self, tree), _short(tree.of))
        return self.body.of_one_size(value) if isinstance(value, s.VaryingArray) else value

    def _end(self) -> Nodes:
        if not self.ends:
            raise ProgramError("end outside of an index")
        if self.context.single_elements:
            raise ProgramError("it uses `end`, which is evaluated numerically")
        array, at, count = self.ends[-1]
        if count == 1:
            return s.constants(self.builder, array.size)
        size = array.shape[at] if at < count - 1 else int(np.prod(array.shape[at:]))
        return s.constants(self.builder, size)

    # operators

    def _unary(self, operator: str, operand: Nodes) -> Nodes:
        if operator == "+":
            return operand
        if operator == "-":
            return s.integers(self.apply("neg", operand), s.word_of(operand))
        return s.as_logical(self.apply("not", operand))

    def _operand(self, tree: m.Expression) -> Nodes:
        current = s.force(self.value(tree))
        if isinstance(current, s.String):
            raise ProgramError("a double-quoted string is used in arithmetic", "Compare it with strcmp.")
        if isinstance(current, str):
            return s.constants(self.builder, [[float(ord(value)) for value in current]]) if current else s.EMPTY
        return s.as_array(current, _short(tree))

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
            return self._broadcast("div", right, left)
        operator = _ELEMENTWISE.get(operator, operator)
        if operator not in BINARY:
            raise ProgramError(f"the operator {operator} is not supported")
        if left.size > 1 and right.size > 1 and left.shape != right.shape:
            self.context.room(float(left.size) * right.size)
        result = self._broadcast(BINARY[operator], left, right)
        return s.as_logical(result) if operator in _TRUE_OR_FALSE else s.integers(result, s.word_of(left, right))

    def _broadcast(self, op: str, left: Nodes, right: Nodes) -> Nodes:
        try:
            return self.apply(op, left, right)
        except ValueError:
            raise EvaluationError(f"arrays of sizes {format_sizes(left, right)} are not compatible") from None

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
        return s.as_logical(np.array([[truth_of(self.builder, result)]], dtype=np.int64))

    def _conditional(self, tree: m.Conditional) -> s.SymbolicValue:
        """Evaluate `condition ? yes : no`; one side alone if it is known to be taken."""
        body, sides = self.body, dict[bool, Nodes]()
        condition = body.truth(self.value(tree.condition))

        def evaluate(side: bool) -> None:
            sides[side] = self.nodes(tree.yes if side else tree.no)

        body.decide(condition, lambda: evaluate(True), lambda: evaluate(False))
        if len(sides) < 2:
            return next(iter(sides.values()))
        yes, no = sides[True], sides[False]
        return self._broadcast_select(condition, yes, no)

    def _broadcast_select(self, condition: int, yes: Nodes, no: Nodes) -> Nodes:
        if np.array_equal(yes, no):
            return yes
        result = self.apply("select", np.array([[condition]], dtype=np.int64), yes, no)
        return s.of_class(yes, result) if type(yes) is type(no) else result

    # arrays

    def _range(self, tree: m.Range) -> Nodes:
        """Evaluate `first:step:last`, with tolerance for rounding at the end.

        The start may depend on signals if the distance to the end does not, as in `k:k+2`.
        """
        first, last = self.nodes(tree.first), self.nodes(tree.last)
        step = 1.0 if tree.step is None else self.number(tree.step, "the step of a range")
        if first.size != 1 or last.size != 1:
            raise ProgramError("the ends of a range must be scalars")
        self.context.numbers(np.concatenate([first, last]), "the ends of a range")
        span = constant_distance(self.context, int(first.item()), int(last.item()))
        if span is None:
            raise ProgramError("the length of a range depends on signals", "Loop over constants, with if inside.")
        begin = self.context.constant(int(first.item()))
        steps = step * np.arange(range_length(self.context, span, step)).reshape(1, -1)
        if begin is not None:
            return s.constants(self.builder, begin + steps)
        return self.apply("add", first, s.constants(self.builder, steps))

    def _matrix(self, rows: tuple[m.Expressions, ...]) -> s.SymbolicValue:
        elements = [[part for element in row for part in self._listed(element)] for row in rows]
        flat = [element for row in elements for element in row]
        if len(flat) > 1 and any(isinstance(element, s.String) for element in flat):
            raise ProgramError("arrays of strings are not supported", "Use single quotes.")
        if flat and all(isinstance(element, str) for element in flat) and len(elements) == 1:
            return flat[0] if len(flat) == 1 else "".join(str(element) for element in flat)
        if len(flat) == 1 and isinstance(flat[0], MatlabStruct | MatlabCell):
            return flat[0]
        arrays = [[part for element in row if (part := s.as_array(element, "an element")).size] for row in elements]
        try:
            lines = [np.concatenate([np.asarray(element) for element in row], axis=1) for row in arrays if row]
            whole = np.concatenate(lines, axis=0) if lines else s.EMPTY
        except ValueError:
            raise EvaluationError("the rows of a matrix have different lengths") from None
        logical = bool(flat) and all(isinstance(element, s.LogicalNodes) for row in arrays for element in row)
        if logical and whole.size:
            return s.as_logical(whole)
        return s.integers(whole, s.word_of(*(element for row in arrays for element in row)))

    def _listed(self, tree: m.Expression) -> list[s.SymbolicValue]:
        """Return the values of an expression within brackets: several for a field of an array of structs."""
        try:
            return [s.force(self.value(tree))]
        except s.StructArrayError:
            holder = s.force(self.value(tree.of)) if isinstance(tree, m.Field) else None
            if not (isinstance(tree, m.Field) and isinstance(holder, MatlabStruct) and tree.name in holder.names):
                raise
            return [s.force(element[tree.name]) for element in holder.elements.ravel(order="F")]

    def _cells(self, rows: tuple[m.Expressions, ...]) -> MatlabCell:
        result = [[self.value(element) for element in row] for row in rows if row]
        width = len(result[0]) if result else 0
        if any(len(row) != width for row in result):
            raise ProgramError("the rows of a cell array have different lengths")
        columns = (result[row][column] for column in range(width) for row in range(len(result)))
        return MatlabCell.of(columns, (len(result), width))

    def _cell(self, value: s.SymbolicValue, arguments: Sequence[m.Expression]) -> s.SymbolicValue:
        if not isinstance(value, MatlabCell):
            raise ProgramError(f"braces index {s.describe(value)}, not a cell array")
        return s.force(fixed_element(value.values, cell_indices(self, value.values, arguments)))

    def index_values(self, array: Nodes, trees: Sequence[m.Expression]) -> list[s.SymbolicValue]:
        """Evaluate the indices into an array, within which `end` is defined; ":" stands for all."""
        result: list[s.SymbolicValue] = []
        for at, tree in enumerate(trees):
            if isinstance(tree, m.Colon):
                if self.context.single_elements:
                    raise ProgramError("it selects several elements of an array")
                result.append(":")
                continue
            self.ends.append((array, at, len(trees)))
            result.append(self.value(tree))
            self.ends.pop()
        return result

    # calls

    def _call(self, tree: m.Call) -> s.SymbolicValue:
        if isinstance(tree.of, m.Name) and tree.of.name not in self.body.names:
            return self._first_result(tree.of.name, tree.arguments)
        dotted = dotted_name(tree.of)
        if dotted.startswith("coder.") and "coder" not in self.body.names:
            return self._coder(dotted, tree.arguments)
        of = self.value(tree.of)
        if isinstance(of, MatlabFunctionHandle):
            return self.call_handle(of, [self.value(argument) for argument in tree.arguments], 1)[0]
        return index_value(self, of, tree.arguments, _short(tree.of))

    def _coder(self, name: str, arguments: Sequence[m.Expression]) -> s.SymbolicValue:
        """Evaluate coder functions as in simulation, not in generated code."""
        if name in ("coder.const", "coder.nullcopy", "coder.ignoreConst") and len(arguments) == 1:
            return self.value(arguments[0])
        if name == "coder.target" and len(arguments) == 1:
            return s.as_logical(s.constants(self.builder, float(self.value(arguments[0]) in ("Sfun", "MATLAB", ""))))
        raise ProgramError(f"{name} is not supported")

    def call(self, name: str, arguments: Sequence[m.Expression], wanted: int) -> tuple[s.SymbolicValue, ...]:
        """Call a function by name; it may return fewer results than wanted."""
        variable = self.body.names.get(name)
        if isinstance(variable, MatlabFunctionHandle):
            return self.call_handle(variable, self.argument_values(arguments), wanted)
        result = self._query(name, arguments)
        if result is None and self.context.parameters_first:
            result = self._parameter(name, arguments)
        if result is not None:
            return (result,)
        is_defined = self._function(name) is not None
        if is_defined or name in self.library:
            takes_tables = is_defined or name in TAKES_TABLES
            values = self._unmade(arguments) if takes_tables else self.argument_values(arguments)
            return self.call_named(name, values, wanted)
        result = None if self.context.parameters_first else self._parameter(name, arguments)
        if result is None:
            result = self.context.unknown(self.value, name, tuple(arguments))
        return (result,) if result is not None else self.call_named(name, self.argument_values(arguments), wanted)

    def _parameter(self, name: str, arguments: Sequence[m.Expression]) -> s.SymbolicValue | None:
        """Return a parameter of the model or a part of it; an enumeration converts its argument."""
        parameter = self.context.workspace(name)
        if parameter is None or not arguments:
            return parameter
        if isinstance(parameter, MatlabStruct) and parameter.kind == ENUMERATION and len(arguments) == 1:
            return self.value(arguments[0])
        return index_value(self, s.force(parameter), arguments, name)

    def _unmade(self, arguments: Sequence[m.Expression]) -> list[s.SymbolicValue]:
        """Return the arguments of a function, with array parameters deferred: they may become tables."""
        if any(isinstance(tree, m.CellIndex | m.Colon) for tree in arguments):
            return self.argument_values(arguments)
        return [self._deferred_parameter(tree) or self.value(tree) for tree in arguments]

    def _deferred_parameter(self, tree: m.Expression) -> s.DeferredValue | None:
        """Return an array parameter that is not used yet; None for anything else."""
        value: s.SymbolicValue | None = None
        if isinstance(tree, m.Name):
            value = self.body.names.get(tree.name)
        elif isinstance(tree, m.Field) and dotted_name(tree.of) and dotted_name(tree).split(".")[0] in self.body.names:
            of = self.value(tree.of)
            is_single = isinstance(of, MatlabStruct) and of.elements.size == 1
            value = of.fields.get(tree.name) if isinstance(of, MatlabStruct) and is_single else None
        return value if isinstance(value, s.DeferredValue) and value.name else None

    def _function(self, name: str) -> m.FunctionDefinition | None:
        return self.context.function(name, self.body.frame.functions)

    def call_named(self, name: str, values: Sequence[s.SymbolicValue], wanted: int) -> tuple[s.SymbolicValue, ...]:
        """Call a function of the code, of a file or of the library; if all is constant, any other numerically."""
        function = self._function(name)
        if function is not None:
            return self.body.call(function, values, wanted)
        if name in self.library:
            return self.library[name].results(self, values, wanted)
        if wanted == 1 and (results := evaluate_constant_call(self, name, values)):
            return results
        if name in ("i", "j"):
            raise ProgramError(f"{name} is not a variable here, and complex numbers are not supported")
        raise ProgramError(f"unknown function or variable {name}")

    def argument_values(self, trees: Sequence[m.Expression]) -> list[s.SymbolicValue]:
        """Evaluate the arguments of a function; `c{:}` stands for all cells."""
        result: list[s.SymbolicValue] = []
        for tree in trees:
            if isinstance(tree, m.CellIndex) and tree.arguments == (m.Colon(),):
                cells = self.value(tree.of)
                result += cells.contents if isinstance(cells, MatlabCell) else ()
            else:
                result.append(":" if isinstance(tree, m.Colon) else self.value(tree))
        return result

    def _query(self, name: str, arguments: Sequence[m.Expression]) -> s.SymbolicValue | None:
        """Evaluate functions that depend on the call, such as nargin, or on whether a variable is defined."""
        if name in ("nargin", "nargout") and not arguments:
            frame = self.body.frame
            return s.constants(self.builder, frame.arguments if name == "nargin" else frame.wanted)
        if name in _OF_FOUND_INDEX and len(arguments) == 1 and (index := self._found_index(arguments[0])) is not None:
            result = self.apply(_OF_FOUND_INDEX[name], index, index)
            return result if name in ("numel", "length") else s.as_logical(result)
        if name == "isempty" and len(arguments) == 1 and isinstance(arguments[0], m.Name):
            return self._is_empty(arguments[0].name)
        if name == "exist" and arguments and isinstance(arguments[0], m.Text):
            return self._exists(arguments[0].value)
        return None

    def _found_index(self, tree: m.Expression) -> s.FoundIndex | None:
        """Return the index that `find` returns, or a variable with it; None for other expressions."""
        value = self.body.names.get(tree.name) if isinstance(tree, m.Name) else None
        if isinstance(tree, m.Call) and tree.of == m.Name("find"):
            value = self.value(tree)
        return value if isinstance(value, s.FoundIndex) else None

    def _exists(self, name: str) -> s.SymbolicValue:
        """Return the condition that a variable exists, which may depend on a decision."""
        value = self.body.names.get(name)
        if isinstance(value, s.ConditionalValue) and name not in self.body.frame.persistent:
            return np.array([[value.defined]], dtype=np.int64)
        return s.constants(self.builder, float(value is not None))

    def _is_empty(self, name: str) -> s.SymbolicValue | None:
        """Return the condition that a persistent variable has no value yet; None for other variables."""
        value = self.body.names.get(name)
        if name not in self.body.frame.persistent or not isinstance(value, s.ConditionalValue):
            return None
        if self.builder.value(value.defined) == 0.0:
            self.body.questions += 1
        return s.as_logical(np.array([[self.builder.call("not", value.defined)]], dtype=np.int64))

    def call_handle(
        self, handle: MatlabFunctionHandle, values: Sequence[s.SymbolicValue], wanted: int
    ) -> tuple[s.SymbolicValue, ...]:
        """Call the function that a variable holds."""
        body = handle.body
        if body is None:
            return self.call_named(handle.name, values, wanted)
        names = {**handle.variables, **dict(zip(handle.parameters, values, strict=False))}
        return (self.body.within(names, lambda: self.value(body)),)


def is_masked_assignment(evaluator: ExpressionEvaluator, target: m.Expression, tree: m.Expression) -> bool:
    """Return True if the target is indexed by a signal-dependent mask and the value may be so too."""
    if not isinstance(target, m.Call) or len(target.arguments) != 1 or not isinstance(target.of, m.Name):
        return False
    if target.of.name not in evaluator.body.names or not _selects(tree):
        return False
    result = evaluator.value(target.arguments[0]) if _is_mask_expression(evaluator, target.arguments[0]) else None
    return isinstance(result, s.LogicalNodes) and evaluator.context.numbers(result, "a mask") is None


def _is_mask_expression(evaluator: ExpressionEvaluator, tree: m.Expression) -> bool:
    """Return True if an index is syntactically a mask: a comparison, or a logical variable."""
    if isinstance(tree, m.Name):
        return isinstance(evaluator.body.names.get(tree.name), s.LogicalNodes)
    return isinstance(tree, m.Binary | m.Unary) and not _ranged(tree)


def _ranged(tree: m.Expression) -> bool:
    return isinstance(tree, m.End | m.Range | m.Colon) or any(map(_ranged, children(tree)))


def _selects(tree: m.Expression) -> bool:
    return isinstance(tree, m.Call) or any(map(_selects, children(tree)))


def assign_masked(evaluator: ExpressionEvaluator, target: m.Call, tree: m.Expression) -> s.SymbolicValue:
    """Return the variable after the assignment."""
    assert isinstance(target.of, m.Name)
    old = s.as_array(evaluator.body.read(target.of.name))
    mask = s.as_array(evaluator.value(target.arguments[0]))
    if mask.shape != old.shape:
        raise ProgramError("a mask that depends on signals differs in size from the indexed array")
    if not _is_elementwise(evaluator, tree):
        raise ProgramError("elements selected by a signal-dependent mask are not used element by element", MASK_REMEDY)
    evaluator.mask = mask
    try:
        new = s.as_array(evaluator.value(tree))
    finally:
        evaluator.mask = None
    if new.size != 1 and new.shape != old.shape:
        raise ProgramError("several elements are assigned through a mask that depends on signals", MASK_REMEDY)
    result = evaluator.apply("select", np.asarray(mask), np.broadcast_to(np.asarray(new), old.shape), old)
    return s.as_logical(result) if isinstance(old, s.LogicalNodes) and isinstance(new, s.LogicalNodes) else result


def _is_elementwise(evaluator: ExpressionEvaluator, tree: m.Expression) -> bool:
    """Return True if each element of an expression depends only on the same element of its arrays."""
    match tree:
        case m.Number() | m.Name():
            return True
        case m.Unary(_, operand):
            return _is_elementwise(evaluator, operand)
        case m.Binary(operator, left, right):
            return operator in _OPERATORS and _is_elementwise(evaluator, left) and _is_elementwise(evaluator, right)
        case m.Call(m.Name(name), arguments) if name in evaluator.body.names:
            return not isinstance(evaluator.body.names[name], MatlabFunctionHandle)
        case m.Call(m.Name(name), arguments):
            alone = name in ELEMENTWISE_NAMES or (name in ("min", "max") and len(arguments) == 2)
            return alone and all(_is_elementwise(evaluator, argument) for argument in arguments)
    return False


def _short(tree: m.Expression) -> str:
    return dotted_name(tree) or "it"
