"""What can go wrong, as one small tree.

    KennfeldError
    ├── InputError       a file, a formula or a project is wrong; carries every finding at once
    └── ArgumentError    the Python API was called with an unusable argument (also a ValueError)

`InputWarning` is the category of Python warnings about input that can be used, but perhaps not as it was meant.

A fit that does not converge is no exception: it is a `Result` whose status says so.

What every calibration format shares: the file as read, the notes taken on it, and what came out.

The text of a project file as plain tables; syntax errors with their line.
"""

import difflib
import re
from collections.abc import Iterable, Sequence
from heapq import nlargest
from itertools import pairwise

__all__ = ["count_noun", "holds_control_characters", "join_limited", "nearest", "one_line", "quoted"]

_MANY = 1000  # names, beyond which only those that share the most pairs of letters are compared in full

_CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]")
_SHOWN = 5  # names in a remark


def nearest(name: str, candidates: Iterable[str]) -> str:
    """A question that offers the most similar name, or an empty string.

    >>> nearest("Sped", ["Speed", "Load"])
    'Did you mean Speed?'
    """
    names = list(candidates)
    folded = {candidate.casefold(): candidate for candidate in names}
    wanted = name.casefold()
    close: Iterable[str] = folded
    if len(folded) > _MANY:  # a full comparison takes 20 us each, and a file may have 50 000 channels
        pairs = {*pairwise(wanted)}
        close = nlargest(_MANY, folded, key=lambda candidate: len(pairs.intersection(pairwise(candidate))))
    found = difflib.get_close_matches(wanted, close, n=1, cutoff=0.6)
    return f"Did you mean {folded[found[0]]}?" if found else ""


def holds_control_characters(text: str) -> bool:
    """Whether a text has characters that no line of a text file can hold."""
    return _CONTROL.search(text) is not None


def one_line(text: str) -> str:
    """The text with line breaks and other control characters turned into blanks."""
    return _CONTROL.sub(" ", text)


def count_noun(number: int, thing: str) -> str:
    """A number of things in words.

    >>> count_noun(1, "value"), count_noun(3, "value")
    ('1 value', '3 values')
    """
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def join_limited(names: Sequence[str]) -> str:
    """Return how many labels there are, and the first of their names.

    >>> join_limited(["a", "b"])
    '2 labels (a, b)'
    """
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"{count_noun(len(names), 'label')} ({', '.join(names[:_SHOWN])}{more})"


def quoted(name: str) -> str:
    r"""A name as a key of the file: in quotes where it needs them.

    >>> print(quoted("n_rpm"), quoted("air mass"), quoted(r"n\ETKC:1"))
    n_rpm "air mass" 'n\ETKC:1'
    """
    if name.replace("_", "a").replace("-", "a").isalnum() and name.isascii():
        return name
    return f"'{name}'" if "\\" in name or '"' in name else f'"{name}"'
