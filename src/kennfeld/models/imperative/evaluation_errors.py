"""What is raised where an expression has no value, or none that a graph can say.

What is raised where code goes further than a graph can follow.
"""

__all__ = ["DEFAULT_REMEDY", "AbortedPathError", "EvaluationError", "NotLowerableError", "ProgramError"]

DEFAULT_REMEDY = "Draw it as blocks, or bind its outputs."


class EvaluationError(Exception):
    """An expression has no value here; the text says why. `undefined` is the variable that nothing gives a value."""

    def __init__(self, why: str, undefined: str = "") -> None:
        super().__init__(why)
        self.undefined = undefined


class NotLowerableError(Exception):
    """An expression that only numbers can tell; `function` is the one in it, if that is why."""

    def __init__(self, why: str, function: str = "") -> None:
        super().__init__(why)
        self.function = function


class ProgramError(Exception):
    """Code that cannot become a graph; `line` is where it stands in its text, 0 where that is not known yet."""

    def __init__(self, message: str, remedy: str = DEFAULT_REMEDY, line: int = 0) -> None:
        super().__init__(message)
        self.message, self.remedy, self.line = message, remedy, line

    def __str__(self) -> str:
        return f"its code in line {self.line}: {self.message}" if self.line else f"its code: {self.message}"


class AbortedPathError(Exception):
    """A path on which the code calls `error`: no step of a model takes it."""
