"""Walks the tokens of one block: what has to be there in order, then the optional keywords in any order."""

from collections.abc import Mapping
from math import isnan

from kennfeld.calfiles.a2l.blocks import Block, is_text, unquoted
from kennfeld.calfiles.format import one_line

__all__ = ["Cursor", "UnusableError"]

_SHOWN = 40


class UnusableError(Exception):
    """A block that does not say what its keyword asks for; the text says what is wrong."""


class Cursor:
    """A place within the tokens of a block; inner blocks are passed over.

    Everything raises `UnusableError` where the block has something else.
    """

    def __init__(self, block: Block) -> None:
        self.tokens = block.tokens
        self.at = 0

    def left(self) -> int:
        """How many tokens are left."""
        return len(self.tokens) - self.at

    def word(self, what: str) -> str:
        """The next word or text; `what` names it in a message."""
        if self.at >= len(self.tokens):
            raise UnusableError(f"has no {what}")
        self.at += 1
        return unquoted(self.tokens[self.at - 1])

    def text(self, what: str) -> str:
        """The next text in quotes, as one line."""
        if self.at >= len(self.tokens) or not is_text(self.tokens[self.at]):
            raise UnusableError(f"has no {what} in quotes")
        return one_line(self.word(what))

    def number(self, what: str) -> float:
        """The next number."""
        word = self.word(what)
        value = number(word)
        if value is None:
            raise UnusableError(f"has {word[:_SHOWN]!r} where its {what} should be")
        return value

    def whole(self, what: str) -> int:
        """The next whole number, decimal or hexadecimal."""
        word = self.word(what)
        value = whole(word)
        if value is None:
            raise UnusableError(f"has {word[:_SHOWN]!r} where its {what} should be, a whole number")
        return value

    def options(self, known: Mapping[str, int]) -> dict[str, list[str]]:
        """The words behind each keyword of `known`, which says how many there are (-1: up to the next keyword).

        Words that belong to no known keyword are passed over; of a keyword given twice the last one counts.
        """
        found: dict[str, list[str]] = {}
        while self.at < len(self.tokens):
            keyword = self.tokens[self.at]
            self.at += 1
            if keyword not in known:
                continue
            count = known[keyword]
            end = self.at + count if count >= 0 else self._next_keyword(known)
            if end > len(self.tokens):
                raise UnusableError(f"has too few words behind {keyword}")
            found[keyword] = [unquoted(token) for token in self.tokens[self.at : end]]
            self.at = end
        return found

    def _next_keyword(self, known: Mapping[str, int]) -> int:
        at = self.at
        while at < len(self.tokens) and whole(self.tokens[at]) is not None:
            at += 1
        return at


def number(word: str) -> float | None:
    """A number of A2L: decimal, or hexadecimal with 0x; infinite where it is beyond all numbers.

    >>> number("0x10"), number("1e3"), number("one")
    (16.0, 1000.0, None)
    """
    try:
        value = float(word)
    except ValueError:
        found = whole(word)
        return None if found is None else float(found)
    return None if isnan(value) or "_" in word else value


def whole(word: str) -> int | None:
    """A whole number of at most 64 bits, None where the word is none."""
    if len(word) > 40 or "_" in word:
        return None
    try:
        sign, digits = (-1, word[1:]) if word[:1] == "-" else (1, word.removeprefix("+"))
        value = sign * int(digits, 16 if digits[:2] in ("0x", "0X") else 10)
    except ValueError:
        return _whole_float(word)
    return value if abs(value) < 2**64 else None


def _whole_float(word: str) -> int | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return int(value) if value.is_integer() and abs(value) < 2**53 else None
