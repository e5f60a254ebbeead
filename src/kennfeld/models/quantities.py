"""Inputs, outputs and parameters of an imported model, as reports of imports list them."""

import math

import numpy as np

from kennfeld.base.formatting import quoted, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameters import Parameter

PARAMETER_KINDS = ("scalar", "curve", "map", "cube", "cube")  # by number of axes; more are those of an expansion
_MAX_WRITTEN = 200  # values of a table that are written one by one


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


@dataclass(frozen=True)
class UndefinedParameter:
    """A parameter without a value: its shape (() for a scalar, None if unknown), the fields that use it, and why.

    `fields` are "Path:Field", or paths of blocks if the field is unknown.
    """

    name: str
    shape: tuple[int, ...] | None
    fields: tuple[str, ...]
    reason: str = ""

    @property
    def project_section(self) -> str:
        """The section of a project file that defines it, with `nan` for its values.

        >>> print(UndefinedParameter("K", (), ("Plant/Gain:Gain",)).project_section)
        # used by Plant/Gain:Gain; a scalar
        [parameters.K]
        initial = nan
        """
        size = f"{size_text(self.shape)} values" if self.shape else "a scalar"
        size = "a number, or all values" if self.shape is None else size
        shape = self.shape if self.shape and math.prod(self.shape) <= _MAX_WRITTEN else ()
        comment = "; ".join(filter(None, (self.reason, f"used by {', '.join(self.fields)}", size)))
        return f"# {' '.join(comment.split())}\n[parameters.{quoted(self.name)}]\ninitial = {_placeholder(shape)}"


def _placeholder(shape: tuple[int, ...]) -> str:
    """Return an array of `nan` as TOML."""
    if not shape:
        return "nan"
    return f"[{', '.join([_placeholder(shape[1:])] * shape[0])}]"


def calibratable(parameter: Parameter, source: str = "") -> CalibratableParameter:
    """Summarise a parameter whose values are from `source`, with its range and limits in the unit of its values."""
    # the range in which every value of a table may lie
    lower, upper = float(np.max(parameter.lower)), float(np.min(parameter.upper))
    return CalibratableParameter(
        parameter.name, parameter.kind, parameter.values.shape,
        float(np.min(parameter.values)), float(np.max(parameter.values)), parameter.unit,
        lower if math.isfinite(lower) else None, upper if math.isfinite(upper) else None,
        bool(np.all(parameter.locked)), source,
    )  # fmt: skip
