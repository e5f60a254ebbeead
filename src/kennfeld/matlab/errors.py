"""Errors of MATLAB text, and the limits of what a script may consume."""

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.program.positions import TextPosition


class MatlabError(InputError):
    """Invalid MATLAB text, or an expression without a value; its findings name line and column."""

    @classmethod
    def at(cls, name: str, place: TextPosition, message: str, remedy: str = "", excerpt: str = "") -> "MatlabError":
        """Return the error with one finding at a position of the text called `name`."""
        return cls([Finding(Location(name, place.line, column=place.column), message, remedy, excerpt)])


def failed_assignment(place: Location) -> str:
    """Return why a variable has no value that a script does not assign."""
    return f"assignment failed in {place}"


class LimitError(Exception):
    """A script exceeds its budget."""


@dataclass
class Budget:
    """The remaining budget: `steps` of the evaluator, array `elements`, and `calls` of functions within functions."""

    steps: int = 1_000_000
    elements: int = 50_000_000
    calls: int = 15

    def step(self, cost: int = 1) -> None:
        """Count an expression or statement; `cost` exceeds 1 for operations that take longer than most."""
        self.steps -= cost
        if self.steps < 0:
            raise LimitError("the script takes too many steps")

    def allocate(self, count: float) -> None:
        """Reserve memory for `count` array elements."""
        if not count <= self.elements:
            raise LimitError("the script requires too much memory")
        self.elements -= int(count)
