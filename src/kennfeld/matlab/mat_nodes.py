"""Sparse matrices of MATLAB files, written out.

What a MATLAB file holds, in the same form for all versions: arrays, texts, structs, and what cannot be read.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "MOST_BYTES",
    "MOST_DENSE",
    "MOST_NODES",
    "PACKING",
    "MatCells",
    "MatFileContent",
    "MatFileError",
    "MatNumbers",
    "MatStruct",
    "MatStructArray",
    "MatText",
    "MatUnreadable",
    "Node",
    "TooManyError",
    "dense",
    "text_in_rows",
    "text_of",
]

MOST_BYTES = 4_000_000_000  # of all arrays
MOST_NODES = 100_000
PACKING = 1100  # bytes that one packed byte may stand for at most (deflate)

MOST_DENSE = 4_000_000  # values of all sparse matrices of a file, their zeros included


class MatFileError(Exception):
    """What no MATLAB writes; the text says what it is."""


class TooManyError(MatFileError):
    """More arrays than a file may hold, which ends the reading of it."""


@dataclass(frozen=True, eq=False)
class MatNumbers:
    """An array of real numbers, in MATLAB's shape; `whole` says that it is logical or of integers by its class.

    They may be stored in a smaller type than that of their class, which is `kind` where the file says it.
    """

    values: NDArray[Any]
    whole: bool = False
    kind: str = ""


@dataclass(frozen=True)
class MatText:
    """An array of characters; where it has several rows, `rows` are they, and stand one below the other in `text`."""

    text: str
    rows: tuple[str, ...] = ()


@dataclass(frozen=True)
class MatStruct:
    """A struct of one element, or an object of the class `kind`."""

    fields: Mapping[str, "Node"] = field(default_factory=dict)
    kind: str = ""


@dataclass(frozen=True)
class MatStructArray:
    """An array of structs, column by column; of unknown shape it is a row."""

    elements: Sequence[MatStruct]
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class MatCells:
    """A cell array, column by column; of unknown shape it is a row."""

    cells: Sequence["Node"]
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class MatUnreadable:
    """What only MATLAB can read, by the word for it: `table`, `timeseries`, `sparse matrix`.

    Of an object, `reference` tells where its properties are. `why` says what is wrong with a value that is damaged, or
    with the object that it is.
    """

    kind: str
    reference: "Node | None" = None
    why: str = ""


Node: TypeAlias = MatNumbers | MatText | MatStruct | MatStructArray | MatCells | MatUnreadable


@dataclass
class MatFileContent:
    """The variables of a file, and the arrays without a name behind them, where objects keep their properties.

    What is damaged stands among them as `Unreadable`. `damage` is the first that was found, `lost` the first by which
    variables may be missing.
    """

    variables: dict[str, Node] = field(default_factory=dict)
    further: list[Node] = field(default_factory=list)
    damage: str = ""
    lost: str = ""

    def whole(self) -> "MatFileContent":
        """The same; `DamageError` where anything of it is damaged."""
        if self.damage or self.lost:
            raise MatFileError(self.damage or self.lost)
        return self

    def lose(self, message: str) -> None:
        """Note that something of the file is lost."""
        self.lost, self.damage = self.lost or message, self.damage or message


def text_in_rows(letters: str, rows: int) -> MatText:
    """An array of characters, given column by column.

    >>> text_in_rows("ab cd ", 2).rows
    ('a d', 'bc')
    """
    if not 1 < rows <= len(letters):
        return MatText(letters)
    found = tuple(letters[row::rows].rstrip() for row in range(rows))
    return MatText("\n".join(found), found)


def text_of(node: Node | None) -> str:
    """The text of a node, of a cell array its first one; empty where there is none.

    >>> text_of(MatCells([MatText(" Speed "), MatText("rpm")])), text_of(None)
    ('Speed', '')
    """
    if isinstance(node, MatCells) and node.cells:
        node = node.cells[0]
    return " ".join(node.text.split()) if isinstance(node, MatText) else ""


def dense(
    shape: tuple[int, ...], rows: NDArray[Any], starts: NDArray[Any], values: NDArray[Any]
) -> NDArray[np.float64]:
    """The matrix of which `starts` says for each column, and for the end, where its `rows` and `values` begin.

    `DamageError` where they do not fit. There may be more rows and values than are in use.

    >>> dense((2, 2), np.array([0, 1]), np.array([0, 0, 2]), np.array([3.0, 4.0])).tolist()
    [[0.0, 3.0], [0.0, 4.0]]
    """
    if len(shape) != 2 or any(given.dtype.kind not in "ui" for given in (rows, starts)):
        raise MatFileError("a sparse matrix is of an unknown form")
    rows, starts = rows.astype(np.int64), starts.astype(np.int64)
    if starts.size != shape[1] + 1 or starts[0] != 0 or np.any(np.diff(starts) < 0):
        raise MatFileError("the columns of a sparse matrix make no sense")
    used = int(starts[-1])
    if used > min(rows.size, values.size) or np.any((rows[:used] < 0) | (rows[:used] >= shape[0])):
        raise MatFileError("the rows of a sparse matrix make no sense")
    full = np.zeros(shape)
    full[rows[:used], np.repeat(np.arange(shape[1]), np.diff(starts))] = values[:used]
    return full
