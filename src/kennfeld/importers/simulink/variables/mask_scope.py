"""Name resolution in block fields: mask parameters from the innermost mask outwards, then model variables."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import Any, TypeAlias, Union

import numpy as np

from kennfeld.base.errors import Finding, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.importers.simulink.reader.model_tree import ModelBlock, StoredSolver, split_arguments
from kennfeld.matlab.parser import parse_leniently
from kennfeld.matlab.printer import format_expression
from kennfeld.matlab.values import StructArray
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers
from kennfeld.program import tree as m
from kennfeld.program.traversal import names_assigned, names_read

_ELEMENT = re.compile(r"(\w+)\((\d+)\)")
ParameterValue: TypeAlias = Union[Numbers, str, "Mapping[str, ParameterValue]", "tuple[ParameterValue, ...]"]

USER_SOURCE = "given"  # source of values given by name


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable of the model: its value, and further information from its source.

    `lower` and `upper` are one number, or one for each number of the value. `axes` are those that a calibration file
    gives a table. A `fixed` variable, such as an enumeration member, is not a parameter. A `local` one is of a model
    workspace, which other models do not see. `kind` is the class of an object that defines a data type, such as
    Simulink.Bus; its value then are its properties. `single` is True for numbers of single precision.
    """

    value: ParameterValue
    lower: float | Numbers = -np.inf
    upper: float | Numbers = np.inf
    unit: str = ""
    description: str = ""
    source: str = ""
    axes: tuple[Axis, ...] = ()
    fixed: bool = False
    local: bool = False
    kind: str = ""
    single: bool = False

    def limited(self, lower: float | None, upper: float | None) -> "Variable":
        """Add limits to the variable, None for none; limits that its own value violates are ignored."""
        lowest, highest = -np.inf if lower is None else lower, np.inf if upper is None else upper
        # limits of a table object are those of its table, not of its breakpoints
        value = self.value.get("Table") if isinstance(self.value, Mapping) else self.value
        if not isinstance(value, np.ndarray) or not np.all((value >= lowest) & (value <= highest)):
            return self
        return replace(self, lower=lowest, upper=highest)


@dataclass(frozen=True, eq=False)
class MaskVariable:
    """A mask parameter: an expression over the names outside of the mask, or a text.

    `field` is "Path:Name", under which the literal is promoted; `written` is the text in the dialog.
    """

    text: str
    outside: "Scope"
    evaluated: bool = True
    field: str = ""
    written: str = ""


@dataclass(frozen=True, eq=False)
class MaskCodeVariable:
    """A variable that mask code computes by more than a single expression."""

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
        """Add the mask of a block to the scope."""
        if block.mask is None or not (block.mask.parameters or block.mask.initialization.strip()):
            return self
        inside = Scope(self.variables, {}, self)
        for parameter in block.mask.parameters:
            field = f"{block.path}:{parameter.name}"
            # evaluated outside of the mask: a parameter K may be set to a variable K
            inside.masked[parameter.name] = MaskVariable(
                parameter.meaning, self, parameter.evaluated, field, parameter.expression
            )
        return _run_mask_code(inside, block.mask.initialization)

    def inside(self, block: ModelBlock, models: "Mapping[str, Scope]") -> "Scope":
        """Return the scope inside a subsystem, or inside a referenced model, which has its own names.

        The block may set model arguments; an empty one leaves the value of the model.
        """
        own = models.get(block.model)
        if own is None:
            return self.within(block)
        around = self.within(block)
        arguments = {name: text for name, text in _arguments(block) if text.strip()}
        variables = {
            name: MaskVariable(text, around, True, f"{block.path}:{name}", text) for name, text in arguments.items()
        }
        # arguments hide the variables of the referenced model that have their names
        return Scope(own.variables, {**variables}, own) if variables else own

    def shown(self) -> dict[str, str]:
        """Collect the dialog values of the enclosing masks by parameter name; inner ones take precedence."""
        values: dict[str, str] = {}
        here: Scope | None = self
        while here is not None:
            dialog = {
                name: variable.written
                for name, variable in here.masked.items()
                if isinstance(variable, MaskVariable) and variable.field
            }
            values, here = {**dialog, **values}, here.outer
        return values

    def find(self, name: str) -> "MaskVariable | MaskCodeVariable | Variable | None":
        """Look up the meaning of a name, None if it is undefined."""
        here: Scope | None = self
        while here is not None:
            if name in here.masked:
                return here.masked[name]
            here = here.outer
        return self.variables.get(name)

    def part(self, path: Sequence[str]) -> Variable | None:
        """Look up the struct field that a calibration file sets by its full name, "Control.Gain"."""
        return self.variables.get(".".join(path)) if len(path) > 1 else None


