"""The registry of MATLAB functions on numeric values; each returns a value or a tuple of several."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.matlab import values as v
from kennfeld.matlab.errors import Budget

MANY = 1000


@dataclass(frozen=True)
class NumericArguments:
    """The arguments of a call; `outputs` is the number of requested values.

    `apply` calls a function handle; `exists` returns True for the name of a variable.
    """

    values: Sequence[v.Value]
    outputs: int
    budget: Budget
    apply: Callable[[v.Value, Sequence[v.Value], int], list[v.Value]]
    exists: Callable[[str], bool]

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, at: int) -> v.Value:
        return self.values[at]

    def numbers(self, at: int) -> Float:
        """Return an argument as numbers in double precision."""
        return v.numbers(self.values[at])

    def array(self, at: int) -> v.Array:
        """Return an argument as an array; a parameter object counts as its value."""
        return v.array_value(self.values[at])

    def matrix(self, at: int) -> v.Array:
        """Return an argument as an array of two dimensions."""
        array = self.array(at)
        if array.ndim > 2:
            raise v.MatlabValueError(f"must be a matrix, got an array of {array.ndim} dimensions")
        return array

    def data(self, at: int) -> v.Array:
        """Return the elements of an argument of any class."""
        return v.elements_of(self.values[at])

    def number(self, at: int, default: float | None = None) -> float:
        """Return an argument as one number."""
        return default if default is not None and at >= len(self) else v.number(self.values[at])

    def integer(self, at: int, default: int | None = None) -> int:
        """Return an argument as one integer."""
        return default if default is not None and at >= len(self) else v.integer(self.values[at])

    def text(self, at: int) -> str:
        """Return an argument as text."""
        return v.text(self.values[at])

    def is_text(self, at: int) -> bool:
        """Return True if the argument exists and is text."""
        return at < len(self) and v.is_text(self.values[at])

    def words(self, begin: int) -> list[str]:
        """Return the texts from an argument on, in lower case."""
        return [v.text(value).casefold() for value in self.values[begin:]]

    def dimension(self, at: int, array: v.Array) -> int:
        """Return the dimension, from 0, that an argument names; by default the first longer than 1."""
        if at >= len(self):
            return next((k for k, size in enumerate(array.shape) if size != 1), 0)
        dimension = v.integer(self.values[at])
        if not 1 <= dimension <= 32:
            raise v.MatlabValueError(f"a dimension must be between 1 and 32, got {dimension}")
        return dimension - 1


Run: TypeAlias = Callable[[NumericArguments], "v.Value | tuple[v.Value, ...]"]


@dataclass(frozen=True)
class NumericFunction:
    """A function with its minimum and maximum number of arguments."""

    run: Run
    least: int
    most: int


NUMERIC_FUNCTIONS: dict[str, NumericFunction] = {}


def function(names: str, least: int, most: int | None = None) -> Callable[[Run], Run]:
    """Register a function under one or more names, separated by blanks."""

    def register(run: Run) -> Run:
        for name in names.split():
            NUMERIC_FUNCTIONS[name] = NumericFunction(run, least, least if most is None else most)
        return run

    return register
