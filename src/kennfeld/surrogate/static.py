"""A static data-driven model: an expansion with names, a validity range and its quality."""

from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Bool, Float
from kennfeld.errors import ArgumentError
from kennfeld.expansion import Expansion
from kennfeld.surrogate.quality import Quality
from kennfeld.surrogate.validity import Validity

__all__ = ["StaticSurrogate"]


@dataclass(frozen=True, eq=False)
class StaticSurrogate:
    """y = f(inputs), trained on steady-state points.

    `units` are those of the inputs, then of the output; empty where none are known.
    Raises `ArgumentError` where names and expansion do not fit each other.
    """

    name: str
    inputs: tuple[str, ...]
    output: str
    units: tuple[str, ...]
    expansion: Expansion
    validity: Validity | None = None
    quality: tuple[Quality, ...] = ()

    def __post_init__(self) -> None:
        check_names(self.name, self.inputs, self.output, self.units)
        if self.expansion.inputs != len(self.inputs):
            raise ArgumentError(
                f"surrogate {self.name} has {len(self.inputs)} inputs, its expansion {self.expansion.inputs}"
            )

    def __call__(self, x: Float) -> Float:
        """The output at points Float[..., inputs]."""
        return self.expansion(x)

    def outside(self, x: Float) -> Bool:
        """Whether points Float[..., inputs] are too far from the training data; none is without a validity range."""
        return np.zeros(np.shape(x)[:-1], dtype=bool) if self.validity is None else self.validity.outside(x)


def check_names(name: str, inputs: tuple[str, ...], output: str, units: tuple[str, ...]) -> None:
    """What the names of any surrogate must keep to."""
    if not inputs:
        raise ArgumentError(f"inputs=() of surrogate {name}: it needs at least one")
    twice = [given for i, given in enumerate(inputs) if given in inputs[:i]]
    if twice:
        raise ArgumentError(f"surrogate {name} has input {twice[0]} twice")
    if output in inputs:
        raise ArgumentError(f"output={output!r} of surrogate {name} is one of its inputs")
    if units and len(units) != len(inputs) + 1:
        raise ArgumentError(f"units={units} of surrogate {name} must be one an input and one of the output, or none")
