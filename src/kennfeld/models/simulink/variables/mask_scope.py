"""Parts of structs, by the names on the way to them: `a.b.c`.

The variables found so far, while one source after the other is read.

What a name means in a block's parameters: masks from the inside out, then the variables of the model.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, Union

import numpy as np

from kennfeld.errors import Finding
from kennfeld.matlab import syntax as m
from kennfeld.matlab.evaluator import free_names
from kennfeld.matlab.parser import parse_leniently
from kennfeld.matlab.printer import format_expression
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers
from kennfeld.models.simulink.reader.model_tree import ModelBlock, StoredSolver, split_arguments
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis

__all__ = [
    "USER_SOURCE",
    "MaskCodeVariable",
    "MaskVariable",
    "ParameterValue",
    "Scope",
    "Variable",
    "VariableTable",
    "equal_values",
    "names_assigned_by_functions",
    "nested_field",
    "to_parameter_value",
]

ParameterValue: TypeAlias = Union[Numbers, str, "Mapping[str, ParameterValue]", "tuple[ParameterValue, ...]"]

USER_SOURCE = "given"  # the source of values that are given by name


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable of the model: its value, and what its source says of it.

    `lower` and `upper` are a number each, or one for each number of the value. `source` names that source; `axes` are
    those that a calibration file gives a table. What is `fixed`, such as the members of an enumeration, is no
    parameter.
    """

    value: ParameterValue
    lower: float | Numbers = -np.inf
    upper: float | Numbers = np.inf
    unit: str = ""
    description: str = ""
    source: str = ""
    axes: tuple[Axis, ...] = ()
    fixed: bool = False

    def limited(self, lower: float | None, upper: float | None) -> "Variable":
        """The variable with the limits of its source, None for none; those that its own value breaks are left aside."""
        lowest, highest = -np.inf if lower is None else lower, np.inf if upper is None else upper
        value = self.value.get("Table") if isinstance(self.value, Mapping) else self.value
        if not isinstance(value, np.ndarray) or not np.all((value >= lowest) & (value <= highest)):
            return self
        return replace(self, lower=lowest, upper=highest)


@dataclass(frozen=True, eq=False)
class MaskVariable:
    """A mask's parameter: an expression over the names outside of the mask, or the text itself.

    `field` is "Path:Name", how the literal is promoted; `written` is what the dialog shows.
    """

    text: str
    outside: "Scope"
    evaluated: bool = True
    field: str = ""
    written: str = ""


@dataclass(frozen=True, eq=False)
class MaskCodeVariable:
    """A variable that a mask's code makes in a way that no single expression says."""

    name: str
    code: str
    outside: "Scope"


@dataclass(eq=False)
class Scope:
    """The names that the blocks of one system see."""

    variables: Mapping[str, Variable]
    masked: "dict[str, MaskVariable | MaskCodeVariable]" = field(default_factory=dict)
    outer: "Scope | None" = None

    def within(self, block: ModelBlock) -> "Scope":
        """The names inside of a subsystem."""
        if block.mask is None or not (block.mask.parameters or block.mask.initialization.strip()):
            return self
        inside = Scope(self.variables, {}, self)
        for one in block.mask.parameters:
            field = f"{block.path}:{one.name}"
            inside.masked[one.name] = MaskVariable(one.meaning, self, one.evaluated, field, one.expression)
        return _coded(inside, block.mask.initialization)

    def inside(self, block: ModelBlock, models: "Mapping[str, Scope]") -> "Scope":
        """The names inside of a subsystem, or of a referenced model, which has names of its own.

        To those the block may give other values, its model arguments; an empty one leaves that of the model.
        """
        own = models.get(block.model)
        if own is None:
            return self.within(block)
        around = self.within(block)
        given = {name: text for name, text in _arguments(block) if text.strip()}
        made = {name: MaskVariable(text, around, True, f"{block.path}:{name}", text) for name, text in given.items()}
        return Scope(own.variables, {**made}, own) if made else own

    def shown(self) -> dict[str, str]:
        """What the dialogs of the masks around show, by the names of their parameters; the inner ones win."""
        found: dict[str, str] = {}
        here: Scope | None = self
        while here is not None:
            said = {
                name: one.written for name, one in here.masked.items() if isinstance(one, MaskVariable) and one.field
            }
            found, here = {**said, **found}, here.outer
        return found

    def find(self, name: str) -> "MaskVariable | MaskCodeVariable | Variable | None":
        """What a name means here."""
        here: Scope | None = self
        while here is not None:
            if name in here.masked:
                return here.masked[name]
            here = here.outer
        return self.variables.get(name)

    def part(self, way: Sequence[str]) -> Variable | None:
        """The part of a struct that a calibration file gives a value by its full name, "Control.Gain"."""
        return self.variables.get(".".join(way)) if len(way) > 1 else None


