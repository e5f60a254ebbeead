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
    from typing import Any

    from kennfeld.analysis import cross_validate
    from kennfeld.calfiles import read as read_parameters
    from kennfeld.constraints import Limit, Pin
    from kennfeld.criteria import Criterion, Region
    from kennfeld.dataset import Channel, Dataset, Settling
    from kennfeld.errors import InputError, InputWarning, KennfeldError
    from kennfeld.graph import Graph
    from kennfeld.measurement import read
    from kennfeld.models import Model
    from kennfeld.models.formula import formula
    from kennfeld.models.simulink.importing import simulink
    from kennfeld.optimize import Options, Result, Step, Stop, calibrate, simulate
    from kennfeld.parameter_set import ParameterSet
    from kennfeld.parameters import Axis, Block, Cube, Curve, Map, Scalar, Text
    from kennfeld.project import Project
    from kennfeld.rbf import RBF, Expansion

__all__ = [
    "RBF",
    "Axis",
    "Block",
    "Channel",
    "Criterion",
    "Cube",
    "Curve",
    "Dataset",
    "Expansion",
    "Graph",
    "InputError",
    "InputWarning",
    "KennfeldError",
    "Limit",
    "Map",
    "Model",
    "Options",
    "ParameterSet",
    "Pin",
    "Project",
    "Region",
    "Result",
    "Scalar",
    "Settling",
    "Step",
    "Stop",
    "Text",
    "calibrate",
    "cross_validate",
    "formula",
    "read",
    "read_parameters",
    "simulate",
    "simulink",
]

__version__ = "0.1.0"

_MODULES = {
    "analysis": ("cross_validate",),
    "calfiles": ("read_parameters",),
    "constraints": ("Limit", "Pin"),
    "criteria": ("Criterion", "Region"),
    "dataset": ("Channel", "Dataset", "Settling"),
    "errors": ("InputError", "InputWarning", "KennfeldError"),
    "graph": ("Graph",),
    "measurement": ("read",),
    "models": ("Model",),
    "models.formula": ("formula",),
    "models.simulink.importing": ("simulink",),
    "optimize": ("Options", "Result", "Step", "Stop", "calibrate", "simulate"),
    "parameter_set": ("ParameterSet",),
    "parameters": ("Axis", "Block", "Cube", "Curve", "Map", "Scalar", "Text"),
    "project": ("Project",),
    "rbf": ("RBF", "Expansion"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}
_NAME_THERE = {"read_parameters": "read"}


def __getattr__(name: str) -> "Any":
    if name not in _MODULE_OF:
        from kennfeld.formatting import nearest

        raise AttributeError(f"module 'kennfeld' has no attribute {name!r}. {nearest(name, __all__)}".strip())
    value = getattr(import_module(f"kennfeld.{_MODULE_OF[name]}"), _NAME_THERE.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