def _arguments(block: ModelBlock) -> Iterator[tuple[str, str]]:
    """Yield the model arguments of a block with their expressions; in old files one text separated by commas."""
    names, values = (
        block.listed(key) or split_arguments(block.value(key) or "")
        for key in ("ParameterArgumentNames", "ParameterArgumentValues")
    )
    return zip(map(str.strip, names), values, strict=False)


def _run_mask_code(scope: Scope, code: str) -> Scope:
    """Return the scope after mask code: plain assignments stay expressions, one layer each.

    Variables assigned by other statements, and those that depend on them, are taken from running all of the code.
    """
    script, _ = parse_leniently(code)
    inside, computed = scope, set[str]()
    for statement in script.statements:
        name = _assigned_name(statement)
        # `computed` holds names that only running the code gives, and spreads to what is computed from them
        if name and isinstance(statement, m.Assign) and computed.isdisjoint({name, *names_read(statement.value)}):
            # a layer per statement: `K = 2*K` reads the K of the layer outside
            inside = Scope(scope.variables, {name: MaskVariable(format_expression(statement.value), inside)}, inside)
        else:
            computed |= names_assigned(statement)
    return (
        Scope(scope.variables, {name: MaskCodeVariable(name, code, scope) for name in computed}, inside)
        if computed
        else inside
    )


def _assigned_name(statement: m.Statement) -> str:
    """Return the name that a statement assigns as a whole, "" for other statements."""
    targets = statement.targets if isinstance(statement, m.Assign) else ()
    return targets[0].name if len(targets) == 1 and isinstance(targets[0], m.Name) else ""


def names_assigned_by_script(code: str) -> frozenset[str]:
    """Collect the variables that a script assigns."""
    script, _ = parse_leniently(code)
    return names_assigned(script.statements)


def names_assigned_by_functions(code: str) -> frozenset[str]:
    """Collect the variables that the functions in a code assign."""
    script, _ = parse_leniently(code)
    return names_assigned(script.functions)


