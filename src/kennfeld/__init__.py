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
    from kennfeld.dataset import Channel, Dataset, Settling
    from kennfeld.errors import InputError, InputWarning, KennfeldError
    from kennfeld.expansion import Expansion
    from kennfeld.graph import Graph
    from kennfeld.measurement import read
    from kennfeld.models import Model
    from kennfeld.models.formula import formula
    from kennfeld.models.simulink.importing import simulink
    from kennfeld.optimize import Criterion, Limit, Options, Pin, Region, Result, Step, Stop, calibrate, simulate
    from kennfeld.parameters import Axis, Block, Cube, Curve, Map, ParameterSet, Scalar, Text
    from kennfeld.project import Project
    from kennfeld.rbf import RBF

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

_ROOMS = {
    "analysis": ("cross_validate",),
    "calfiles": ("read_parameters",),
    "dataset": ("Channel", "Dataset", "Settling"),
    "errors": ("InputError", "InputWarning", "KennfeldError"),
    "expansion": ("Expansion",),
    "graph": ("Graph",),
    "measurement": ("read",),
    "models": ("Model",),
    "models.formula": ("formula",),
    "models.simulink.importing": ("simulink",),
    "optimize": ("Criterion", "Limit", "Options", "Pin", "Region", "Result", "Step", "Stop", "calibrate", "simulate"),
    "parameters": ("Axis", "Block", "Cube", "Curve", "Map", "ParameterSet", "Scalar", "Text"),
    "project": ("Project",),
    "rbf": ("RBF",),
}
_ROOM_OF = {name: room for room, names in _ROOMS.items() for name in names}
_NAME_INSIDE = {"read_parameters": "read"}


def __getattr__(name: str) -> "Any":
    if name not in _ROOM_OF:
        from kennfeld.errors import nearest

        raise AttributeError(f"module 'kennfeld' has no attribute {name!r}. {nearest(name, __all__)}".strip())
    found = getattr(import_module(f"kennfeld.{_ROOM_OF[name]}"), _NAME_INSIDE.get(name, name))
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
