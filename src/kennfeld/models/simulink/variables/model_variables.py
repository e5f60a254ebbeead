"""What a model says of itself: the settings of its solver, and the names under which a mask asks for them.

The variables of a model: from its dictionary, from files and values given, from its own workspace.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from kennfeld.errors import Finding, InputError
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

__all__ = ["ParameterSource", "collect_variables", "model_properties", "settings_of"]

ParameterSource: TypeAlias = "str | Path | Mapping[str, object] | ParameterSet"

_CALLBACKS = ("PreLoadFcn", "PostLoadFcn", "InitFcn")

_NAMES: Final = ("bdroot", "gcs", "gcb")


def collect_variables(document: ModelDocument, given: Iterable[ParameterSource]) -> VariableTable:
    """The variables that a model's expressions may use.

    Enumerations that blocks name and whose class files lie beside the model come first, then data dictionaries, then
    the code of the model's callbacks, then what is given in its order, then the workspace of the model, which hides
    them; values of calibration files and parameter sets go over all. Findings tell what could not be read.
    """
    found = VariableTable()
    _beside(found, document)
    over: list[ParameterSet] = []
    _callbacks(found, document)
    for one in given:
        if isinstance(one, ParameterSet):
            over.append(one)
        elif isinstance(one, Mapping):
            found.update({name: Variable(value, source=USER_SOURCE) for name, value in _plain(one).items()})
        else:
            over += _file(found, Path(one))
    by_name = {name: one for name, one in found.items() if one.source == USER_SOURCE}
    _workspace(found, document)
    found.findings += [
        _hidden(document, name) for name, one in by_name.items() if not equal_values(one.value, found[name].value)
    ]
    given_over = {parameter.name: parameter for values in over for parameter in values.values()}
    found.strangers = ParameterSet(one for name, one in given_over.items() if name.partition(".")[0] not in found)
    found.update({name: _with(found.get(name), parameter) for name, parameter in given_over.items()})
    return found


def _hidden(document: ModelDocument, name: str) -> Finding:
    message = "is given another value by the model workspace, which hides the one that is given"
    remedy = "Give it in a ParameterSet or a calibration file: those go over the workspace."
    return Finding(f"{document.name} {name}", message, remedy, severity="warning")


def _beside(found: VariableTable, document: ModelDocument) -> None:
    """Take the enumerations and the data dictionaries that lie beside a model; a path could name any other file."""
    folder = document.path.parent
    for name in document.enumerations:
        enumeration = enumeration_file(folder, name)
        found.update({name: enumeration} if enumeration is not None else {})
    for name in document.dictionaries:
        if Path(name).name == name:
            _dictionary(found, folder / name)
        else:
            place = f"{document.name} {name[:80]}"
            found.findings.append(Finding(place, "the data dictionary is not beside the model"))


def _plain(given: Mapping[str, object]) -> dict[str, ParameterValue]:
    """Values that are given by name; raises `InputError` with each that is of no use."""
    values = {name: to_parameter_value(value) for name, value in given.items()}
    wrong = [name for name, value in values.items() if value is None]
    if wrong:
        remedy = "Give numbers, texts, lists or dictionaries of them; parameters in a ParameterSet."
        raise InputError([Finding("parameters", f"{name}={given[name]!r:.60} is no value", remedy) for name in wrong])
    return {name: value for name, value in values.items() if value is not None}


def _file(found: VariableTable, path: Path) -> list[ParameterSet]:
    """Take the variables of a file; a calibration file's values are returned."""
    ending = path.suffix.casefold()
    if ending == ".sldd":
        read_file(path)  # one that is not there is a mistake here, but not where a model names it
        _entries(found, path)
    elif ending == ".mat":
        _add(found, mat_variables(read_file(path)), path.name)
    elif ending == ".m":
        run_parameter_script(found, path)
    else:
        from kennfeld.calfiles import read

        return [read(path)]
    return []


def _dictionary(found: VariableTable, path: Path) -> None:
    """Take the variables of the model's own dictionary; what is wrong with it is a finding."""
    try:
        _entries(found, path)
    except InputError as error:
        found.findings += error.findings


def _entries(found: VariableTable, path: Path) -> None:
    read = read_dictionary(path)
    _add(found, read.data, path.name)
    found.solvers.update(read.solvers)
    found.update({name: variable_of(members, path.name) for name, members in read.enumerations.items()})


def _callbacks(found: VariableTable, document: ModelDocument) -> None:
    for name in _CALLBACKS:
        if name in document.callbacks:
            run_text(found, document.callbacks[name], f"{document.name} {name}", document.path.parent)


