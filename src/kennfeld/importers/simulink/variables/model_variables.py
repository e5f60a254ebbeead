"""Collection of a model's variables and solver settings from workspace, dictionaries, scripts and given values."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.output_paths import file_name
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.importers.simulink.reader.dialog_words import begins_with_word
from kennfeld.importers.simulink.reader.model_tree import ModelDocument, StoredSolver
from kennfeld.importers.simulink.variables.data_dictionary import find_beside
from kennfeld.importers.simulink.variables.datasets import is_timeseries, timeseries_points
from kennfeld.importers.simulink.variables.enumerations import enumerated_type, enumeration_variable, members_of
from kennfeld.importers.simulink.variables.file_search import FileSearch, read_file
from kennfeld.importers.simulink.variables.m_files import run_parameter_script, run_text
from kennfeld.importers.simulink.variables.mask_scope import (
    USER_SOURCE,
    ParameterValue,
    Variable,
    VariableTable,
    equal_values,
    names_assigned_by_script,
    to_parameter_value,
)
from kennfeld.importers.simulink.variables.stored_variables import (
    ENUMERATED,
    StoredVariable,
    StoredVariables,
    UnusableValueError,
    mat_variables,
    workspace_variables,
)
from kennfeld.importers.simulink.variables.stored_variables import Value as Stored
from kennfeld.matlab.simulink_types import BUS_ELEMENT, TYPE_CLASSES
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.imperative.node_arrays import Numbers

ParameterSource: TypeAlias = "str | Path | Mapping[str, object] | ParameterSet"

_CALLBACKS = ("PreLoadFcn", "PostLoadFcn", "InitFcn")

_NAMES: Final = ("bdroot", "gcs", "gcb")


def collect_variables(
    document: ModelDocument, sources: Iterable[ParameterSource], search: FileSearch | None = None
) -> VariableTable:
    """Collect the variables that a model's expressions may use.

    In increasing precedence: enumerations whose class files are next to the model, data dictionaries, callback code,
    `sources` in order, the model workspace, and values of calibration files and parameter sets. The findings list what
    could not be read.
    """
    sources = tuple(sources)
    search = search or FileSearch(given=tuple(Path(source) for source in sources if isinstance(source, str | Path)))
    variables = VariableTable()
    _add_adjacent_files(variables, document, search)
    parameter_sets: list[ParameterSet] = []
    load = search.loader(document.path.parent)
    for name in _CALLBACKS:
        if name in document.callbacks:
            run_text(variables, document.callbacks[name], f"{document.name} {name}", load)
    for source in sources:
        if isinstance(source, ParameterSet):
            parameter_sets.append(source)
        elif isinstance(source, Mapping):
            for name, value in _values_by_name(source).items():
                variables[name] = Variable(value, source=USER_SOURCE)
        else:
            parameter_sets += _add_file(variables, Path(source), document, search)
    # taken before the workspace is read, which may override them
    by_name = {name: variable for name, variable in variables.items() if variable.source == USER_SOURCE}
    _workspace(variables, document, search)
    variables.findings += [
        _hidden(document, name)
        for name, variable in by_name.items()
        if not equal_values(variable.value, variables[name].value)
    ]
    overriding = {parameter.name: parameter for values in parameter_sets for parameter in values.values()}
    # `Control.Gain` may be a field of the struct `Control`
    variables.strangers = ParameterSet(
        parameter for name, parameter in overriding.items() if name.partition(".")[0] not in variables
    )
    # last, so that they override the workspace as well
    variables.update({name: _with_parameter(variables.get(name), parameter) for name, parameter in overriding.items()})
    return variables


def _hidden(document: ModelDocument, name: str) -> Finding:
    message = "is also defined in the model workspace, which overrides the given value"
    remedy = "Give it in a ParameterSet or a calibration file: these override the workspace."
    return Finding(Location(document.name, path=name), message, remedy, severity="warning")


def _add_adjacent_files(variables: VariableTable, document: ModelDocument, search: FileSearch) -> None:
    """Add enumerations and data dictionaries next to a model; folders in the names of dictionaries are ignored."""
    folders = (document.path.parent, *search.folders)
    enumerations = search.enumerations(document.path.parent)
    variables.update(enumerations)
    variables.findings += [
        Finding(Location(variable.source, path=name), variable.description, severity="remark")
        for name, variable in enumerations.items()
        if variable.description
    ]
    for name in document.dictionaries:
        if file_name(name) in search.given_names:
            continue
        path = find_beside(name, folders)
        if path is None:
            message = "the data dictionary was not found next to the model"
            remedy = "Give it as parameters, or its folder as folders."
            variables.findings.append(Finding(Location(document.name, path=name[:80]), message, remedy))
            variables.missing_files[name[:80]] = document.path.name
            continue
        try:
            _entries(variables, path, search)
        except InputError as error:
            variables.findings += error.findings


def _values_by_name(values_by_name: Mapping[str, object]) -> dict[str, ParameterValue]:
    """Return values given by name; raise `InputError` for all unsupported ones."""
    values = {name: to_parameter_value(value) for name, value in values_by_name.items()}
    wrong = [name for name, value in values.items() if value is None]
    if wrong:
        remedy = "Use numbers, texts, lists or dictionaries of them, or Parameters in a ParameterSet."
        messages = [f"{name}={values_by_name[name]!r:.60} is not a supported value" for name in wrong]
        raise InputError(Finding(Location("parameters"), message, remedy) for message in messages)
    return {name: value for name, value in values.items() if value is not None}


def _add_file(variables: VariableTable, path: Path, document: ModelDocument, search: FileSearch) -> list[ParameterSet]:
    """Add the variables of a file; parameter sets of a calibration file are returned."""
    ending = path.suffix.casefold()
    if ending == ".sldd":
        read_file(path)  # a missing file is an error here, but not if a model names it
        _entries(variables, path, search)
    elif ending == ".mat":
        _add(variables, mat_variables(read_file(path)), path.name)
    elif ending == ".m":
        run_parameter_script(variables, path, search.loader(path.parent, document.path.parent))
    else:
        from kennfeld.calfiles import read_with_findings

        parameters, findings = read_with_findings(path)
        variables.findings += findings
        return [parameters]
    return []


def _entries(variables: VariableTable, path: Path, search: FileSearch) -> None:
    read = search.dictionary(path)
    # before the entries, whose enumerated values are members of these
    variables.update({name: enumeration_variable(members, path.name) for name, members in read.enumerations.items()})
    _add(variables, read.definitions, path.name)
    _add(variables, read.data, path.name)
    variables.solvers.update(read.solvers)
    for name in read.data.unreadable:
        if name.endswith(".sldd") and not (path.parent / file_name(name)).is_file():
            variables.missing_files[name[:80]] = path.name


def _workspace(variables: VariableTable, document: ModelDocument, search: FileSearch) -> None:
    """Add the variables of the model workspace, which are local to the model."""
    before = dict(variables)
    code = _add_workspace(variables, document, search)
    new = {name for name, variable in variables.items() if before.get(name) is not variable}
    # code that assigns a value which a variable has leaves the variable as it is
    for name in new | (names_assigned_by_script(code) & variables.keys()):
        variables[name] = replace(variables[name], local=True)


def _add_workspace(variables: VariableTable, document: ModelDocument, search: FileSearch) -> str:
    """Add the variables of the model workspace; return its code, if it is code."""
    kind = document.workspace.kind
    if kind == "m-code":
        before = dict(variables)
        run_text(variables, document.workspace.text, "model workspace", search.loader(document.path.parent))
        for name in before.keys() - variables.keys():  # the user may give what is missing
            variables[name] = before[name]
        return document.workspace.text
    if kind == "file":
        # next to the model, whatever folder the file names
        path = document.path.parent / Path(document.workspace.text).name
        if path.is_file():
            _add_file(variables, path, document, search)
            return read_file(path).decode("utf-8", "replace") if path.suffix.casefold() == ".m" else ""
        message = f"its workspace is in {path.name}, which was not found"
        variables.findings.append(Finding(Location(document.name), message))
    else:
        _add(variables, workspace_variables(document.workspace), "model workspace")
    return ""


def _add(variables: VariableTable, data: StoredVariables, source: str) -> None:
    unreadable = dict(data.unreadable)
    for name, entry in data.entries.items():
        try:
            variable = _variable(entry, source, variables)
        except UnusableValueError as error:
            unreadable[name] = str(error)
            continue
        if variable is not None:
            variables[name] = variable
    for name, reason in unreadable.items():
        variables.findings.append(Finding(Location(source, path=name), reason, severity="warning"))


def _variable(entry: StoredVariable, source: str, known: Mapping[str, Variable]) -> Variable | None:
    condition = entry.properties.get("Condition")
    if isinstance(condition, str) and entry.value is None:  # a Simulink.Variant
        return Variable({"Condition": condition}, source=source)
    if entry.kind in TYPE_CLASSES:
        properties = _value(entry, known)
        return Variable(properties if properties is not None else {}, source=source, kind=entry.kind)
    if is_timeseries(entry):
        times, values = _timeseries(entry)
        # as a structure with time, which a From Workspace block takes as well
        return Variable({"time": times, "signals": {"values": values}}, source=source)
    value = _value(entry, known)
    if value is None and entry.kind.rpartition(".")[2] == "Signal":  # it may declare a data store
        parts = {"InitialValue": "", **entry.properties}
        value = {name: part for name in parts if (part := _value(parts[name], known)) is not None}
    if value is None:
        return None
    fixed = _is_enumerated(entry) or _is_enumerated(entry.value)
    single = "single" in (entry.kind, entry.type)
    variable = Variable(
        value, unit=entry.unit, description=entry.description, source=source, fixed=fixed, single=single
    )
    return variable.limited(entry.minimum, entry.maximum)


def _timeseries(entry: StoredVariable) -> tuple[Numbers, Numbers]:
    try:
        return timeseries_points(entry)
    except EvaluationError as error:
        raise UnusableValueError(str(error)) from None


def _is_enumerated(stored: Stored) -> bool:
    return isinstance(stored, StoredVariable) and begins_with_word(stored.type, ENUMERATED)


def _member_numbers(entry: StoredVariable, known: Mapping[str, Variable]) -> ParameterValue | None:
    """Return the numbers of enumerated values; raise `UnusableValueError` if a member is unknown."""
    names = entry.value if isinstance(entry.value, tuple) else (entry.value,)
    if not names or not all(isinstance(name, str) for name in names):
        return _value(entry.value, known)
    kind = enumerated_type(entry.type)
    members = members_of(known.get(kind))
    if not members:
        raise UnusableValueError(
            f"it is of the enumeration {kind[:60]}, which is not defined: place {kind[:60]}.m next to the model "
            "or give it as parameters"
        )
    if unknown := [name for name in names if name not in members]:
        raise UnusableValueError(f"its enumeration {kind[:60]} has no member {str(unknown[0])[:60]}")
    return np.array([[members[str(name)] for name in names]])


def _value(stored: Stored, known: Mapping[str, Variable]) -> ParameterValue | None:
    if isinstance(stored, StoredVariable):
        # first, since an element of a bus may have the type of an enumeration
        if stored.kind in TYPE_CLASSES or stored.kind == BUS_ELEMENT:
            return _value(stored.properties, known)
        if _is_enumerated(stored):
            return _member_numbers(stored, known)
        if not stored.breakpoints:
            return _value(stored.value, known)
        axes = {f"Breakpoints{number}": variable for number, variable in enumerate(stored.breakpoints, 1)}
        stored = {"Table": stored.value, **axes}
    if isinstance(stored, Mapping):
        parts = {name: _value(part, known) for name, part in stored.items()}
        return {name: part for name, part in parts.items() if part is not None}
    if isinstance(stored, tuple):
        values = tuple(_value(part, known) for part in stored)
        if len(values) == 1:
            return values[0]
        return tuple(part for part in values if part is not None)
    return to_parameter_value(stored) if stored is not None else None


def _with_parameter(known: Variable | None, parameter: Parameter) -> Variable:
    """Return a variable with the value of a parameter, keeping known information that the parameter lacks."""
    unit = parameter.unit or (known.unit if known is not None else "")
    value, axes = np.asarray(parameter.values, dtype=np.float64), tuple(parameter.axes)
    if known is not None and isinstance(known.value, np.ndarray) and _sizes(known.value) == _sizes(value):
        # a curve of a calibration file has one dimension, a variable of the model is a row or a column
        value = value.reshape(known.value.shape)
    description = parameter.description or (known.description if known is not None else "")
    lower: float | Numbers = known.lower if known is not None else -np.inf
    upper: float | Numbers = known.upper if known is not None else np.inf
    if parameter.limited:
        lower, upper = (np.reshape(bound, value.shape) for bound in (parameter.lower, parameter.upper))
    single = known is not None and known.single
    return Variable(np.atleast_1d(value), lower, upper, unit, description, "a calibration file", axes, single=single)


def _sizes(values: Numbers) -> list[int]:
    """Return the sizes along dimensions with more than one element, so that rows and columns compare equal."""
    return [size for size in values.shape if size != 1]


def solver_settings(document: ModelDocument, variables: VariableTable) -> tuple[StoredSolver, str]:
    """Look up the solver settings of the file or of its referenced configuration, and a sentence if that is missing."""
    settings, seen = document.solver, set[str]()
    while settings.reference:
        # a configuration may refer to another one, and by mistake in a circle
        name = settings.reference
        if name in seen or name not in variables.solvers:
            why = "refers to itself" if name in seen else "was not found"
            return settings, f"configuration {name[:60]} {why}: give its dictionary as parameters"
        seen.add(name)
        settings = variables.solvers[name]
    return settings, ""


def model_properties(document: ModelDocument, variables: VariableTable) -> dict[str, Variable]:
    """Collect the properties that `get_param` may query of a model, as structs of texts."""
    settings, _ = solver_settings(document, variables)
    texts = {"SolverName": settings.name, "Solver": settings.name, "FixedStep": settings.fixed_step}
    texts |= {"StartTime": settings.start, "StopTime": settings.stop, "MaxStep": settings.max_step}
    value: dict[str, ParameterValue] = {"Name": document.name, **{key: text for key, text in texts.items() if text}}
    return {name: Variable(value, source="the model itself", fixed=True) for name in _NAMES if name not in variables}
