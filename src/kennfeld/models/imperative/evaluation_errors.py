"""Errors of expressions and code that have no value or cannot be expressed by a graph."""

DEFAULT_REMEDY = "Replace it by blocks, or bind its outputs."


class ProgramError(Exception):
    """The code cannot be lowered to a graph; `line` is its line in the text, 0 if not known yet."""

    def __init__(self, message: str, remedy: str = DEFAULT_REMEDY, line: int = 0) -> None:
        super().__init__(message)
        self.message, self.remedy, self.line = message, remedy, line

    def __str__(self) -> str:
        return f"its code in line {self.line}: {self.message}" if self.line else f"its code: {self.message}"


class EvaluationError(ProgramError):
    """The expression has no value, not even numerically; `undefined` is an undefined variable, if that is why."""

    def __init__(self, message: str, undefined: str = "", remedy: str = DEFAULT_REMEDY) -> None:
        super().__init__(message, remedy)
        self.undefined = undefined

    def __str__(self) -> str:
        return self.message


class UndecidedSizeError(ProgramError):
    """The size of an array depends on a condition; the statement can be followed for each of the two cases."""

    def __init__(self, message: str, remedy: str, condition: int) -> None:
        super().__init__(message, remedy)
        self.condition = condition


class AbortedPathError(Exception):
    """A path on which the code calls `error`; no step of a model takes it."""
