"""The error for ESDL that a graph cannot express."""

from kennfeld.ascet.syntax import TextPosition


class UnsupportedEsdlError(Exception):
    """A part of the program that is wrong or not supported; `place` is None for the surrounding statement."""

    def __init__(self, message: str, remedy: str = "", place: TextPosition | None = None) -> None:
        super().__init__(message)
        self.message, self.remedy, self.place = message, remedy, place
