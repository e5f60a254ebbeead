"""Errors of expressions and code that have no value or cannot be expressed by a graph."""

DEFAULT_REMEDY = "Replace it by blocks, or bind its outputs."


class EvaluationError(Exception):
    """The expression has no value; `undefined` is the variable that is not defined, if that is why."""

    def __init__(self, why: str, undefined: str = "") -> None:
        super().__init__(why)
        self.undefined = undefined


class NotLowerableError(Exception):
    """The expression can be evaluated numerically only; `function` is the one responsible, if any."""

    def __init__(self, why: str, function: str = "") -> None:
        super().__init__(why)
        self.function = function


class ProgramError(Exception):
    """The code cannot be lowered to a graph; `line` is its line in the text, 0 if not known yet."""

    def __init__(self, message: str, remedy: str = DEFAULT_REMEDY, line: int = 0) -> None:
        super().__init__(message)
        self.message, self.remedy, self.line = message, remedy, line

    def __str__(self) -> str:
        return f"its code in line {self.line}: {self.message}" if self.line else f"its code: {self.message}"


class AbortedPathError(Exception):
    """A path on which the code calls `error`; no step of a model takes it."""
