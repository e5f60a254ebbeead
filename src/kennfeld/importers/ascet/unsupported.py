"""The error for ESDL that a graph cannot express."""

from kennfeld.ascet.syntax import TextPosition, Unsupported


class UnsupportedEsdlError(Exception):
    """A part of the program that is wrong or not supported; `place` is None for the surrounding statement."""

    def __init__(self, message: str, remedy: str = "", place: TextPosition | None = None) -> None:
        super().__init__(message)
        self.message, self.remedy, self.place = message, remedy, place


def unsupported_error(tree: Unsupported) -> UnsupportedEsdlError:
    """Return the error for a part of a diagram or a text that is not supported."""
    return UnsupportedEsdlError(tree.message, tree.remedy, tree.place)
