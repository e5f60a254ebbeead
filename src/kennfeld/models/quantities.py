"""Inputs, outputs and parameters of an imported model, as reports of imports list them."""

import math

import numpy as np

from kennfeld.lazy_dataclass import dataclass
from kennfeld.parameters import Parameter


@dataclass(frozen=True)
class Quantity:
    """An input or output of the function, as a project names it."""

    name: str
    unit: str = ""


@dataclass(frozen=True)
class CalibratableParameter:
    """A parameter that can be calibrated: kind, shape, range of values, limits (None for none) and origin.

    A `locked` parameter keeps its values unless it is selected by name.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    smallest: float
    largest: float
    unit: str
    lower: float | None
    upper: float | None
    locked: bool
    source: str


def calibratable(parameter: Parameter, source: str = "") -> CalibratableParameter:
    """Return the summary of a parameter whose values are from `source`."""
    lower, upper = float(np.max(parameter.lower)), float(np.min(parameter.upper))
    return CalibratableParameter(
        parameter.name, parameter.kind, parameter.values.shape,
        float(np.min(parameter.values)), float(np.max(parameter.values)), parameter.unit,
        lower if math.isfinite(lower) else None, upper if math.isfinite(upper) else None,
        bool(np.all(parameter.locked)), source,
    )  # fmt: skip
