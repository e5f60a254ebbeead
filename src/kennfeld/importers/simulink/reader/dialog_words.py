"""Words that the user picks in a dialog, such as "on" or "Clip".

Releases of Simulink differ in their capitals ("Expression" became "expression") and spaces, and scripts that write
models set what they like: `set_param` accepts any. So no word is compared but here.
"""

import re
from collections.abc import Iterable
from functools import cache


def match_word(written: str, words: Iterable[str]) -> str | None:
    """Find the word that a text spells, whatever its capitals and spaces; None if it is another one.

    >>> match_word("Expression", ("expression", "label")), match_word("Inherit:auto", ["Inherit: auto"])
    ('expression', 'Inherit: auto')
    """
    # an exact match takes precedence, in case two words differ in capitals only
    known, text = tuple(words), written.strip()
    if text in known:
        return text
    plain = _plain(text)
    return next((word for word in known if _plain(word) == plain), None)


def begins_with_word(written: str, word: str) -> bool:
    """Tell whether a text begins with a word, whatever its capitals and spaces.

    >>> begins_with_word("matrix (K*u)", "Matrix"), begins_with_word("Inherited", "Inherit")
    (True, False)
    """
    return _beginning(word).match(written) is not None


def after_word(written: str, *words: str) -> str | None:
    """Return what follows the first of some words that a text begins with, None if it begins otherwise.

    >>> after_word("bus : Engine", "Bus:"), after_word("Engine", "Bus:")
    ('Engine', None)
    """
    matches = (_beginning(word).match(written) for word in words)
    return next((written[match.end() :].strip() for match in matches if match is not None), None)


def contains_word(written: str, word: str) -> bool:
    """Tell whether a text contains a word anywhere, whatever its capitals and spaces."""
    return _plain(word) in _plain(written)


@cache
def _plain(text: str) -> str:
    """Return a text without what releases differ in."""
    return "".join(text.split()).casefold()


@cache
def _beginning(word: str) -> re.Pattern[str]:
    parts = re.findall(r"\w+|[^\w\s]", word)
    end = r"(?!\w)" if re.match(r"\w", parts[-1]) else ""
    return re.compile(r"\s*" + r"\s*".join(map(re.escape, parts)) + end, re.IGNORECASE)
