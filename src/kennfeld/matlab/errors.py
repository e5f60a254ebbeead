"""What is raised where MATLAB text cannot be read or has no value.

How much a script may do before it is stopped: nothing that is read may take the machine with it.
"""

from dataclasses import dataclass

from kennfeld.errors import Finding, InputError
from kennfeld.matlab.syntax import SourcePosition

__all__ = ["Budget", "LimitError", "MatlabError", "located"]


class MatlabError(InputError):
    """Text that is no MATLAB, or an expression without a value; its findings name line and column."""

    @classmethod
    def at(cls, name: str, place: SourcePosition, message: str, remedy: str = "", excerpt: str = "") -> "MatlabError":
        """The error with one finding at a place of a text called `name`."""
        return cls([Finding(located(name, place), message, remedy, excerpt)])


def located(name: str, place: SourcePosition) -> str:
    """How a place is told; an expression of one line without a name needs no line.

    >>> located("init.m", SourcePosition(3, 7))
    'init.m line 3 column 7'
    """
    return f"{name} line {place.line} column {place.column}".strip()


class LimitError(Exception):
    """A script does more than any parameter script has to."""


@dataclass
class Budget:
    """What is left: `steps` of the evaluator, `elements` of the arrays it makes, `calls` of functions within others."""

    steps: int = 1_000_000
    elements: int = 50_000_000
    calls: int = 15

    def step(self, cost: int = 1) -> None:
        """One more expression or statement; `cost` is more than 1 for what takes longer than most."""
        self.steps -= cost
        if self.steps < 0:
            raise LimitError("the script takes too many steps")

    def make(self, count: float) -> None:
        """Room for so many elements."""
        if not count <= self.elements:
            raise LimitError("the script asks for too much memory")
        self.elements -= int(count)
