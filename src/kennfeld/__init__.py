"""Kennfeld calibrates physics-based sensor models of engine control units.

Every public name is loaded when it is first used, so that `import kennfeld` costs nothing.

>>> import kennfeld as kf
>>> result = kf.calibrate("y = a + b * x", {"x": [0, 1, 2], "target": [1, 3, 5]}, {"a": 0, "b": 0}, target="target")
>>> round(result.parameters["b"].value, 6)
2.0
"""

from importlib import import_module

TYPE_CHECKING = False  # type checkers take this name for true; the module `typing` would cost 10 ms
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from kennfeld import report
    from kennfeld.analysis.cross_validation import cross_validate
    from kennfeld.analysis.extrapolation import find_extrapolation
    from kennfeld.analysis.missing.proposal import TermProposal, TermProposals
    from kennfeld.analysis.missing.proposing import propose
    from kennfeld.analysis.residuals import residuals
    from kennfeld.analysis.validation_result import CrossValidation
    from kennfeld.base.errors import ArgumentError, Finding, InputError, InputWarning, KennfeldError
    from kennfeld.calfiles import read as read_parameters
    from kennfeld.design import design
    from kennfeld.domain.axis import Axis
    from kennfeld.domain.constraints import Equality, Limit, Pin, Shape, Term
    from kennfeld.domain.criteria import Criterion, Region, Target
    from kennfeld.domain.dataset import Channel, Dataset, Settling
    from kennfeld.domain.parameter_set import ParameterSet
    from kennfeld.domain.parameters import Block, Cube, Curve, Map, Parameter, Scalar
    from kennfeld.domain.rbf import RBF, Expansion
    from kennfeld.domain.texts import Text
    from kennfeld.export.api import Export, export_function
    from kennfeld.graph import Graph
    from kennfeld.importers.ascet.importing import esdl, import_esdl
    from kennfeld.importers.fmu.importing import fmu
    from kennfeld.importers.onnx.importing import onnx
    from kennfeld.importers.python.importing import function
    from kennfeld.importers.simulink.importable_subsystems import inspect_simulink
    from kennfeld.importers.simulink.importing import import_simulink, simulink
    from kennfeld.measurement import read
    from kennfeld.models import Model
    from kennfeld.models.formula import formula
    from kennfeld.optimize import (
        Options,
        Problem,
        Quality,
        RecordingQuality,
        Result,
        Step,
        Stop,
        TraceLine,
        Trust,
        calibrate,
        simulate,
    )
    from kennfeld.optimize.api import problem
    from kennfeld.project import Project
    from kennfeld.surrogate import DynamicSurrogate, FilteredSurrogate, StaticSurrogate, read_surrogate, write_surrogate
    from kennfeld.surrogate.rbf_fit import compress_map
    from kennfeld.surrogate.training import SurrogateSettings, train_surrogate

__all__ = [
    "RBF",
    "ArgumentError",
    "Axis",
    "Block",
    "Channel",
    "Criterion",
    "CrossValidation",
    "Cube",
    "Curve",
    "Dataset",
    "DynamicSurrogate",
    "Equality",
    "Expansion",
    "Export",
    "FilteredSurrogate",
    "Finding",
    "Graph",
    "InputError",
    "InputWarning",
    "KennfeldError",
    "Limit",
    "Map",
    "Model",
    "Options",
    "Parameter",
    "ParameterSet",
    "Pin",
    "Problem",
    "Project",
    "Quality",
    "RecordingQuality",
    "Region",
    "Result",
    "Scalar",
    "Settling",
    "Shape",
    "StaticSurrogate",
    "Step",
    "Stop",
    "SurrogateSettings",
    "Target",
    "Term",
    "TermProposal",
    "TermProposals",
    "Text",
    "TraceLine",
    "Trust",
    "calibrate",
    "compress_map",
    "cross_validate",
    "design",
    "esdl",
    "export_function",
    "find_extrapolation",
    "fmu",
    "formula",
    "function",
    "import_esdl",
    "import_simulink",
    "inspect_simulink",
    "onnx",
    "problem",
    "propose",
    "read",
    "read_parameters",
    "read_surrogate",
    "report",
    "residuals",
    "simulate",
    "simulink",
    "train_surrogate",
    "write_surrogate",
]

__version__ = "0.3.0"

_NAMES = {
    "analysis.cross_validation": "cross_validate",
    "analysis.extrapolation": "find_extrapolation",
    "analysis.missing.proposal": "TermProposal TermProposals",
    "analysis.missing.proposing": "propose",
    "analysis.residuals": "residuals",
    "analysis.validation_result": "CrossValidation",
    "calfiles": "read_parameters",
    "design.api": "design",
    "domain.axis": "Axis",
    "domain.constraints": "Equality Limit Pin Shape Term",
    "domain.criteria": "Criterion Region Target",
    "domain.dataset": "Channel Dataset Settling",
    "export.api": "Export export_function",
    "base.errors": "ArgumentError Finding InputError InputWarning KennfeldError",
    "graph": "Graph",
    "measurement": "read",
    "models": "Model",
    "importers.ascet.importing": "esdl import_esdl",
    "importers.fmu.importing": "fmu",
    "models.formula": "formula",
    "importers.onnx.importing": "onnx",
    "importers.python.importing": "function",
    "importers.simulink.importable_subsystems": "inspect_simulink",
    "importers.simulink.importing": "import_simulink simulink",
    "optimize": "Options Problem Quality RecordingQuality Result Step Stop TraceLine Trust calibrate simulate",
    "optimize.api": "problem",
    "domain.parameter_set": "ParameterSet",
    "domain.parameters": "Block Cube Curve Map Parameter Scalar",
    "project": "Project",
    "domain.rbf": "RBF Expansion",
    "domain.texts": "Text",
    "surrogate": "DynamicSurrogate FilteredSurrogate StaticSurrogate read_surrogate write_surrogate",
    "surrogate.rbf_fit": "compress_map",
    "surrogate.training": "SurrogateSettings train_surrogate",
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names.split()}
_NAME_THERE = {"read_parameters": "read"}


def __getattr__(name: str) -> "Any":
    if name == "report":  # a package, for `report.document`
        return import_module("kennfeld.report")
    if name.startswith("_"):  # tools ask for dozens of these: no search for similar names
        raise AttributeError(f"module 'kennfeld' has no attribute {name!r}")
    if name not in _MODULE_OF:
        from kennfeld.base.formatting import nearest

        raise AttributeError(f"module 'kennfeld' has no attribute {name!r}. {nearest(name, __all__)}".strip())
    value = getattr(_module_of(name), _NAME_THERE.get(name, name))
    globals()[name] = value
    return value


def _module_of(name: str) -> "ModuleType":
    module = f"kennfeld.{_MODULE_OF[name]}"
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        guest = ".".join(module.split(".")[:3])
        if not module.startswith("kennfeld.importers.") or error.name not in ("kennfeld.importers", guest):
            raise
        raise AttributeError(f"kennfeld.{name} needs the importer {guest}, which is not installed") from None


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
