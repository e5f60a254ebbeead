"""What a name means in a block's parameters: masks from the inside out, then the variables of the model."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias, Union

import numpy as np
import numpy.typing as npt

from kennfeld.models.simulink.tree import Block

__all__ = ["Array", "Masked", "Scope", "Value", "Variable", "plain"]

Array: TypeAlias = npt.NDArray[np.float64]
Value: TypeAlias = Union[Array, str, "Mapping[str, Value]", "tuple[Value, ...]"]


@dataclass(frozen=True, eq=False)
class Variable:
    """A variable of the model: its value, and what its source says of it. `source` names that source."""

    value: Value
    lower: float = -np.inf
    upper: float = np.inf
    unit: str = ""
    description: str = ""
    source: str = ""


@dataclass(frozen=True, eq=False)
class Masked:
    """A mask's parameter: an expression over the names outside of the mask, or the text itself."""

    text: str
    outside: "Scope"
    evaluated: bool = True
    field: str = ""  # "Path:Name", how the literal is promoted


@dataclass(eq=False)
class Scope:
    """The names that the blocks of one system see."""

    variables: Mapping[str, Variable]
    masked: dict[str, Masked] = field(default_factory=dict)
    outer: "Scope | None" = None
    path: str = ""

    def within(self, block: Block) -> "Scope":
        """The names inside of a subsystem."""
        if block.mask is None or not block.mask.parameters:
            return self
        return self.masking(block, {p.name: (p.expression, p.evaluated) for p in block.mask.parameters})

    def masking(self, block: Block, given: Mapping[str, tuple[str, bool]]) -> "Scope":
        """The names inside of a mask with these parameters."""
        inside = Scope(self.variables, {}, self, block.path)
        for name, (text, evaluated) in given.items():
            inside.masked[name] = Masked(text, self, evaluated, f"{block.path}:{name}")
        return inside

    def find(self, name: str) -> "Masked | Variable | None":
        """What a name means here."""
        here: Scope | None = self
        while here is not None:
            if name in here.masked:
                return here.masked[name]
            here = here.outer
        return self.variables.get(name)


def plain(value: Any) -> Value | None:
    """A value in the few forms that models use: arrays of float64, texts, structs, tuples; None for others.

    >>> plain(3), plain({"a": [1, 2]})
    (array([3.]), {'a': array([1., 2.])})
    """
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        parts = {str(key): plain(part) for key, part in value.items()}
        return {key: part for key, part in parts.items() if part is not None}
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        return _several(value)
    return np.atleast_1d(array)


def _several(value: Any) -> Value | None:
    if not isinstance(value, (tuple, list)):
        return None
    parts = [plain(part) for part in value]
    known = tuple(part for part in parts if part is not None)
    return known if len(known) == len(parts) else None
