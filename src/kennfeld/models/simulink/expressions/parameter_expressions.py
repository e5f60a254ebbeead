"""MATLAB expressions over graph nodes, which keep derivatives with respect to variables exact.

Expressions that the graph cannot represent (ranges, functions of whole arrays) are evaluated numerically. Their
variables are then frozen and listed in `ParameterExpressions.frozen`. For code, parameters of the model are resolved to
symbolic values whose variables stay parameters; fields of structs are resolved on use.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from kennfeld.errors import InputError
from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression
from kennfeld.matlab.traversal import field_path
from kennfeld.models.imperative.evaluation_errors import EvaluationError, NotLowerableError, ProgramError
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, check_size
from kennfeld.models.imperative.symbolic_values import (
    DeferredValue,
    EnumerationStruct,
    SymbolicCell,
    SymbolicStruct,
    SymbolicValue,
)
from kennfeld.models.simulink.calibration_parameters import DeclaredParameters
from kennfeld.models.simulink.expressions.field_evaluator import FieldEvaluator, FieldValue, array_of
from kennfeld.models.simulink.variables.mask_scope import (
    MaskCodeVariable,
    MaskVariable,
    ParameterValue,
    Scope,
    Variable,
)

_CONSTANTS: Final = {
    "pi": math.pi, "inf": math.inf, "Inf": math.inf, "nan": math.nan, "NaN": math.nan, "eps": 2.0**-52, "true": 1.0,
    "false": 0.0, "realmax": float(np.finfo(np.float64).max), "realmin": float(np.finfo(np.float64).tiny),
}  # fmt: skip

_REMEDY = "Define its variables in a script, a .mat, .sldd or calibration file given as parameters."


class ParameterExpressions:
    """Evaluator of block fields on graph nodes."""

    def __init__(self, builder: GraphBuilder, declared: DeclaredParameters) -> None:
        self.builder = builder
        self.declared = declared
        self.frozen: dict[str, str] = {}
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
        return array_of(self.evaluate(text, scope, live, names), text)

    def numbers(self, text: str, scope: Scope) -> Numbers:
        """Return the numbers of an expression, Float[rows, columns]; raises `EvaluationError`."""
        return self.values(self.array(text, scope, live=False), text)

    def tree_nodes(self, tree: m.Expression, scope: Scope, names: Mapping[str, Nodes]) -> Nodes:
        """Return the nodes of an expression tree over names with given nodes; raises `EvaluationError`."""
        try:
            return FieldEvaluator(self, scope, True, names).nodes(tree)
        except NotLowerableError as beyond:
            unknown = f"the function {beyond.function} is not supported for signals"
            raise EvaluationError(unknown if beyond.function else str(beyond)) from None

    def tree_numbers(self, tree: m.Expression, scope: Scope) -> Numbers:
        """Return the numbers of an expression tree, Float[rows, columns]; raises `EvaluationError`."""
        try:
            return self.values(FieldEvaluator(self, scope, False, {}).nodes(tree))
        except NotLowerableError as beyond:
            raise EvaluationError(str(beyond)) from None

    def values(self, nodes: Nodes, text: str = "it") -> Numbers:
        """Return the numbers of constant nodes; raise `EvaluationError` if one is not constant."""
        numbers = [self.builder.value(int(node)) for node in nodes.ravel()]
        if None in numbers:
            raise EvaluationError(f"{text.strip()[:80]} is not constant")
        return np.array(numbers, dtype=np.float64).reshape(nodes.shape)

    def evaluate(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes] | None = None) -> FieldValue:
        """Return the value of an expression; raises `EvaluationError`."""
        key = (text, id(scope), live)
        if names is not None or key not in self._known:
            value = self._evaluated(text, scope, live, names)
            if names is not None:
                return value
            self._known[key] = value
        return self._known[key]

    def _evaluated(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes] | None) -> FieldValue:
        if not text.strip():
            raise EvaluationError("it is empty")
        try:
            tree = parse_expression(text)
            try:
                return FieldEvaluator(self, scope, live, names or {}).value(tree)
            except NotLowerableError as beyond:
                return self._evaluate_frozen(text, tree, scope, live, names, str(beyond))
        except InputError as error:
            raise EvaluationError(str(error.findings[0])) from None
        except RecursionError:
            raise EvaluationError(f"{text.strip()[:60]} refers to itself or is nested too deeply") from None

    def _evaluate_frozen(
        self, text: str, tree: m.Expression, scope: Scope, live: bool, names: Mapping[str, Nodes] | None, why: str
    ) -> FieldValue:
        """Evaluate an expression numerically and record why its variables are frozen."""
        from kennfeld.models.simulink.variables.m_files import EvaluationFailure, evaluate_numerically

        if names:
            raise EvaluationError(why)
        values = evaluate_numerically(tree, lambda name: self._variable_value(name, scope))
        if isinstance(values, EvaluationFailure):
            raise EvaluationError(values.why, values.undefined)
        if live and any(isinstance(scope.find(name), (Variable, MaskVariable)) for name in values.names):
            self.frozen[text.strip()] = why
        return self.constant(values.value)

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
        return array_of(self.constant(value), "it")

    def constant(self, value: ParameterValue) -> FieldValue:
        """Return a value as graph constants."""
        if not isinstance(value, np.ndarray):
            return value
        check_size(value.size)
        nodes = [self.builder.const(float(number)) for number in value.ravel()]
        return np.atleast_2d(np.array(nodes, dtype=np.int64).reshape(value.shape))

    def name(self, name: str, scope: Scope, live: bool) -> FieldValue:
        """Return the value of a name; raise `EvaluationError` if it is undefined."""
        variable = scope.find(name)
        if isinstance(variable, MaskVariable):
            return self._masked(variable, live)
        if isinstance(variable, MaskCodeVariable):
            return self.constant(self._run_mask_code(variable))
        if isinstance(variable, Variable):
            return (
                self.constant(_dialog_values(variable, scope)) if name == "gcb" else self.variable(name, variable, live)
            )
        if name in _CONSTANTS:
            return np.array([[self.builder.const(_CONSTANTS[name])]], dtype=np.int64)
        raise EvaluationError(f"{name} is undefined", name)

    def _run_mask_code(self, variable: MaskCodeVariable) -> ParameterValue:
        """Return the value that mask code assigns to a name; its variables are frozen."""
        if (variable.code, id(variable.outside)) not in self._codes:
            from kennfeld.models.simulink.variables.m_files import run_mask_code

            self._codes[variable.code, id(variable.outside)] = run_mask_code(
                variable.code, lambda name: self._known_number(name, variable.outside)
            )
            self.frozen[variable.code.strip()[:200]] = "it is computed by mask code"
        value = self._codes[variable.code, id(variable.outside)].get(variable.name)
        if value is None:
            raise EvaluationError(f"the mask code assigns no value to {variable.name}")
        return value

    def _known_number(self, name: str, scope: Scope) -> ParameterValue | None:
        try:
            return self._variable_value(name, scope)
        except EvaluationError:
            return None

    def _masked(self, variable: MaskVariable, live: bool) -> FieldValue:
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


def _dialog_values(variable: Variable, scope: Scope) -> ParameterValue:
    """Return the dialog values of the enclosing masks, which a block may query."""
    if not (variable.fixed and isinstance(variable.value, Mapping)):
        return variable.value
    return {**variable.value, **scope.shown()}


def resolve_parameter(
    expressions: ParameterExpressions,
    scope: Scope,
    name: str,
    enumeration: Callable[[str], Variable | None] = lambda name: None,
) -> SymbolicValue | None:
    """Resolve a name in code among model parameters and enumerations; None if undefined."""
    variable = scope.find(name) or enumeration(name)
    if variable is None:
        return None
    try:
        if isinstance(variable, MaskVariable):
            return _resolve_mask_parameter(expressions, scope, variable, name)
        if isinstance(variable, MaskCodeVariable):
            value = expressions.name(name, scope, True)
            return (
                value
                if isinstance(value, np.ndarray)
                else _resolve_variable(expressions, scope, Variable(value), [name])
            )
        return _resolve_variable(expressions, scope, variable, [name])
    except (EvaluationError, InputError) as error:
        raise ProgramError(f"parameter {name}: {error}", _REMEDY) from None


def _resolve_mask_parameter(
    expressions: ParameterExpressions, scope: Scope, variable: MaskVariable, name: str
) -> SymbolicValue:
    """Resolve a mask parameter; a struct keeps the names it has outside of the mask."""
    value = expressions.name(name, scope, True)
    if isinstance(value, np.ndarray | str):
        return value
    outside = field_path(parse_expression(variable.text))
    if outside is not None and len(outside) == 1:
        whole = resolve_parameter(expressions, variable.outside, outside[0])
        if whole is not None:
            return whole
    return _resolve_variable(expressions, scope, Variable(value), [name])


def _resolve_variable(
    expressions: ParameterExpressions, scope: Scope, variable: Variable, path: list[str]
) -> SymbolicValue:
    """Resolve a variable or the field at a path in it."""
    value, name = variable.value, ".".join(path)
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        fields = {key: _defer_field(expressions, scope, variable, [*path, key]) for key in value}
        return EnumerationStruct(fields) if variable.fixed and len(path) == 1 else SymbolicStruct(fields)
    if isinstance(value, tuple):
        parts = (Variable(part, source=variable.source, fixed=variable.fixed) for part in value)
        cells = [_part(expressions, scope, part, [f"{name}({at})"]) for at, part in enumerate(parts, 1)]
        return SymbolicCell(tuple(cells), (1, len(cells)))

    def array() -> SymbolicValue:
        nodes = expressions.variable(name, variable, True)
        assert isinstance(nodes, np.ndarray)
        return nodes

    return DeferredValue(array, name) if np.size(value) > 1 and not variable.fixed else array()


def _defer_field(expressions: ParameterExpressions, scope: Scope, variable: Variable, path: list[str]) -> DeferredValue:
    """Resolve a field of a struct, which a calibration file may override by its full name."""
    assert isinstance(variable.value, Mapping)
    inside = Variable(variable.value[path[-1]], source=variable.source, fixed=variable.fixed)
    return _part(expressions, scope, scope.part(path) or inside, path)


def _part(expressions: ParameterExpressions, scope: Scope, part: Variable, path: list[str]) -> DeferredValue:
    table = isinstance(part.value, np.ndarray) and part.value.size > 1 and not part.fixed
    return DeferredValue(lambda: _resolve_variable(expressions, scope, part, path), ".".join(path) if table else "")


def parameter_value_at(expressions: ParameterExpressions, name: str, place: tuple[int, ...]) -> float | None:
    """Return the source value of an element of a parameter, None of a table."""
    parameter = expressions.declared.parameters.get(name)
    if parameter is None or parameter.axes:
        return None
    values = np.asarray(parameter.values, dtype=np.float64)
    return float(values[place] if place else values.ravel()[0])
