"""Tokens of a text by a regular expression whose named groups are their kinds."""

import re
from collections.abc import Collection, Iterator
from typing import NamedTuple


class ScannedToken(NamedTuple):
    """A token: its kind, its text, and the offset of its first character."""

    kind: str
    text: str
    offset: int = 0


def scan_tokens(pattern: re.Pattern[str], text: str, skipped: Collection[str] = ("blank",)) -> Iterator[ScannedToken]:
    """Yield the tokens of a text without those of the skipped kinds.

    A pattern should match at each character, with a kind of its own for what the language does not know.

    >>> pattern = re.compile(r"(?P<name>[a-z]+)|(?P<blank> +)|(?P<bad>.)")
    >>> [token.kind for token in scan_tokens(pattern, "a bc?")]
    ['name', 'name', 'bad']
    """
    for match in pattern.finditer(text):
        kind = match.lastgroup or ""
        if kind not in skipped:
            yield ScannedToken(kind, match[kind], match.start(kind))
