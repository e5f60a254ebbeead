"""What a MATLAB file holds, in the same form for all versions: arrays, texts, structs, and what cannot be read."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from numpy.typing import NDArray

__all__ = [
    "MOST_BYTES",
    "MOST_NODES",
    "PACKING",
    "Cells",
    "DamageError",
    "Node",
    "Numbers",
    "Struct",
    "Structs",
    "Text",
    "Unreadable",
    "text_of",
]

MOST_BYTES = 4_000_000_000  # of all arrays
MOST_NODES = 100_000
PACKING = 1100  # bytes that one packed byte may stand for at most (deflate)


class DamageError(Exception):
    """What no MATLAB writes; the text says what it is."""


@dataclass(frozen=True, eq=False)
class Numbers:
    """An array of real numbers, in MATLAB's shape; `whole` says that it is logical or of integers by its class.

    They may be stored in a smaller type than that of their class, which is `kind` where the file says it.
    """

    values: NDArray[Any]
    whole: bool = False
    kind: str = ""


@dataclass(frozen=True)
class Text:
    """An array of characters."""

    text: str


@dataclass(frozen=True)
class Struct:
    """A struct of one element, or an object of the class `kind`."""

    fields: Mapping[str, "Node"] = field(default_factory=dict)
    kind: str = ""


@dataclass(frozen=True)
class Structs:
    """An array of structs, column by column; of unknown shape it is a row."""

    elements: Sequence[Struct]
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class Cells:
    """A cell array, column by column; of unknown shape it is a row."""

    cells: Sequence["Node"]
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class Unreadable:
    """What only MATLAB can read, by the word for it: `table`, `timeseries`, `sparse matrix`.

    Of an object, `reference` tells where its properties are.
    """

    kind: str
    reference: "Node | None" = None


Node: TypeAlias = Numbers | Text | Struct | Structs | Cells | Unreadable


def text_of(node: Node | None) -> str:
    """The text of a node, of a cell array its first one; empty where there is none.

    >>> text_of(Cells([Text(" Speed "), Text("rpm")])), text_of(None)
    ('Speed', '')
    """
    if isinstance(node, Cells) and node.cells:
        node = node.cells[0]
    return " ".join(node.text.split()) if isinstance(node, Text) else ""
