"""MATLAB expressions over graph nodes, so that derivatives with respect to named variables stay exact.

What the graph cannot say (ranges, functions of whole arrays) is evaluated as numbers instead; the variables in it are
then fixed, and `Expressions.frozen` tells which.

The parameters of a model as values of code: variables stay parameters, structs are taken apart when used.
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
from kennfeld.models.simulink.expressions.field_evaluator import FieldValue, Walk, array_of
from kennfeld.models.simulink.variables.mask_scope import (
    MaskCodeVariable,
    MaskVariable,
    ParameterValue,
    Scope,
    Variable,
)

__all__ = ["Expressions", "parameter_value_at", "resolve_parameter"]

_CONSTANTS: Final = {
    "pi": math.pi, "inf": math.inf, "Inf": math.inf, "nan": math.nan, "NaN": math.nan, "eps": 2.0**-52, "true": 1.0,
    "false": 0.0, "realmax": float(np.finfo(np.float64).max), "realmin": float(np.finfo(np.float64).tiny),
}  # fmt: skip

_GIVE = "Give its variables among the parameters: a script, a .mat, .sldd or calibration file."


class Expressions:
    """Turns the expressions of block parameters into arrays of graph nodes."""

    def __init__(self, builder: GraphBuilder, declared: DeclaredParameters) -> None:
        self.builder = builder
        self.declared = declared
        self.frozen: dict[str, str] = {}
        self._codes: dict[tuple[str, int], dict[str, ParameterValue]] = {}
        self._known: dict[tuple[str, int, bool], FieldValue] = {}

    def array(self, text: str, scope: Scope, live: bool = True, names: Mapping[str, Nodes] | None = None) -> Nodes:
        """The nodes of an expression, Int[rows, columns]; with `live`, named variables are looked up.

        `names` are names that stand for nodes of their own, such as the u of a function block.
        Raises `NoValueError`.
        """
        return array_of(self.held(text, scope, live, names), text)

    def numbers(self, text: str, scope: Scope) -> Numbers:
        """The numbers of an expression, Float[rows, columns]; raises `NoValueError`."""
        return self.values(self.array(text, scope, live=False), text)

    def computed(self, tree: m.Expression, scope: Scope, names: Mapping[str, Nodes]) -> Nodes:
        """The nodes of an expression over names that stand for nodes; raises `NoValueError`."""
        try:
            return Walk(self, scope, True, names).nodes(tree)
        except NotLowerableError as beyond:
            unknown = f"the function {beyond.function} is not known for signals"
            raise EvaluationError(unknown if beyond.function else str(beyond)) from None

    def tree_numbers(self, tree: m.Expression, scope: Scope) -> Numbers:
        """The numbers of an expression that is a tree already; raises `NoValueError`."""
        try:
            return self.values(Walk(self, scope, False, {}).nodes(tree))
        except NotLowerableError as beyond:
            raise EvaluationError(str(beyond)) from None

    def values(self, nodes: Nodes, text: str = "it") -> Numbers:
        """The numbers of constant nodes; raises `NoValueError` where one is no constant."""
        found = [self.builder.value(int(node)) for node in nodes.ravel()]
        if None in found:
            raise EvaluationError(f"{text.strip()[:80]} is no constant")
        return np.array(found, dtype=np.float64).reshape(nodes.shape)

    def held(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes] | None = None) -> FieldValue:
        """The value of an expression, whatever it is; raises `NoValueError`."""
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
                return Walk(self, scope, live, names or {}).value(tree)
            except NotLowerableError as beyond:
                return self._fixed(text, tree, scope, live, names, str(beyond))
        except InputError as error:
            raise EvaluationError(str(error.findings[0])) from None
        except RecursionError:
            raise EvaluationError(f"{text.strip()[:60]} refers to itself or is nested too deeply") from None

    def _fixed(
        self, text: str, tree: m.Expression, scope: Scope, live: bool, names: Mapping[str, Nodes] | None, why: str
    ) -> FieldValue:
        """The value as numbers, by the evaluator of MATLAB expressions."""
        from kennfeld.models.simulink.variables.m_files import EvaluationFailure, evaluate_numerically

        if names:
            raise EvaluationError(why)
        given = evaluate_numerically(tree, lambda name: self._variable_value(name, scope))
        if isinstance(given, EvaluationFailure):
            raise EvaluationError(given.why, given.undefined)
        if live and any(isinstance(scope.find(name), (Variable, MaskVariable)) for name in given.names):
            self.frozen[text.strip()] = why
        return self.constant(given.value)

    def _variable_value(self, name: str, scope: Scope) -> ParameterValue | None:
        found = scope.find(name)
        if found is None:
            return None
        if isinstance(found, Variable):
            return _shown(found, scope) if name == "gcb" else found.value
        if isinstance(found, MaskCodeVariable):
            return self._coded(found)
        if not found.evaluated:
            return found.text
        held = self.held(found.text, found.outside, False)
        return self.values(held) if isinstance(held, np.ndarray) else held

    def fixed(self, value: ParameterValue) -> Nodes:
        """A value as constants of the graph, Int[rows, columns]; raises `NoValueError` where it is no array."""
        return array_of(self.constant(value), "it")

    def constant(self, value: ParameterValue) -> FieldValue:
        """A value as constants of the graph."""
        if not isinstance(value, np.ndarray):
            return value
        check_size(value.size)
        made = [self.builder.const(float(number)) for number in value.ravel()]
        return np.atleast_2d(np.array(made, dtype=np.int64).reshape(value.shape))

    def name(self, name: str, scope: Scope, live: bool) -> FieldValue:
        """What a name stands for; raises `NoValueError` where it stands for nothing."""
        found = scope.find(name)
        if isinstance(found, MaskVariable):
            return self._masked(found, live)
        if isinstance(found, MaskCodeVariable):
            return self.constant(self._coded(found))
        if isinstance(found, Variable):
            return self.constant(_shown(found, scope)) if name == "gcb" else self.variable(name, found, live)
        if name in _CONSTANTS:
            return np.array([[self.builder.const(_CONSTANTS[name])]], dtype=np.int64)
        raise EvaluationError(f"{name} is defined nowhere", name)

    def _coded(self, found: MaskCodeVariable) -> ParameterValue:
        """The value that a mask's code gives a name; the variables in it are fixed."""
        if (found.code, id(found.outside)) not in self._codes:
            from kennfeld.models.simulink.variables.m_files import run_mask_code

            self._codes[found.code, id(found.outside)] = run_mask_code(
                found.code, lambda name: self._known_number(name, found.outside)
            )
            self.frozen[found.code.strip()[:200]] = "a mask's code computes it"
        value = self._codes[found.code, id(found.outside)].get(found.name)
        if value is None:
            raise EvaluationError(f"the mask's code gives {found.name} no value")
        return value

    def _known_number(self, name: str, scope: Scope) -> ParameterValue | None:
        try:
            return self._variable_value(name, scope)
        except EvaluationError:
            return None

    def _masked(self, found: MaskVariable, live: bool) -> FieldValue:
        if not found.evaluated:
            return found.text
        if live and found.field in self.declared.promoted:
            numbers = self.numbers(found.text, found.outside)
            return self.declared.array(self.builder, found.field, Variable(numbers, source="a mask"))
        return self.held(found.text, found.outside, live)

    def variable(self, name: str, found: Variable, live: bool) -> FieldValue:
        """A variable, looked up or as constants; parts of a struct are told from each other by their names."""
        if isinstance(found.value, np.ndarray) and live and not found.fixed:
            return self.declared.array(self.builder, name, found)
        return self.constant(found.value)


