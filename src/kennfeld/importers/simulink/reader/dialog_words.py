"""Words that the user picks in a dialog, such as "on" or "Clip".

Releases of Simulink differ in their capitals ("Expression" became "expression"), and scripts that write models set
what they like: `set_param` accepts any. So no word is compared but here.
"""

from collections.abc import Iterable


def match_word(written: str, words: Iterable[str]) -> str | None:
    """Find the word that a text spells, whatever its capitals and the spaces around it; None if it is another one.

    >>> match_word("Expression", ("expression", "label"))
    'expression'
    """
    # an exact match takes precedence, in case two words differ in capitals only
    known, text = tuple(words), written.strip()
    if text in known:
        return text
    return next((word for word in known if word.casefold() == text.casefold()), None)


def begins_with_word(written: str, word: str) -> bool:
    """Tell whether a text begins with a word, whatever its capitals."""
    return written.strip().casefold().startswith(word.casefold())
