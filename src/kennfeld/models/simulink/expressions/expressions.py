"""MATLAB expressions over graph nodes, so that derivatives with respect to named variables stay exact.

What the graph cannot say (ranges, functions of whole arrays) is evaluated as numbers instead; the variables in it are
then fixed, and `Expressions.frozen` tells which.
"""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.arrays import check_size
from kennfeld.models.simulink.expressions.declared import Declared
from kennfeld.models.simulink.expressions.no_value import BeyondGraphError, NoValueError
from kennfeld.models.simulink.expressions.signals import Nodes
from kennfeld.models.simulink.expressions.walk import Held, Walk, array_of
from kennfeld.models.simulink.variables.scopes import Array, Coded, Masked, Scope, Value, Variable

__all__ = ["Expressions"]

_CONSTANTS: Final = {
    "pi": math.pi, "inf": math.inf, "Inf": math.inf, "nan": math.nan, "NaN": math.nan, "eps": 2.0**-52, "true": 1.0,
    "false": 0.0, "realmax": float(np.finfo(np.float64).max), "realmin": float(np.finfo(np.float64).tiny),
}  # fmt: skip


class Expressions:
    """Turns the expressions of block parameters into arrays of graph nodes."""

    def __init__(self, loom: Loom, declared: Declared) -> None:
        self.loom = loom
        self.declared = declared
        self.frozen: dict[str, str] = {}
        self._codes: dict[tuple[str, int], dict[str, Value]] = {}
        self._known: dict[tuple[str, int, bool], Held] = {}

    def array(self, text: str, scope: Scope, live: bool = True, names: Mapping[str, Nodes] | None = None) -> Nodes:
        """The nodes of an expression, Int[rows, columns]; with `live`, named variables are looked up.

        `names` are names that stand for nodes of their own, such as the u of a function block.
        Raises `NoValueError`.
        """
        return array_of(self.held(text, scope, live, names), text)

    def numbers(self, text: str, scope: Scope) -> Array:
        """The numbers of an expression, Float[rows, columns]; raises `NoValueError`."""
        return self.values(self.array(text, scope, live=False), text)

    def computed(self, tree: m.Expression, scope: Scope, names: Mapping[str, Nodes]) -> Nodes:
        """The nodes of an expression over names that stand for nodes; raises `NoValueError`."""
        try:
            return Walk(self, scope, True, names).nodes(tree)
        except BeyondGraphError as beyond:
            unknown = f"the function {beyond.function} is not known for signals"
            raise NoValueError(unknown if beyond.function else str(beyond)) from None

    def tree_numbers(self, tree: m.Expression, scope: Scope) -> Array:
        """The numbers of an expression that is a tree already; raises `NoValueError`."""
        try:
            return self.values(Walk(self, scope, False, {}).nodes(tree))
        except BeyondGraphError as beyond:
            raise NoValueError(str(beyond)) from None

    def values(self, nodes: Nodes, text: str = "it") -> Array:
        """The numbers of constant nodes; raises `NoValueError` where one is no constant."""
        found = [self.loom.value(int(node)) for node in nodes.ravel()]
        if None in found:
            raise NoValueError(f"{text.strip()[:80]} is no constant")
        return np.array(found, dtype=np.float64).reshape(nodes.shape)

    def held(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes] | None = None) -> Held:
        """The value of an expression, whatever it is; raises `NoValueError`."""
        key = (text, id(scope), live)
        if names is not None or key not in self._known:
            value = self._evaluated(text, scope, live, names)
            if names is not None:
                return value
            self._known[key] = value
        return self._known[key]

    def _evaluated(self, text: str, scope: Scope, live: bool, names: Mapping[str, Nodes] | None) -> Held:
        if not text.strip():
            raise NoValueError("it is empty")
        try:
            tree = parse_expression(text)
            try:
                return Walk(self, scope, live, names or {}).value(tree)
            except BeyondGraphError as beyond:
                return self._fixed(text, tree, scope, live, names, str(beyond))
        except InputError as error:
            raise NoValueError(str(error.findings[0])) from None
        except RecursionError:
            raise NoValueError(f"{text.strip()[:60]} refers to itself or is nested too deeply") from None

    def _fixed(
        self, text: str, tree: m.Expression, scope: Scope, live: bool, names: Mapping[str, Nodes] | None, why: str
    ) -> Held:
        """The value as numbers, by the evaluator of MATLAB expressions."""
        from kennfeld.models.simulink.variables.numbers import Unknown, evaluated

        if names:
            raise NoValueError(why)
        given = evaluated(tree, lambda name: self._variable_value(name, scope))
        if isinstance(given, Unknown):
            raise NoValueError(given.why, given.undefined)
        if live and any(isinstance(scope.find(name), (Variable, Masked)) for name in given.names):
            self.frozen[text.strip()] = why
        return self.constant(given.value)

    def _variable_value(self, name: str, scope: Scope) -> Value | None:
        found = scope.find(name)
        if found is None:
            return None
        if isinstance(found, Variable):
            return _shown(found, scope) if name == "gcb" else found.value
        if isinstance(found, Coded):
            return self._coded(found)
        if not found.evaluated:
            return found.text
        held = self.held(found.text, found.outside, False)
        return self.values(held) if isinstance(held, np.ndarray) else held

    def fixed(self, value: Value) -> Nodes:
        """A value as constants of the graph, Int[rows, columns]; raises `NoValueError` where it is no array."""
        return array_of(self.constant(value), "it")

    def constant(self, value: Value) -> Held:
        """A value as constants of the graph."""
        if not isinstance(value, np.ndarray):
            return value
        check_size(value.size)
        made = [self.loom.const(float(number)) for number in value.ravel()]
        return np.atleast_2d(np.array(made, dtype=np.int64).reshape(value.shape))

    def name(self, name: str, scope: Scope, live: bool) -> Held:
        """What a name stands for; raises `NoValueError` where it stands for nothing."""
        found = scope.find(name)
        if isinstance(found, Masked):
            return self._masked(found, live)
        if isinstance(found, Coded):
            return self.constant(self._coded(found))
        if isinstance(found, Variable):
            return self.constant(_shown(found, scope)) if name == "gcb" else self.variable(name, found, live)
        if name in _CONSTANTS:
            return np.array([[self.loom.const(_CONSTANTS[name])]], dtype=np.int64)
        raise NoValueError(f"{name} is defined nowhere", name)

    def _coded(self, found: Coded) -> Value:
        """The value that a mask's code gives a name; the variables in it are fixed."""
        if (found.code, id(found.outside)) not in self._codes:
            from kennfeld.models.simulink.variables.numbers import made_by

            self._codes[found.code, id(found.outside)] = made_by(
                found.code, lambda name: self._known_number(name, found.outside)
            )
            self.frozen[found.code.strip()[:200]] = "a mask's code computes it"
        value = self._codes[found.code, id(found.outside)].get(found.name)
        if value is None:
            raise NoValueError(f"the mask's code gives {found.name} no value")
        return value

    def _known_number(self, name: str, scope: Scope) -> Value | None:
        try:
            return self._variable_value(name, scope)
        except NoValueError:
            return None

    def _masked(self, found: Masked, live: bool) -> Held:
        if not found.evaluated:
            return found.text
        if live and found.field in self.declared.promoted:
            numbers = self.numbers(found.text, found.outside)
            return self.declared.array(self.loom, found.field, Variable(numbers, source="a mask"))
        return self.held(found.text, found.outside, live)

    def variable(self, name: str, found: Variable, live: bool) -> Held:
        """A variable, looked up or as constants; parts of a struct are told from each other by their names."""
        if isinstance(found.value, np.ndarray) and live and not found.fixed:
            return self.declared.array(self.loom, name, found)
        return self.constant(found.value)


def _shown(found: Variable, scope: Scope) -> Value:
    """What a block says of itself: what the dialogs of the masks around it show."""
    if not (found.fixed and isinstance(found.value, Mapping)):
        return found.value
    return {**found.value, **scope.shown()}
