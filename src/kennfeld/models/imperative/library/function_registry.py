"""Registry of library functions, with the number of arguments each takes.

A new function is a rule decorated with `@function("name", least, most)` in the module of its family.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TypeAlias

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.builder import GraphBuilder
from kennfeld.matlab.values import is_vector
from kennfeld.models.imperative import symbolic_values as s
from kennfeld.models.imperative.evaluation_context import EvaluationContext, SymbolicEvaluator
from kennfeld.models.imperative.evaluation_errors import ProgramError
from kennfeld.models.imperative.integer_types import IntegerType, integer_type_named
from kennfeld.models.imperative.node_arrays import Elementwise, Nodes, Numbers, align_dimensions

# functions whose first result has the integer type of their arguments
KEEPS_INTEGERS = frozenset(
    {"abs", "sign", "floor", "ceil", "fix", "round", "real", "conj", "uminus", "uplus", "plus", "minus", "times"}
    | {"rdivide", "ldivide", "power", "mod", "rem", "idivide", "min", "max", "sum", "prod", "cumsum", "cumprod"}
    | {"diff", "sort", "median", "cat", "horzcat", "vertcat", "repmat", "diag", "tril", "triu", "flip", "fliplr"}
    | {"flipud", "circshift", "reshape", "permute", "squeeze", "transpose", "ctranspose", "mtimes", "linspace"}
)
TAKES_TABLES = frozenset({"interp1", "interp2"})  # functions that may make a table of a parameter

Rule: TypeAlias = "Callable[[SymbolicArguments], s.SymbolicValue | tuple[s.SymbolicValue, ...]]"


def matlab_word(name: str) -> IntegerType | None:
    """Return the integer type of a MATLAB class, which rounds and saturates; None for other classes."""
    word = integer_type_named(name)
    return replace(word, rounding="Round", saturates=True) if word is not None else None


@dataclass(frozen=True, eq=False)
class SymbolicArguments:
    """The arguments of a call, and the number of results wanted."""

    name: str
    evaluator: SymbolicEvaluator
    values: Sequence[s.SymbolicValue]
    wanted: int = 1

    @property
    def builder(self) -> GraphBuilder:
        """The builder of the graph."""
        return self.evaluator.builder

    @property
    def context(self) -> EvaluationContext:
        """The context shared by all code of the block."""
        return self.evaluator.context

    @cached_property
    def apply(self) -> Elementwise:
        """The operations of the graph, element by element."""
        return Elementwise(self.builder)

    def __len__(self) -> int:
        return len(self.values)

    def array(self, at: int) -> Nodes:
        """Return an argument, counted from 0, as an array of nodes."""
        return s.as_array(s.force(self.values[at]), f"argument {at + 1} of {self.name}")

    def vector(self, at: int) -> Nodes:
        """Return an argument as a column; raises `ProgramError` if it is a matrix."""
        array = self.array(at)
        if array.size and not is_vector(array):
            raise self.refuse("of a matrix is not supported", "Call it for each column.")
        return array.reshape(-1, 1, order="F")

    def table(self, at: int) -> str:
        """Return the name of the parameter that an argument is, if it is not used yet; else ""."""
        value = self.values[at]
        return value.name if isinstance(value, s.DeferredValue) else ""

    def fits(self, *arrays: Nodes) -> None:
        """Raise `ProgramError` if arrays broadcast against each other become too large."""
        shape = np.broadcast_shapes(*(item.shape for item in align_dimensions(*arrays)))
        self.context.room(float(np.prod(shape, dtype=np.float64)))

    @property
    def arrays(self) -> list[Nodes]:
        """All arguments as arrays of nodes."""
        return [self.array(at) for at in range(len(self))]

    def numbers(self, at: int, message: str = "") -> Numbers:
        """Return an argument as numbers that depend on no signal."""
        message = message or f"argument {at + 1} of {self.name}"
        numbers = self.context.numbers(self.array(at), message)
        if numbers is None:
            raise ProgramError(f"{message} must not depend on signals")
        return numbers

    def whole(self, at: int) -> int:
        """Return an argument as an integer that depends on no signal."""
        numbers = self.numbers(at)
        if numbers.size != 1 or not float(numbers.item()).is_integer():
            raise ProgramError(f"argument {at + 1} of {self.name} is not an integer")
        return int(numbers.item())

    def matrix(self, at: int) -> Nodes:
        """Return an argument of two dimensions."""
        array = self.array(at)
        if array.ndim > 2:
            raise self.refuse(f"argument {at + 1} must be a matrix, but has {array.ndim} dimensions")
        return array

    def text(self, at: int) -> str:
        """Return an argument as a text."""
        value = self.values[at]
        if not isinstance(value, str):
            raise ProgramError(f"argument {at + 1} of {self.name} is not a text")
        return value

    def refuse(self, why: str, remedy: str = "") -> ProgramError:
        """Return the error that the function is called in an unsupported way."""
        return ProgramError(f"{self.name}: {why}", remedy) if remedy else ProgramError(f"{self.name}: {why}")


@dataclass(frozen=True)
class SymbolicFunction:
    """A library function."""

    name: str
    least: int
    most: int
    rule: Rule

    def results(
        self, evaluator: SymbolicEvaluator, values: Sequence[s.SymbolicValue], wanted: int
    ) -> tuple[s.SymbolicValue, ...]:
        """Call the function with arguments."""
        if not self.least <= len(values) <= self.most:
            expected = f"{self.least}" if self.least == self.most else f"{self.least} to {self.most}"
            raise ProgramError(f"{self.name} takes {expected} arguments, got {len(values)}")
        forced = values if self.name in TAKES_TABLES else [s.force(value) for value in values]
        try:
            result = self.rule(SymbolicArguments(self.name, evaluator, forced, wanted))
        except (ValueError, IndexError, np.exceptions.AxisError) as error:
            raise ProgramError(f"{self.name}: its arguments have incompatible sizes ({str(error)[:100]})") from None
        first, *others = result if isinstance(result, tuple) else (result,)
        word = s.word_of(*(value for value in values if isinstance(value, np.ndarray)))
        is_number = isinstance(first, np.ndarray) and not isinstance(first, s.LogicalNodes)
        if word is not None and is_number and self.name in KEEPS_INTEGERS:
            first = s.integers(s.as_array(first), word)
        return (first, *others)


SYMBOLIC_FUNCTIONS: dict[str, SymbolicFunction] = {}
C_FUNCTIONS: dict[str, SymbolicFunction] = {}


def function(
    *names: str, least: int = 1, most: int = 1, library: dict[str, SymbolicFunction] = SYMBOLIC_FUNCTIONS
) -> Callable[[Rule], Rule]:
    """Register a rule as functions of these names."""

    def enter(rule: Rule) -> Rule:
        library.update({name: SymbolicFunction(name, least, most, rule) for name in names})
        return rule

    return enter
