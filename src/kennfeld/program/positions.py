"""Positions in a text, by line and column or by offset."""

import re
from bisect import bisect_right
from typing import NamedTuple


class TextPosition(NamedTuple):
    """Position in a text: line and column from 1, and the offset of the character from 0.

    `file` is empty if the text is that of the declaration around it.
    """

    line: int = 1
    column: int = 1
    offset: int = 0
    file: str = ""


class TextLines:
    r"""Converts offsets in a text to lines and columns.

    >>> TextLines("a = 1\nb = 2").position(10)
    TextPosition(line=2, column=5, offset=10, file='')
    """

    def __init__(self, text: str) -> None:
        self.text = text
        # offsets of the first characters of all lines, in ascending order for `bisect_right`
        self.begins = [0, *(match.end() for match in re.finditer("\n", text))]

    def position(self, offset: int) -> TextPosition:
        """Return the position of an offset."""
        line = bisect_right(self.begins, offset)
        return TextPosition(line, offset - self.begins[line - 1] + 1, offset)

    def number(self, offset: int) -> int:
        """Return the number of the line around an offset, from 1."""
        return bisect_right(self.begins, offset)

    def line(self, offset: int) -> str:
        """Return the line around an offset."""
        begin = self.begins[bisect_right(self.begins, offset) - 1]
        end = self.text.find("\n", begin)
        return self.text[begin : len(self.text) if end < 0 else end]
