"""What is raised where MATLAB text cannot be read or has no value."""

from kennfeld.errors import Finding, InputError
from kennfeld.matlab.syntax import Place

__all__ = ["MatlabError", "located"]


class MatlabError(InputError):
    """Text that is no MATLAB, or an expression without a value; its findings name line and column."""

    @classmethod
    def at(cls, name: str, place: Place, what: str, mend: str = "", excerpt: str = "") -> "MatlabError":
        """The error with one finding at a place of a text called `name`."""
        return cls([Finding(located(name, place), what, mend, excerpt)])


def located(name: str, place: Place) -> str:
    """How a place is told; an expression of one line without a name needs no line.

    >>> located("init.m", Place(3, 7))
    'init.m line 3 column 7'
    """
    return f"{name} line {place.line} column {place.column}".strip()