def _workspace(found: VariableTable, document: ModelDocument) -> None:
    kind = document.workspace.kind
    if kind == "m-code":
        before = dict(found)
        run_text(found, document.workspace.text, "model workspace", document.path.parent)
        found.update({name: before[name] for name in before.keys() - found.keys()})  # what it cannot say may be given
    elif kind == "file":
        path = document.path.parent / Path(document.workspace.text).name
        if path.is_file():
            _file(found, path)
        else:
            found.findings.append(Finding(document.name, f"its workspace is in {path.name}, which is not there"))
    else:
        _add(found, workspace_variables(document.workspace), "model workspace")


def _add(found: VariableTable, data: StoredVariables, source: str) -> None:
    for name, entry in data.entries.items():
        variable = _variable(entry, source)
        if variable is not None:
            found[name] = variable
    for name, why in data.unreadable.items():
        place = f"{source} {name}".strip()
        found.findings.append(Finding(place, why, severity="warning"))


def _variable(entry: StoredVariable, source: str) -> Variable | None:
    condition = entry.properties.get("Condition")
    if isinstance(condition, str) and entry.value is None:  # a Simulink.Variant
        return Variable({"Condition": condition}, source=source)
    value = _value(entry)
    if value is None:
        return None
    made = Variable(value, unit=entry.unit, description=entry.description, source=source)
    return made.limited(entry.minimum, entry.maximum)


def _value(stored: Stored) -> ParameterValue | None:
    if isinstance(stored, StoredVariable):
        if stored.breakpoints:
            parts = {f"Breakpoints{i + 1}": _value(one) for i, one in enumerate(stored.breakpoints)}
            parts = {"Table": _value(stored.value), **parts}
            return {name: part for name, part in parts.items() if part is not None}
        return _value(stored.value)
    if isinstance(stored, Mapping):
        parts = {name: _value(part) for name, part in stored.items()}
        return {name: part for name, part in parts.items() if part is not None}
    if isinstance(stored, tuple):
        several = tuple(_value(part) for part in stored)
        if len(several) == 1:
            return several[0]
        return tuple(part for part in several if part is not None)
    return to_parameter_value(stored) if stored is not None else None


def _with(known: Variable | None, parameter: Parameter) -> Variable:
    """A variable with the value of a parameter; what is known of it stays, where the parameter says nothing else."""
    unit = parameter.unit or (known.unit if known is not None else "")
    value, axes = np.asarray(parameter.values, dtype=np.float64), tuple(parameter.axes)
    if known is not None and isinstance(known.value, np.ndarray) and _extents(known.value) == _extents(value):
        value = value.reshape(known.value.shape)
    description = parameter.description or (known.description if known is not None else "")
    lower: float | Numbers = known.lower if known is not None else -np.inf
    upper: float | Numbers = known.upper if known is not None else np.inf
    if parameter.limited:
        lower, upper = (np.reshape(bound, value.shape) for bound in (parameter.lower, parameter.upper))
    return Variable(np.atleast_1d(value), lower, upper, unit, description, "a calibration file", axes)


def _extents(values: Numbers) -> list[int]:
    """The sizes along the dimensions that have more than one element: those of a row are those of a column."""
    return [size for size in values.shape if size != 1]


def settings_of(document: ModelDocument, variables: VariableTable) -> tuple[StoredSolver, str]:
    """The settings of the solver, those of the file or of the configuration that it refers to, and what is missing."""
    settings, seen = document.solver, set[str]()
    while settings.reference:
        name = settings.reference
        if name in seen or name not in variables.solvers:
            why = "leads back to itself" if name in seen else "was not found"
            return settings, f"the configuration {name[:60]} {why}: give the dictionary that holds it"
        seen.add(name)
        settings = variables.solvers[name]
    return settings, ""


def model_properties(document: ModelDocument, variables: VariableTable) -> dict[str, Variable]:
    """What `get_param` can ask of a model, under the names that stand for it: a struct of its settings as texts."""
    settings, _ = settings_of(document, variables)
    said = {"SolverName": settings.name, "Solver": settings.name, "FixedStep": settings.fixed_step}
    said |= {"StartTime": settings.start, "StopTime": settings.stop, "MaxStep": settings.max_step}
    value: dict[str, ParameterValue] = {"Name": document.name, **{key: text for key, text in said.items() if text}}
    return {name: Variable(value, source="the model itself", fixed=True) for name in _NAMES if name not in variables}