def _shown(found: Variable, scope: Scope) -> ParameterValue:
    """What a block says of itself: what the dialogs of the masks around it show."""
    if not (found.fixed and isinstance(found.value, Mapping)):
        return found.value
    return {**found.value, **scope.shown()}


def resolve_parameter(
    expressions: Expressions, scope: Scope, name: str, enumeration: Callable[[str], Variable | None] = lambda name: None
) -> SymbolicValue | None:
    """What a name means among the parameters of a model, or enumerations; None where it means nothing."""
    found = scope.find(name) or enumeration(name)
    if found is None:
        return None
    try:
        if isinstance(found, MaskVariable):
            return _masked(expressions, scope, found, name)
        if isinstance(found, MaskCodeVariable):
            held = expressions.name(name, scope, True)
            return held if isinstance(held, np.ndarray) else _made(expressions, scope, Variable(held), [name])
        return _made(expressions, scope, found, [name])
    except (EvaluationError, InputError) as error:
        raise ProgramError(f"the parameter {name}: {error}", _GIVE) from None


def _masked(expressions: Expressions, scope: Scope, found: MaskVariable, name: str) -> SymbolicValue:
    """A parameter of a mask: a struct keeps the names that it has outside of the mask."""
    held = expressions.name(name, scope, True)
    if isinstance(held, np.ndarray | str):
        return held
    outside = field_path(parse_expression(found.text))
    if outside is not None and len(outside) == 1:
        whole = resolve_parameter(expressions, found.outside, outside[0])
        if whole is not None:
            return whole
    return _made(expressions, scope, Variable(held), [name])


def _made(expressions: Expressions, scope: Scope, variable: Variable, way: list[str]) -> SymbolicValue:
    """A variable, or the part of one at the end of a way."""
    value, name = variable.value, ".".join(way)
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        fields = {key: _field(expressions, scope, variable, [*way, key]) for key in value}
        return EnumerationStruct(fields) if variable.fixed and len(way) == 1 else SymbolicStruct(fields)
    if isinstance(value, tuple):
        parts = (Variable(part, source=variable.source, fixed=variable.fixed) for part in value)
        cells = [_part(expressions, scope, part, [f"{name}({at})"]) for at, part in enumerate(parts, 1)]
        return SymbolicCell(tuple(cells), (1, len(cells)))

    def array() -> SymbolicValue:
        held = expressions.variable(name, variable, True)
        assert isinstance(held, np.ndarray)
        return held

    return DeferredValue(array, name) if np.size(value) > 1 and not variable.fixed else array()


def _field(expressions: Expressions, scope: Scope, variable: Variable, way: list[str]) -> DeferredValue:
    """A field of a struct; a calibration file may give it a value by its full name."""
    assert isinstance(variable.value, Mapping)
    inside = Variable(variable.value[way[-1]], source=variable.source, fixed=variable.fixed)
    return _part(expressions, scope, scope.part(way) or inside, way)


def _part(expressions: Expressions, scope: Scope, part: Variable, way: list[str]) -> DeferredValue:
    table = isinstance(part.value, np.ndarray) and part.value.size > 1 and not part.fixed
    return DeferredValue(lambda: _made(expressions, scope, part, way), ".".join(way) if table else "")


def parameter_value_at(expressions: Expressions, name: str, place: tuple[int, ...]) -> float | None:
    """The number that an element of a parameter has by its source; None of a table."""
    found = expressions.declared.parameters.get(name)
    if found is None or found.axes:
        return None
    values = np.asarray(found.values, dtype=np.float64)
    return float(values[place] if place else values.ravel()[0])