def to_parameter_value(value: Any) -> ParameterValue | None:
    """Convert a value to an array of float64 of at least one dimension, text, struct or tuple, None if unsupported.

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
        # lists of texts or of different lengths, which numpy refuses, are cell arrays
        if not isinstance(value, tuple | list):
            return None
        elements = [to_parameter_value(element) for element in value]
        known = tuple(element for element in elements if element is not None)
        return known if len(known) == len(elements) else None
    return np.atleast_1d(array) if array is not None else None


def declared_store(variable: Variable | None) -> dict[str, str] | None:
    """Read initial value and dimensions of a data store that a Simulink.Signal declares, None for any other value."""
    fields = variable.value if variable is not None else None
    if not isinstance(fields, Mapping) or "InitialValue" not in fields:
        return None
    texts = {name: _field_text(fields.get(name)) for name in ("InitialValue", "Dimensions")}
    return {name: text for name, text in texts.items() if text.strip() not in ("", "[]")}


def signal_unit(variable: Variable | None) -> str:
    """Return the unit of the signal that a Simulink.Signal describes, "" for any other value."""
    fields = variable.value if variable is not None else None
    if variable is None or not isinstance(fields, Mapping) or "InitialValue" not in fields:
        return ""
    stated = (variable.unit, fields.get("Unit"), fields.get("DocUnits"))  # older releases store it as DocUnits
    return next((unit for unit in stated if isinstance(unit, str) and unit.strip()), "").strip()


def _field_text(value: ParameterValue | None) -> str:
    """Return a value as a block field."""
    if isinstance(value, str):
        return value
    if not isinstance(value, np.ndarray):
        return ""
    return f"[{'; '.join(' '.join(map(repr, row)) for row in np.atleast_2d(value).tolist())}]"


def nested_field(value: ParameterValue, path: list[str]) -> ParameterValue:
    """Look up the struct field at the end of a path, as of `element_path`; raises `EvaluationError`."""
    for at, written in enumerate(path):
        name, index = split_index(written)
        if at:
            if not isinstance(value, Mapping) or name not in value:
                raise EvaluationError(f"{'.'.join(path[:at])} has no field {name}", ".".join(path))
            value = value[name]
        if index and isinstance(value, tuple):
            if index > len(value):
                message = f"index {index} of {'.'.join([*path[:at], name])} exceeds its size {len(value)}"
                raise EvaluationError(message, ".".join(path))
            value = value[index - 1]
        elif index > 1:
            raise EvaluationError(f"index {index} of {'.'.join([*path[:at], name])} exceeds its size 1", ".".join(path))
    return value


def passes_array(value: ParameterValue, path: Sequence[str]) -> bool:
    """Return True if a path names a field of an array of structs as a whole, of which each element has one."""
    for at, written in enumerate(path):
        name, index = split_index(written)
        if at:
            if not isinstance(value, Mapping) or name not in value:
                return False
            value = value[name]
        if isinstance(value, StructArray) and not index:
            return at + 1 < len(path)
        if index and isinstance(value, tuple):
            if index > len(value):
                return False
            value = value[index - 1]
    return False


def canonical_path(value: ParameterValue, path: Sequence[str]) -> list[str]:
    """Return a path in which single structs have no index, so that a parameter has one name: `p(1).a` is `p.a`."""
    result: list[str] = []
    for written in path:
        name, index = split_index(written)
        is_single = index == 1 and not isinstance(nested_field(value, [*result, name]), tuple)
        result.append(name if is_single else written)
    return result


def split_index(written: str) -> tuple[str, int]:
    """Return name and index of a part of a path; 0 if it has no index.

    >>> split_index("gain(2)"), split_index("gain")
    (('gain', 2), ('gain', 0))
    """
    match = _ELEMENT.fullmatch(written)
    return (match[1], int(match[2])) if match else (written, 0)


class VariableTable(dict[str, Variable]):
    """Variables by name, with findings of their sources.

    `undefined` says where scripts could not assign a variable, `missing_files` are absent data files with the
    scripts or models that need them, `solvers` are configurations by name, `strangers` parameters of calibration files
    unknown to the model.
    """

    def __init__(self) -> None:
        super().__init__()
        self.findings: list[Finding] = []
        self.undefined: dict[str, Location] = {}
        self.missing_files: dict[str, str] = {}
        self.solvers: dict[str, StoredSolver] = {}
        self.strangers = ParameterSet()


def equal_values(value: ParameterValue, other: ParameterValue) -> bool:
    """Return True if two values are equal."""
    if isinstance(value, np.ndarray) or isinstance(other, np.ndarray):
        if not (isinstance(value, np.ndarray) and isinstance(other, np.ndarray)):
            return False
        # 3, [3] and [[3]] are the same value in MATLAB
        return np.array_equal(np.atleast_2d(value), np.atleast_2d(other), equal_nan=True)
    if isinstance(value, Mapping) and isinstance(other, Mapping):
        return value.keys() == other.keys() and all(equal_values(value[key], other[key]) for key in value)
    if isinstance(value, tuple) and isinstance(other, tuple):
        shapes = [part.shape if isinstance(part, StructArray) else () for part in (value, other)]
        return shapes[0] == shapes[1] and len(value) == len(other) and all(map(equal_values, value, other))
    return type(value) is type(other) and value == other
