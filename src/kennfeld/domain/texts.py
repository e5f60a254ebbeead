"""Parameters that hold text: free texts, words of an enumeration, and booleans."""

from dataclasses import KW_ONLY
from typing import Literal, get_args

from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass

TextKind = Literal["text", "enumeration", "boolean"]


@dataclass(frozen=True)
class Text:
    """A parameter that holds text; it is passed through, never calibrated.

    Attributes:
        name: its name in files.
        text: the text.
        kind: `text`, free text; `enumeration`, one of the words that the control unit defines; or `boolean`.
        description: free text.
        variant: the variant that the text belongs to.
        display_name: its short name.
        functions: the parts of the ECU software that use it.
        unit: its unit, if the file states one.

    Raises:
        ArgumentError: an unknown kind.

    >>> Text("Mode", "ON", kind="enumeration").kind
    'enumeration'
    """

    name: str
    text: str
    description: str = ""
    functions: tuple[str, ...] = ()
    _: KW_ONLY
    display_name: str = ""
    variant: str = ""
    unit: str = ""
    kind: TextKind = "text"

    def __post_init__(self) -> None:
        if self.kind not in get_args(TextKind):
            raise ArgumentError(f"kind={self.kind!r} of {self.name} must be text, enumeration or boolean")
