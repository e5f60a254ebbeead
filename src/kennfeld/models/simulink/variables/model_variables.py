"""Collection of a model's variables and solver settings from workspace, dictionaries, scripts and given values."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from kennfeld.errors import Finding, InputError, Location
from kennfeld.models.imperative.node_arrays import Numbers
from kennfeld.models.simulink.reader.model_tree import ModelDocument, StoredSolver
from kennfeld.models.simulink.variables.data_dictionary import read_dictionary
from kennfeld.models.simulink.variables.m_files import (
    enumeration_file,
    read_file,
    run_parameter_script,
    run_text,
    variable_of,
)
from kennfeld.models.simulink.variables.mask_scope import (
    USER_SOURCE,
    ParameterValue,
    Variable,
    VariableTable,
    equal_values,
    to_parameter_value,
)
from kennfeld.models.simulink.variables.stored_variables import (
    StoredVariable,
    StoredVariables,
    mat_variables,
    workspace_variables,
)
from kennfeld.models.simulink.variables.stored_variables import Value as Stored
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter

ParameterSource: TypeAlias = "str | Path | Mapping[str, object] | ParameterSet"

_CALLBACKS = ("PreLoadFcn", "PostLoadFcn", "InitFcn")

_NAMES: Final = ("bdroot", "gcs", "gcb")


def collect_variables(document: ModelDocument, sources: Iterable[ParameterSource]) -> VariableTable:
    """Collect the variables that a model's expressions may use.

    In increasing precedence: enumerations whose class files are next to the model, data dictionaries, callback code,
    `sources` in order, the model workspace, and values of calibration files and parameter sets. The findings list what
    could not be read.
    """
    variables = VariableTable()
    _add_adjacent_files(variables, document)
    parameter_sets: list[ParameterSet] = []
    for name in _CALLBACKS:
        if name in document.callbacks:
            run_text(variables, document.callbacks[name], f"{document.name} {name}", document.path.parent)
    for source in sources:
        if isinstance(source, ParameterSet):
            parameter_sets.append(source)
        elif isinstance(source, Mapping):
            for name, value in _values_by_name(source).items():
                variables[name] = Variable(value, source=USER_SOURCE)
        else:
            parameter_sets += _add_file(variables, Path(source))
    by_name = {name: variable for name, variable in variables.items() if variable.source == USER_SOURCE}
    _workspace(variables, document)
    variables.findings += [
        _hidden(document, name)
        for name, variable in by_name.items()
        if not equal_values(variable.value, variables[name].value)
    ]
    overriding = {parameter.name: parameter for values in parameter_sets for parameter in values.values()}
    variables.strangers = ParameterSet(
        parameter for name, parameter in overriding.items() if name.partition(".")[0] not in variables
    )
    variables.update({name: _with_parameter(variables.get(name), parameter) for name, parameter in overriding.items()})
    return variables


def _hidden(document: ModelDocument, name: str) -> Finding:
    message = "is also defined in the model workspace, which overrides the given value"
    remedy = "Give it in a ParameterSet or a calibration file: these override the workspace."
    return Finding(Location(document.name, path=name), message, remedy, severity="warning")


def _add_adjacent_files(variables: VariableTable, document: ModelDocument) -> None:
    """Add enumerations and data dictionaries next to a model; only names without folders are followed."""
    folder = document.path.parent
    for name in document.enumerations:
        if (enumeration := enumeration_file(folder, name)) is not None:
            variables[name] = enumeration
    for name in document.dictionaries:
        if Path(name).name == name:
            try:
                _entries(variables, folder / name)
            except InputError as error:
                variables.findings += error.findings
        else:
            location = Location(document.name, path=name[:80])
            variables.findings.append(Finding(location, "the data dictionary was not found next to the model"))


def _values_by_name(values_by_name: Mapping[str, object]) -> dict[str, ParameterValue]:
    """Return values given by name; raise `InputError` for all unsupported ones."""
    values = {name: to_parameter_value(value) for name, value in values_by_name.items()}
    wrong = [name for name, value in values.items() if value is None]
    if wrong:
        remedy = "Use numbers, texts, lists or dictionaries of them, or Parameters in a ParameterSet."
        messages = [f"{name}={values_by_name[name]!r:.60} is not a supported value" for name in wrong]
        raise InputError(Finding(Location("parameters"), message, remedy) for message in messages)
    return {name: value for name, value in values.items() if value is not None}


def _add_file(variables: VariableTable, path: Path) -> list[ParameterSet]:
    """Add the variables of a file; parameter sets of a calibration file are returned."""
    ending = path.suffix.casefold()
    if ending == ".sldd":
        read_file(path)  # a missing file is an error here, but not if a model names it
        _entries(variables, path)
    elif ending == ".mat":
        _add(variables, mat_variables(read_file(path)), path.name)
    elif ending == ".m":
        run_parameter_script(variables, path)
    else:
        from kennfeld.calfiles import read

        return [read(path)]
    return []


def _entries(variables: VariableTable, path: Path) -> None:
    read = read_dictionary(path)
    _add(variables, read.data, path.name)
    variables.solvers.update(read.solvers)
    variables.update({name: variable_of(members, path.name) for name, members in read.enumerations.items()})


def _workspace(variables: VariableTable, document: ModelDocument) -> None:
    kind = document.workspace.kind
    if kind == "m-code":
        before = dict(variables)
        run_text(variables, document.workspace.text, "model workspace", document.path.parent)
        for name in before.keys() - variables.keys():  # the user may give what is missing
            variables[name] = before[name]
    elif kind == "file":
        path = document.path.parent / Path(document.workspace.text).name
        if path.is_file():
            _add_file(variables, path)
        else:
            message = f"its workspace is in {path.name}, which was not found"
            variables.findings.append(Finding(Location(document.name), message))
    else:
        _add(variables, workspace_variables(document.workspace), "model workspace")


def _add(variables: VariableTable, data: StoredVariables, source: str) -> None:
    for name, entry in data.entries.items():
        variable = _variable(entry, source)
        if variable is not None:
            variables[name] = variable
    for name, why in data.unreadable.items():
        variables.findings.append(Finding(Location(source, path=name), why, severity="warning"))


def _variable(entry: StoredVariable, source: str) -> Variable | None:
    condition = entry.properties.get("Condition")
    if isinstance(condition, str) and entry.value is None:  # a Simulink.Variant
        return Variable({"Condition": condition}, source=source)
    value = _value(entry)
    if value is None:
        return None
    variable = Variable(value, unit=entry.unit, description=entry.description, source=source)
    return variable.limited(entry.minimum, entry.maximum)


def _value(stored: Stored) -> ParameterValue | None:
    if isinstance(stored, StoredVariable):
        if not stored.breakpoints:
            return _value(stored.value)
        axes = {f"Breakpoints{number}": variable for number, variable in enumerate(stored.breakpoints, 1)}
        stored = {"Table": stored.value, **axes}
    if isinstance(stored, Mapping):
        parts = {name: _value(part) for name, part in stored.items()}
        return {name: part for name, part in parts.items() if part is not None}
    if isinstance(stored, tuple):
        values = tuple(_value(part) for part in stored)
        if len(values) == 1:
            return values[0]
        return tuple(part for part in values if part is not None)
    return to_parameter_value(stored) if stored is not None else None


def _with_parameter(known: Variable | None, parameter: Parameter) -> Variable:
    """Return a variable with the value of a parameter, keeping known information that the parameter lacks."""
    unit = parameter.unit or (known.unit if known is not None else "")
    value, axes = np.asarray(parameter.values, dtype=np.float64), tuple(parameter.axes)
    if known is not None and isinstance(known.value, np.ndarray) and _sizes(known.value) == _sizes(value):
        value = value.reshape(known.value.shape)
    description = parameter.description or (known.description if known is not None else "")
    lower: float | Numbers = known.lower if known is not None else -np.inf
    upper: float | Numbers = known.upper if known is not None else np.inf
    if parameter.limited:
        lower, upper = (np.reshape(bound, value.shape) for bound in (parameter.lower, parameter.upper))
    return Variable(np.atleast_1d(value), lower, upper, unit, description, "a calibration file", axes)


def _sizes(values: Numbers) -> list[int]:
    """Return the sizes along dimensions with more than one element, so that rows and columns compare equal."""
    return [size for size in values.shape if size != 1]


def solver_settings(document: ModelDocument, variables: VariableTable) -> tuple[StoredSolver, str]:
    """Return the solver settings of the file or of its referenced configuration, and a sentence if that is missing."""
    settings, seen = document.solver, set[str]()
    while settings.reference:
        name = settings.reference
        if name in seen or name not in variables.solvers:
            why = "refers to itself" if name in seen else "was not found"
            return settings, f"configuration {name[:60]} {why}: give its dictionary as parameters"
        seen.add(name)
        settings = variables.solvers[name]
    return settings, ""


def model_properties(document: ModelDocument, variables: VariableTable) -> dict[str, Variable]:
    """Return the properties that `get_param` may query of a model, as structs of texts."""
    settings, _ = solver_settings(document, variables)
    said = {"SolverName": settings.name, "Solver": settings.name, "FixedStep": settings.fixed_step}
    said |= {"StartTime": settings.start, "StopTime": settings.stop, "MaxStep": settings.max_step}
    value: dict[str, ParameterValue] = {"Name": document.name, **{key: text for key, text in said.items() if text}}
    return {name: Variable(value, source="the model itself", fixed=True) for name in _NAMES if name not in variables}
