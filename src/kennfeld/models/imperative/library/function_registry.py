"""The functions that code may call, each with how many arguments it takes.

A new function is a rule with `@function("name", least, most)` in a file of its family.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.integer_types import IntegerType, word_named
from kennfeld.models.imperative.node_arrays import Nodes, Numbers, aligned
from kennfeld.models.imperative.symbolic_values import (
    DeferredValue,
    LogicalNodes,
    SymbolicValue,
    as_array,
    force,
    integers,
    word_of,
)

if TYPE_CHECKING:
    from kennfeld.models.imperative.expression_evaluator import ExpressionEvaluator

__all__ = [
    "KEEPS_INTEGERS",
    "SYMBOLIC_FUNCTIONS",
    "TAKES_TABLES",
    "SymbolicArguments",
    "function",
    "is_vector",
    "matlab_word",
]

# functions whose first result has the integer type of their arguments
KEEPS_INTEGERS = frozenset(
    {"abs", "sign", "floor", "ceil", "fix", "round", "real", "conj", "uminus", "uplus", "plus", "minus", "times"}
    | {"rdivide", "ldivide", "power", "mod", "rem", "idivide", "min", "max", "sum", "prod", "cumsum", "cumprod"}
    | {"diff", "sort", "median", "cat", "horzcat", "vertcat", "repmat", "diag", "tril", "triu", "flip", "fliplr"}
    | {"flipud", "circshift", "reshape", "permute", "squeeze", "transpose", "ctranspose", "mtimes", "linspace"}
)
TAKES_TABLES = frozenset({"interp1", "interp2"})  # functions that may make a table of a parameter

Rule: TypeAlias = "Callable[[SymbolicArguments], SymbolicValue | tuple[SymbolicValue, ...]]"


def matlab_word(name: str) -> IntegerType | None:
    """The integer type of a class of MATLAB, which rounds and keeps numbers within its limits; None of others."""
    word = word_named(name)
    return replace(word, rounding="Round", saturates=True) if word is not None else None


def is_vector(array: Nodes) -> bool:
    """Whether an array is one row or one column, which may be empty."""
    return array.ndim == 2 and 1 in array.shape


@dataclass(frozen=True, eq=False)
class SymbolicArguments:
    """The arguments of a call, and how many results it should give."""

    name: str
    calls: "ExpressionEvaluator"
    held: Sequence[SymbolicValue]
    wanted: int = 1

    def __len__(self) -> int:
        return len(self.held)

    def array(self, at: int) -> Nodes:
        """An argument, counted from 0, as an array of nodes."""
        return as_array(force(self.held[at]), f"argument {at + 1} of {self.name}")

    def vector(self, at: int) -> Nodes:
        """An argument as a column; raises `CodeError` where it is a matrix."""
        array = self.array(at)
        if array.size and not is_vector(array):
            raise self.refuse("of a matrix is not supported", "Call it for each column.")
        return array.reshape(-1, 1, order="F")

    def table(self, at: int) -> str:
        """The name of the parameter that an argument is, where nothing has been taken of it yet; else empty."""
        held = self.held[at]
        return held.name if isinstance(held, DeferredValue) else ""

    def fits(self, *arrays: Nodes) -> None:
        """Refuse arrays that grow beyond all bounds where they are expanded against each other."""
        shape = np.broadcast_shapes(*(one.shape for one in aligned(*arrays)))
        self.calls.context.room(float(np.prod(shape, dtype=np.float64)))

    @property
    def arrays(self) -> list[Nodes]:
        """All arguments as arrays of nodes."""
        return [self.array(at) for at in range(len(self))]

    def numbers(self, at: int, message: str = "") -> Numbers:
        """An argument as numbers that depend on no signal."""
        message = message or f"argument {at + 1} of {self.name}"
        found = self.calls.context.numbers(self.array(at), message)
        if found is None:
            raise ProgramError(f"{message} depends on signals, where it must be fixed")
        return found

    def whole(self, at: int) -> int:
        """An argument as one whole number that depends on no signal."""
        found = self.numbers(at)
        if found.size != 1 or not float(found.item()).is_integer():
            raise ProgramError(f"argument {at + 1} of {self.name} is no whole number")
        return int(found.item())

    def wholes(self, at: int) -> list[int]:
        """An argument as whole numbers that depend on no signal."""
        found = self.numbers(at).ravel(order="F")
        if not all(float(one).is_integer() for one in found):
            raise self.refuse(f"argument {at + 1} is not made of whole numbers")
        return [int(one) for one in found]

    def matrix(self, at: int) -> Nodes:
        """An argument of two dimensions."""
        array = self.array(at)
        if array.ndim > 2:
            raise self.refuse(f"argument {at + 1} has {array.ndim} dimensions, where a matrix is needed")
        return array

    def text(self, at: int) -> str:
        """An argument as a text."""
        held = self.held[at]
        if not isinstance(held, str):
            raise ProgramError(f"argument {at + 1} of {self.name} is no text")
        return held

    def dimension(self, at: int, array: Nodes) -> int:
        """Along which dimension an array is taken, from 0: as given, else the first that is longer than one."""
        if len(self) <= at:
            return next((axis for axis, size in enumerate(array.shape) if size != 1), 0)
        found = self.whole(at) - 1
        if not 0 <= found < 30:
            raise ProgramError(f"{self.name} along the dimension {found + 1}")
        return found

    def refuse(self, why: str, remedy: str = "") -> ProgramError:
        """That the function is called in a way that is not supported."""
        return ProgramError(f"{self.name}: {why}", remedy) if remedy else ProgramError(f"{self.name}: {why}")


@dataclass(frozen=True)
class SymbolicFunction:
    """One function."""

    name: str
    least: int
    most: int
    rule: Rule

    def results(
        self, calls: "ExpressionEvaluator", held: Sequence[SymbolicValue], wanted: int
    ) -> tuple[SymbolicValue, ...]:
        """What it gives for arguments."""
        if not self.least <= len(held) <= self.most:
            few = f"{self.least}" if self.least == self.most else f"{self.least} to {self.most}"
            raise ProgramError(f"{self.name} gets {len(held)} arguments, not {few}")
        try:
            made = self.rule(SymbolicArguments(self.name, calls, self._arguments(held), wanted))
        except (ValueError, IndexError, np.exceptions.AxisError) as error:
            raise ProgramError(f"{self.name}: its arguments do not fit each other ({str(error)[:100]})") from None
        results = made if isinstance(made, tuple) else (made,)
        word = word_of(*(one for one in held if isinstance(one, np.ndarray))) if self.name in KEEPS_INTEGERS else None
        if word is None or not isinstance(results[0], np.ndarray) or isinstance(results[0], LogicalNodes):
            return results
        return (integers(results[0], word), *results[1:])

    def _arguments(self, held: Sequence[SymbolicValue]) -> Sequence[SymbolicValue]:
        return held if self.name in TAKES_TABLES else [force(one) for one in held]


SYMBOLIC_FUNCTIONS: dict[str, SymbolicFunction] = {}


def function(*names: str, least: int = 1, most: int = 1) -> Callable[[Rule], Rule]:
    """Enter a rule as functions of these names."""

    def enter(rule: Rule) -> Rule:
        for name in names:
            SYMBOLIC_FUNCTIONS[name] = SymbolicFunction(name, least, most, rule)
        return rule

    return enter