def _arguments(block: ModelBlock) -> Iterator[tuple[str, str]]:
    """The arguments of a referenced model with their expressions: lists of texts, in old files parted by commas."""
    names, values = (
        block.listed(key) or split_arguments(block.value(key) or "")
        for key in ("ParameterArgumentNames", "ParameterArgumentValues")
    )
    return zip(map(str.strip, names), values, strict=False)


def _coded(scope: Scope, code: str) -> Scope:
    """The names after a mask's code has run: plain assignments stay expressions, one layer each.

    What other statements make, and what depends on that, is what the whole code leaves.
    """
    script, _ = parse_leniently(code)
    inside, left = scope, set[str]()
    for statement in script.statements:
        name = _plainly_assigned(statement)
        if name and isinstance(statement, m.Assign) and left.isdisjoint({name, *free_names(statement.value)}):
            inside = Scope(scope.variables, {name: MaskVariable(format_expression(statement.value), inside)}, inside)
        else:
            left |= names_assigned(statement)
    return (
        Scope(scope.variables, {name: MaskCodeVariable(name, code, scope) for name in left}, inside) if left else inside
    )


def _plainly_assigned(statement: m.Statement) -> str:
    """The name that a statement gives a value as a whole; empty where it does something else."""
    targets = statement.targets if isinstance(statement, m.Assign) else ()
    return targets[0].name if len(targets) == 1 and isinstance(targets[0], m.Name) else ""


def names_assigned(statement: m.Statement) -> frozenset[str]:
    """The variables that a statement gives values to."""
    match statement:
        case m.Assign(targets):
            return frozenset(name for target in targets if (name := _base(target)))
        case m.For(target, _, body):
            return frozenset({_base(target)}).union(*map(names_assigned, body))
        case m.While(_, body):
            return frozenset().union(*map(names_assigned, body))
        case m.If(branches, otherwise) | m.Switch(_, branches, otherwise):
            bodies = [*(one for branch in branches for one in branch.body), *otherwise]
            return frozenset().union(*map(names_assigned, bodies))
    return frozenset()


def names_assigned_by_functions(code: str) -> frozenset[str]:
    """The variables that a text of functions gives values to."""
    script, _ = parse_leniently(code)
    bodies = [one.body for one in script.functions]
    return frozenset(name for body in bodies for statement in body for name in names_assigned(statement))


def _base(target: m.Expression | None) -> str:
    while isinstance(target, (m.Field, m.Call, m.CellIndex)):
        target = target.of
    return target.name if isinstance(target, m.Name) else ""


def to_parameter_value(value: Any) -> ParameterValue | None:
    """A value in the few forms that models use: arrays of float64, texts, structs, tuples; None for others.

    >>> to_parameter_value(3), to_parameter_value({"a": [1, 2]})
    (array([3.]), {'a': array([1., 2.])})
    """
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        parts = {str(key): to_parameter_value(part) for key, part in value.items()}
        return {key: part for key, part in parts.items() if part is not None}
    try:
        array = None if value is None or np.iscomplexobj(value) else np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return _several(value)
    return np.atleast_1d(array) if array is not None else None


def _several(value: Any) -> ParameterValue | None:
    if not isinstance(value, (tuple, list)):
        return None
    parts = [to_parameter_value(part) for part in value]
    known = tuple(part for part in parts if part is not None)
    return known if len(known) == len(parts) else None


def nested_field(value: ParameterValue, way: list[str]) -> ParameterValue:
    """The part of a struct at the end of a way; raises `NoValueError`."""
    for at, name in enumerate(way[1:], 1):
        if not isinstance(value, Mapping) or name not in value:
            raise EvaluationError(f"{'.'.join(way[:at])} has no part {name}", ".".join(way))
        value = value[name]
    return value


class VariableTable(dict[str, Variable]):
    """Variables by name, with what was noticed while they were read.

    `undefined` says by name why scripts could give a variable no value, `solvers` are configurations by name,
    `strangers` parameters of calibration files that the model itself does not know.
    """

    def __init__(self) -> None:
        super().__init__()
        self.findings: list[Finding] = []
        self.undefined: dict[str, str] = {}
        self.solvers: dict[str, StoredSolver] = {}
        self.strangers = ParameterSet()


def equal_values(one: ParameterValue, other: ParameterValue) -> bool:
    """Whether two values are equal."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if not (isinstance(one, np.ndarray) and isinstance(other, np.ndarray)):
            return False
        return np.array_equal(np.atleast_2d(one), np.atleast_2d(other), equal_nan=True)
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(equal_values(one[key], other[key]) for key in one)
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(equal_values, one, other))
    return type(one) is type(other) and one == other
