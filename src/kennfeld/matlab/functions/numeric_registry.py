"""How a function of MATLAB is written here: it takes its arguments and returns a value, or a tuple of several."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.arrays import Float
from kennfeld.matlab.errors import Budget
from kennfeld.matlab.values import (
    Array,
    MatlabValueError,
    Value,
    array_value,
    elements_of,
    number,
    numbers,
    text,
    whole,
)

__all__ = ["MANY", "NUMERIC_FUNCTIONS", "NumericArguments", "NumericFunction", "function"]

MANY = 1000


@dataclass(frozen=True)
class NumericArguments:
    """What a function is called with; `outputs` is how many values the caller wants.

    `apply` calls a function that is an argument; `exists` tells whether a variable is there.
    """

    values: Sequence[Value]
    outputs: int
    budget: Budget
    apply: Callable[[Value, Sequence[Value], int], list[Value]]
    exists: Callable[[str], bool]

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, at: int) -> Value:
        return self.values[at]

    def numbers(self, at: int) -> Float:
        """The argument as numbers in double precision."""
        return numbers(self.values[at])

    def array(self, at: int) -> Array:
        """The argument as an array, of a parameter object its value."""
        return array_value(self.values[at])

    def data(self, at: int) -> Array:
        """The elements of the argument, whatever they are."""
        return elements_of(self.values[at])

    def number(self, at: int, default: float | None = None) -> float:
        """The argument as one number."""
        return default if default is not None and at >= len(self) else number(self.values[at])

    def whole(self, at: int, default: int | None = None) -> int:
        """The argument as one whole number."""
        return default if default is not None and at >= len(self) else whole(self.values[at])

    def text(self, at: int) -> str:
        """The argument as one text."""
        return text(self.values[at])

    def is_text(self, at: int) -> bool:
        """Whether there is such an argument, and it is a text."""
        value = self.values[at] if at < len(self) else None
        return isinstance(value, np.ndarray) and value.dtype.kind in "UO"

    def words(self, begin: int) -> list[str]:
        """The texts from an argument on, in lower case."""
        return [text(value).casefold() for value in self.values[begin:]]

    def dimension(self, at: int, array: Array) -> int:
        """The dimension, from 0, that an argument names; without it the first that is longer than 1."""
        if at >= len(self):
            return next((k for k, size in enumerate(array.shape) if size != 1), 0)
        found = whole(self.values[at])
        if not 1 <= found <= 32:
            raise MatlabValueError(f"{found} is no dimension")
        return found - 1


@dataclass(frozen=True)
class NumericFunction:
    """A function and how many arguments it takes."""

    run: Callable[[NumericArguments], "Value | tuple[Value, ...]"]
    least: int
    most: int


NUMERIC_FUNCTIONS: dict[str, NumericFunction] = {}
_Run = Callable[[NumericArguments], "Value | tuple[Value, ...]"]


def function(names: str, least: int, most: int | None = None) -> Callable[[_Run], _Run]:
    """Registers a function under one or more names, parted by blanks."""

    def register(run: _Run) -> _Run:
        for name in names.split():
            NUMERIC_FUNCTIONS[name] = NumericFunction(run, least, least if most is None else most)
        return run

    return register
