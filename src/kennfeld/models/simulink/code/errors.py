"""What is raised where code goes further than a graph can follow."""

__all__ = ["MEND", "CodeError", "EndedError"]

MEND = "Draw it as blocks, or bind its outputs."


class CodeError(Exception):
    """Code that cannot become a graph; `line` is where it stands in its text, 0 where that is not known yet."""

    def __init__(self, what: str, mend: str = MEND, line: int = 0) -> None:
        super().__init__(what)
        self.what, self.mend, self.line = what, mend, line

    def __str__(self) -> str:
        return f"its code in line {self.line}: {self.what}" if self.line else f"its code: {self.what}"


class EndedError(Exception):
    """A path on which the code calls `error`: no step of a model takes it."""
