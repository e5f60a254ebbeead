"""Expressions in block fields and chart code, whose variables are parameters with exact derivatives.

Expressions that the graph cannot represent are evaluated numerically. Their variables are then frozen and listed in
`ParameterExpressions.frozen`.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Final, TypeAlias

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.base.formatting import join_names
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.calibration_parameters import DeclaredParameters
from kennfeld.importers.simulink.variables.mask_scope import (
    MaskCodeVariable,
    MaskVariable,
    ParameterValue,
    Scope,
    Variable,
    canonical_path,
    nested_field,
    passes_array,
    split_index,
)
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.simulink_objects import ENUMERATION
from kennfeld.matlab.values import MatlabCell, MatlabStruct, StructArray, object_array
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import Evaluate, EvaluationContext, LibraryFunction
from kennfeld.models.imperative.evaluation_errors import EvaluationError, ProgramError
from kennfeld.models.imperative.graph_operators import ONE, TWO
from kennfeld.models.imperative.library import C_FUNCTIONS, SYMBOLIC_FUNCTIONS
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, check_size
from kennfeld.models.imperative.statement_interpreter import StatementInterpreter
from kennfeld.program import tree as m
from kennfeld.program.traversal import element_path

FieldValue: TypeAlias = "Nodes | str | Mapping[str, ParameterValue] | tuple[ParameterValue, ...]"

_NAMES: Final = (
    "pi", "inf", "Inf", "nan", "NaN", "eps", "true", "false", "realmax", "realmin", "zeros", "ones", "reshape",
    "linspace", "numel", "length", "not", "min", "max", "sum", "prod", "double", "single", "boolean", "logical", "int8",
    "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
)  # fmt: skip
# functions whose derivatives block fields keep; the other ones, often of whole tables, are evaluated numerically
FIELD_FUNCTIONS: Final[Mapping[str, LibraryFunction]] = {
    **{name: SYMBOLIC_FUNCTIONS[name] for name in (*_NAMES, *ONE, *TWO)},
    **C_FUNCTIONS,
}
_TEXT_FUNCTIONS: Final = ("eval", "str2num", "str2double")


class ParameterExpressions:
    """Evaluator of block fields on graph nodes."""

    def __init__(self, builder: GraphBuilder, declared: DeclaredParameters) -> None:
        self.builder = builder
        self.declared = declared
        self.frozen: dict[str, str] = {}
        self._assumed: frozenset[str] = frozenset()
        self._codes: dict[tuple[str, int], dict[str, ParameterValue]] = {}
        self._known: dict[tuple[str, int, bool], FieldValue] = {}

    def array(self, text: str, scope: Scope, live: bool = True, names: Mapping[str, Nodes] | None = None) -> Nodes:
        """Return the nodes of an expression.

        Args:
            text: the expression.
            scope: names that the block sees.
            live: look variables up as parameters instead of freezing them.
            names: nodes of further names, such as the u of a Fcn block.

        Returns:
            Int[rows, columns].

        Raises:
            EvaluationError: if the expression has no value.
        """
        return _array_of(self.evaluate(text, scope, live, names), text)

    @contextmanager
    def assuming(self, names: Collection[str]) -> Iterator[None]:
        """Take undefined variables as 1, in order to find the other undefined ones."""
        self._assumed, before = frozenset(names), self._assumed
        try:
            yield
        finally:
            self._assumed = before

    def numbers(self, text: str, scope: Scope) -> Numbers:
        """Return the numbers of an expression, Float[rows, columns]; raises `EvaluationError`."""
        return self.values(self.array(text, scope, live=False), text)

    def tree_numbers(self, tree: m.Expression, scope: Scope) -> Numbers:
        """Return the numbers of an expression tree, Float[rows, columns]; raises `EvaluationError`."""
        try:
            return self.values(self.interpreter(scope, live=False).expressions.nodes(tree))
        except EvaluationError:
            raise
        except ProgramError as error:
            raise EvaluationError(error.message) from None

    def tree_array(self, tree: m.Expression, scope: Scope) -> Nodes:
        """Return the nodes of a part of an expression, whose variables stay parameters; raises `EvaluationError`."""
        try:
            value = self._evaluate_tree(tree, scope, True, {})
        except EvaluationError:
            raise
        except ProgramError as error:
            raise EvaluationError(error.message) from None
        if not isinstance(value, np.ndarray):
            raise EvaluationError("it is not a number")
        return value

    def values(self, nodes: Nodes, text: str = "it") -> Numbers:
        """Return the numbers of constant nodes; raise `EvaluationError` if one is not constant."""
        numbers = [self.builder.value(int(node)) for node in nodes.ravel()]
        if None in numbers:
            raise EvaluationError(f"{text.strip()[:80]} is not constant")
        return np.array(numbers, dtype=np.float64).reshape(nodes.shape)

    def evaluate(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes] | None = None) -> FieldValue:
        """Return the value of an expression; raises `EvaluationError`."""
        # such values hold for this call only
        if names is not None or self._assumed:
            return self._evaluate_text(text, scope, live, names or {})
        key = (text, id(scope), live)
        if key not in self._known:
            self._known[key] = self._evaluate_text(text, scope, live, {})
        return self._known[key]

    def _evaluate_text(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes]) -> FieldValue:
        if not text.strip():
            raise EvaluationError("it is empty")
        try:
            tree = parse_expression(text)
            try:
                return self._evaluate_tree(tree, scope, live, names)
            except EvaluationError:
                raise
            except ProgramError as error:
                # these names stand for signals, which have no numbers yet
                if names:
                    raise EvaluationError(error.message) from None
                # functions without a rule on nodes are computed from the present values, which are then fixed
                return self._evaluate_frozen(text, tree, scope, live, error.message)
        except InputError as error:
            raise EvaluationError(str(error.findings[0])) from None
        except RecursionError:
            raise EvaluationError(f"{text.strip()[:60]} refers to itself or is nested too deeply") from None

    def _evaluate_tree(self, tree: m.Expression, scope: Scope, live: bool, names: Mapping[str, Nodes]) -> FieldValue:
        path = element_path(tree)
        if path is not None and path[0] not in names and (variable := self._find(path, scope, live)) is not None:
            return variable
        value = s.force(self.interpreter(scope, live, names).value(tree))
        return value if isinstance(value, str) else s.as_array(value)

    def interpreter(
        self,
        scope: Scope,
        live: bool = True,
        names: Mapping[str, Nodes] | None = None,
        library: Mapping[str, LibraryFunction] = FIELD_FUNCTIONS,
        refuse: Callable[[str], ProgramError] = lambda name: ProgramError(f"the function {name} requires numbers"),
        single_elements: bool = True,
    ) -> StatementInterpreter:
        """Return an interpreter of code that sees the names of a scope; `refuse` makes errors of other functions."""

        def call_unknown(evaluate: Evaluate, name: str, arguments: Sequence[m.Expression]) -> s.SymbolicValue | None:
            if not arguments:
                raise EvaluationError(f"{name} is undefined", name)
            if name == "get_param":
                return self._query_model(evaluate, arguments)
            values = [evaluate(argument) for argument in arguments]  # reports undefined variables by name
            if name not in _TEXT_FUNCTIONS:
                raise refuse(name)
            if len(values) != 1 or not isinstance(values[0], str):
                raise EvaluationError(f"{name} is only supported with one text argument")
            value = self.evaluate(values[0], scope, live)
            return value if isinstance(value, np.ndarray) else _constant_value(self.builder, value)

        context = EvaluationContext(
            self.builder,
            workspace=lambda name: self._symbolic(name, scope, live),
            parameters_first=True,
            single_elements=single_elements,
            number=partial(parameter_value_at, self),
            library=library,
            unknown=call_unknown,
        )
        return StatementInterpreter(context, names)

    def _symbolic(self, name: str, scope: Scope, live: bool) -> s.SymbolicValue | None:
        """Return the value of a name, or of a path of fields, for code; None if it is undefined."""
        value = self._find(name.split("."), scope, live)
        if value is None or isinstance(value, np.ndarray | str):
            return value
        variable = scope.find(name)
        is_fixed = isinstance(variable, Variable) and variable.fixed
        if isinstance(value, StructArray) and isinstance(variable, Variable | MaskVariable) and not is_fixed:
            return self._struct_array(name, value, scope, live)
        return _constant_value(self.builder, value, is_fixed)

    def _struct_array(self, name: str, value: StructArray, scope: Scope, live: bool) -> MatlabStruct:
        """Return an array of structs for code, whose fields are looked up as parameters when they are used."""

        def field(at: int, key: str) -> s.SymbolicValue:
            path = [f"{name}({at})", key]
            element = self._find(path, scope, live)
            if element is None:  # an expression of the mask, whose elements have no names
                return _constant_value(self.builder, value[at - 1][key])
            if isinstance(element, StructArray):
                return self._struct_array(".".join(path), element, scope, live)
            return element if isinstance(element, np.ndarray) else _constant_value(self.builder, element)

        elements = [
            {key: s.DeferredValue(partial(field, at, key)) for key in value.names} for at in range(1, len(value) + 1)
        ]
        return MatlabStruct(object_array(elements, value.shape), value.names)

    def _query_model(self, evaluate: Evaluate, arguments: Sequence[m.Expression]) -> str:
        holder, *keys = arguments
        # bdroot of any block is the model
        if isinstance(holder, m.Call) and holder.of == m.Name("bdroot"):
            holder = holder.of
        model, key = evaluate(holder), evaluate(keys[0]) if len(keys) == 1 else ""
        fields = model.fields if isinstance(model, MatlabStruct) else {}
        text = s.force(fields[key]) if isinstance(key, str) and key in fields else None
        if not isinstance(text, str):
            raise EvaluationError(f"get_param({str(key)[:40] or 'nothing'}) requires Simulink")
        return text

    def _evaluate_frozen(self, text: str, tree: m.Expression, scope: Scope, live: bool, why: str) -> FieldValue:
        """Evaluate an expression numerically and record why its variables are frozen."""
        from kennfeld.importers.simulink.variables.m_files import evaluate_numerically

        value, used = evaluate_numerically(tree, lambda name: self._variable_value(name, scope))
        if live and any(isinstance(scope.find(name), (Variable, MaskVariable)) for name in used):
            self.frozen[text.strip()] = why
        return self.constant(value)

    def _variable_value(self, name: str, scope: Scope) -> ParameterValue | None:
        variable = scope.find(name)
        if variable is None:
            return None
        if isinstance(variable, Variable):
            return _dialog_values(variable, scope) if name == "gcb" else variable.value
        if isinstance(variable, MaskCodeVariable):
            return self._run_mask_code(variable)
        if not variable.evaluated:
            return variable.text
        value = self.evaluate(variable.text, variable.outside, False)
        return self.values(value) if isinstance(value, np.ndarray) else value

    def freeze(self, value: ParameterValue) -> Nodes:
        """Return a value as constant nodes, Int[rows, columns]; raise `EvaluationError` if it is not an array."""
        return _array_of(self.constant(value), "it")

    def constant(self, value: ParameterValue) -> FieldValue:
        """Return a value as graph constants."""
        if not isinstance(value, np.ndarray):
            return value
        check_size(value.size)
        return s.constants(self.builder, np.asarray(value, dtype=np.float64))

    def _find(self, path: Sequence[str], scope: Scope, live: bool) -> "FieldValue | None":
        """Return the value of a name or of a path of fields; None if the name is undefined."""
        base, index = split_index(path[0])
        name, variable = ".".join(path), scope.find(base)
        # a number that may be divided by and is a size: the evaluation is to reach the next undefined name
        if name in self._assumed or base in self._assumed:
            return s.constants(self.builder, np.ones((1, 1)))
        # a struct that a mask passes on: its fields keep the names that they have outside, and are calibrated by these
        if isinstance(variable, MaskVariable) and len(path) > 1:
            # that of the first field behind it, as the text may name an element of an array of structs
            outside = element_path(m.Field(_indexed(parse_expression(variable.text), index), path[1]))
            return self._find([*outside, *path[2:]], variable.outside, live) if outside is not None else None
        if isinstance(variable, Variable):
            if passes_array(variable.value, path):
                return None
            path = canonical_path(variable.value, path)
            name = ".".join(path)
        if (part := scope.part(path)) is not None:
            return self.variable(name, part, live)
        if isinstance(variable, MaskVariable | MaskCodeVariable):
            return self.mask_value(variable, live) if len(path) == 1 else None
        if variable is None:
            if len(path) > 1:
                raise EvaluationError(f"{base} is undefined", name)
            return None
        if len(path) > 1:
            return self.variable(name, _field_of(variable, list(path)), live)
        return self.constant(_dialog_values(variable, scope)) if name == "gcb" else self.variable(name, variable, live)

    def _run_mask_code(self, variable: MaskCodeVariable) -> ParameterValue:
        """Return the value that mask code assigns to a name; its variables are frozen."""
        # one run of the code serves all variables that it assigns
        key = variable.code, id(variable.outside)
        if key not in self._codes:
            from kennfeld.importers.simulink.variables.m_files import run_mask_code

            self._codes[key] = run_mask_code(variable.code, lambda name: self._known_number(name, variable.outside))
            self.frozen[variable.code.strip()[:200]] = "it is computed by mask code"
        value = self._codes[key].get(variable.name)
        if value is None:
            raise EvaluationError(f"the mask code assigns no value to {variable.name}")
        return value

    def _known_number(self, name: str, scope: Scope) -> ParameterValue | None:
        # code may read what is unknown here, and not need it for the variables that are asked for
        try:
            return self._variable_value(name, scope)
        except EvaluationError:
            return None

    def mask_value(self, variable: MaskVariable | MaskCodeVariable, live: bool = True) -> FieldValue:
        """Return the value of a variable of a mask; raise `EvaluationError` if it has none."""
        if isinstance(variable, MaskCodeVariable):
            return self.constant(self._run_mask_code(variable))
        if not variable.evaluated:
            return variable.text
        if live and variable.field in self.declared.promoted:
            numbers = self.numbers(variable.text, variable.outside)
            return self.declared.array(self.builder, variable.field, Variable(numbers, source="a mask"))
        return self.evaluate(variable.text, variable.outside, live)

    def variable(self, name: str, variable: Variable, live: bool) -> FieldValue:
        """Return a variable, looked up or as constants; fields of structs are named by their paths."""
        if isinstance(variable.value, np.ndarray) and live and not variable.fixed:
            return self.declared.array(self.builder, name, variable)
        return self.constant(variable.value)


def _indexed(tree: m.Expression, index: int) -> m.Expression:
    """Return the element of an index, counted from 1, of an expression; the expression for 0."""
    return m.Call(tree, (m.Number(float(index)),)) if index else tree


def _array_of(value: FieldValue, text: str) -> Nodes:
    if isinstance(value, np.ndarray):
        return value
    kind = "a text" if isinstance(value, str) else "a struct" if isinstance(value, Mapping) else "a list"
    raise EvaluationError(f"{text.strip()[:60]} must be a number, got {kind}")


def _constant_value(builder: GraphBuilder, value: ParameterValue, is_enumeration: bool = False) -> s.SymbolicValue:
    """Return a value for code, whose numbers become constants when they are used."""
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        fields = {key: s.DeferredValue(partial(_constant_value, builder, part)) for key, part in value.items()}
        return MatlabStruct.of(fields, ENUMERATION if is_enumeration else "")
    if isinstance(value, StructArray):
        elements = [
            {key: s.DeferredValue(partial(_constant_value, builder, part[key])) for key in value.names}
            for part in value
        ]
        return MatlabStruct(object_array(elements, value.shape), value.names)
    if isinstance(value, tuple):
        return MatlabCell.of((_constant_value(builder, part) for part in value), (1, len(value)))
    return s.constants(builder, np.asarray(value, dtype=np.float64))


def _field_of(variable: Variable, path: list[str]) -> Variable:
    """Return the field at the end of a path; raises `EvaluationError` if there is none."""
    if variable.fixed and isinstance(variable.value, Mapping) and path[1] not in variable.value:
        members = join_names(list(variable.value), 8)
        message = f"the enumeration {path[0]} has no member {path[1]}; its members are {members}"
        raise EvaluationError(message, remedy=f"Correct the name, or add the member to {variable.source}.")
    return Variable(nested_field(variable.value, path), source=variable.source, fixed=variable.fixed)


def _dialog_values(variable: Variable, scope: Scope) -> ParameterValue:
    """Return the dialog values of the enclosing masks, which a block may query."""
    if not (variable.fixed and isinstance(variable.value, Mapping)):
        return variable.value
    return {**variable.value, **scope.shown()}


def parameter_value_at(expressions: ParameterExpressions, name: str, place: tuple[int, ...]) -> float | None:
    """Return the source value of an element of a parameter, None of a table."""
    parameter = expressions.declared.parameters.get(name)
    if parameter is None or parameter.axes:
        return None
    values = np.asarray(parameter.values, dtype=np.float64)
    return float(values[place] if place else values.ravel()[0])
