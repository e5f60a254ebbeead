"""The content of MATLAB data files in one form for all versions: arrays, texts, structs and unreadable values."""

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from kennfeld.base.lazy_dataclass import dataclass

MAX_BYTES = 4_000_000_000  # of all arrays
MAX_NODES = 100_000
# zlib states 1032:1; a larger claim is damage, and its size would be allocated
MAX_COMPRESSION = 1100  # maximum ratio of deflate

MAX_DENSE = 4_000_000  # values of all sparse matrices of a file, including zeros


class MatFileError(Exception):
    """A file is damaged or was not written by MATLAB; the text describes the damage."""


class ArrayLimitError(MatFileError):
    """A file holds more arrays than allowed, which ends reading."""


@dataclass(frozen=True, eq=False)
class MatNumbers:
    """A real array in the shape of MATLAB.

    The numbers may be stored in a smaller type than that of their class `kind` (empty if the file does not say it);
    `whole` is True for logical and integer classes.
    """

    values: NDArray[Any]
    whole: bool = False
    kind: str = ""


@dataclass(frozen=True)
class MatText:
    """A character array; several `rows` are joined by line breaks in `text`."""

    text: str
    rows: tuple[str, ...] = ()


@dataclass(frozen=True)
class MatStruct:
    """A struct of one element, or an object of the class `kind`."""

    fields: Mapping[str, "Node"] = field(default_factory=dict)
    kind: str = ""


@dataclass(frozen=True)
class MatStructArray:
    """An array of structs in column-major order; without a shape it is a row."""

    elements: Sequence[MatStruct]
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class MatCells:
    """A cell array in column-major order; without a shape it is a row."""

    cells: Sequence["Node"]
    shape: tuple[int, ...] = ()


@dataclass(frozen=True)
class MatUnreadable:
    """A value that only MATLAB can read, such as a `table`, `timeseries` or `sparse matrix`.

    For an object, `reference` locates its properties. `why` describes the damage of the value or of its object. Complex
    numbers have two `parts`, which are of use only in dates.
    """

    kind: str
    reference: "Node | None" = None
    why: str = ""
    parts: tuple[NDArray[Any], NDArray[Any]] | None = field(default=None, compare=False, repr=False)


Node: TypeAlias = MatNumbers | MatText | MatStruct | MatStructArray | MatCells | MatUnreadable


@dataclass
class MatFileContent:
    """The variables of a file, and the unnamed arrays behind them, which store the properties of objects.

    Damaged values are `MatUnreadable`. `damage` is the first damage found, `lost` the first by which variables may be
    missing.
    """

    variables: dict[str, Node] = field(default_factory=dict)
    further: list[Node] = field(default_factory=list)
    damage: str = ""
    lost: str = ""

    def whole(self) -> "MatFileContent":
        """Return the content; raises `MatFileError` if any of it is damaged."""
        if self.damage or self.lost:
            raise MatFileError(self.damage or self.lost)
        return self

    def lose(self, message: str) -> None:
        """Record that a part of the file is lost."""
        self.lost, self.damage = self.lost or message, self.damage or message


def split_text_rows(letters: str, rows: int) -> MatText:
    """Split letters in column-major order into the rows of a character array.

    >>> split_text_rows("ab cd ", 2).rows
    ('a d', 'bc')
    """
    if not 1 < rows <= len(letters):
        return MatText(_join_surrogates(letters))
    # column-major: the letters of a row are `rows` apart; MATLAB pads rows of different lengths with blanks
    lines = tuple(_join_surrogates(letters[row::rows]).rstrip() for row in range(rows))
    return MatText("\n".join(lines), lines)


def _join_surrogates(letters: str) -> str:
    """Return a text in which pairs of UTF-16 code units are characters, and single ones are replaced.

    MATLAB stores code units as numbers. Python's texts hold characters, and no file can be written with half of one.
    """
    if not any("\ud800" <= letter <= "\udfff" for letter in letters):
        return letters
    return letters.encode("utf-16", "surrogatepass").decode("utf-16", "replace")


def node_text(node: Node | None) -> str:
    """Return the text of a node, or of the first element of a cell array; empty if there is none.

    >>> node_text(MatCells([MatText(" Speed "), MatText("rpm")])), node_text(None)
    ('Speed', '')
    """
    if isinstance(node, MatCells) and node.cells:
        node = node.cells[0]
    return " ".join(node.text.split()) if isinstance(node, MatText) else ""


def to_dense(
    shape: tuple[int, ...], rows: NDArray[Any], starts: NDArray[Any], values: NDArray[Any]
) -> NDArray[np.float64]:
    """Convert a sparse matrix in compressed column format.

    Args:
        shape: Number of rows and columns.
        rows: Row indices, from 0; may be longer than used.
        starts: Offset of each column in `rows` and `values`, and the end, Int[columns + 1].
        values: Values; may be longer than used.

    Returns:
        The dense matrix, Float[rows, columns].

    Raises:
        MatFileError: Indices and offsets are inconsistent.

    Example:
        >>> to_dense((2, 2), np.array([0, 1]), np.array([0, 0, 2]), np.array([3.0, 4.0])).tolist()
        [[0.0, 3.0], [0.0, 4.0]]
    """
    if len(shape) != 2 or any(indices.dtype.kind not in "ui" for indices in (rows, starts)):
        raise MatFileError("a sparse matrix has an unknown format")
    rows, starts = rows.astype(np.int64), starts.astype(np.int64)
    if starts.size != shape[1] + 1 or starts[0] != 0 or np.any(np.diff(starts) < 0):
        raise MatFileError("the columns of a sparse matrix are inconsistent")
    used = int(starts[-1])
    if used > min(rows.size, values.size) or np.any((rows[:used] < 0) | (rows[:used] >= shape[0])):
        raise MatFileError("the rows of a sparse matrix are inconsistent")
    full = np.zeros(shape)
    # column j has the entries starts[j] to starts[j + 1] - 1
    full[rows[:used], np.repeat(np.arange(shape[1]), np.diff(starts))] = values[:used]
    return full
