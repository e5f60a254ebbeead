"""Text for messages: similar names, short lists, counts, numbers, sizes and quotes."""

import difflib
import json
import math
import re
from collections.abc import Collection, Iterable, Sequence
from heapq import nlargest
from itertools import islice, pairwise

_MAX_COMPARED = 1000  # names; of more, only those that share the most pairs of letters are compared in full
_MAX_LABELS = 5  # names of labels in a message
_CONTROL = re.compile(r"[\x00-\x1f\x7f\ud800-\udfff]")
_MOST_OF_REASON = 160  # characters


def nearest(name: str, candidates: Iterable[str]) -> str:
    """Return a question that offers the most similar name, or an empty string.

    >>> nearest("Sped", ["Speed", "Load"])
    'Did you mean Speed?'
    """
    similar = most_similar(name, candidates)
    return f"Did you mean {similar}?" if similar else ""


def most_similar(name: str, candidates: Iterable[str]) -> str:
    """Return the most similar name, or an empty string if none is similar.

    >>> most_similar("Sped", ["Speed", "Load"])
    'Speed'
    """
    names = list(candidates)
    folded = {candidate.casefold(): candidate for candidate in names}
    wanted = name.casefold()
    close: Iterable[str] = folded
    if len(folded) > _MAX_COMPARED:  # a full comparison takes 20 us each, and a file may have 50 000 channels
        pairs = {*pairwise(wanted)}
        close = nlargest(_MAX_COMPARED, folded, key=lambda candidate: len(pairs.intersection(pairwise(candidate))))
    matches = difflib.get_close_matches(wanted, close, n=1, cutoff=0.6)
    return folded[matches[0]] if matches else ""


def holds_control_characters(text: str) -> bool:
    """Return whether a text has characters that a line of a text file cannot hold."""
    return _CONTROL.search(text) is not None


def one_line(text: str) -> str:
    """Return the text with line breaks and other control characters replaced by blanks."""
    return _CONTROL.sub(" ", text)


def reason_of(error: Exception) -> str:
    r"""Return the message of a library's error as one short line: it may quote the file; its type if it has none.

    >>> reason_of(ValueError("no\n  end"))
    'no end'
    """
    return " ".join(str(error).split())[:_MOST_OF_REASON] or type(error).__name__


def count_noun(number: int, thing: str) -> str:
    """Return a count with its noun, in the plural unless it is 1.

    >>> count_noun(1, "value"), count_noun(3, "value")
    ('1 value', '3 values')
    """
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


def count_labels(names: Sequence[str]) -> str:
    """Return the number of labels and the first of their names.

    >>> count_labels(["a", "b"])
    '2 labels (a, b)'
    """
    return f"{count_noun(len(names), 'label')} ({join_names(names, _MAX_LABELS)})"


def join_names(names: Collection[str], limit: int = 8, separator: str = ", ") -> str:
    """Return the first `limit` names, and the number of the others.

    >>> join_names(["a", "b", "c", "d"], 2)
    'a, b and 2 more'
    """
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return separator.join(islice(names, limit)) + more


def shorten(lines: Sequence[str], limit: int, pointer: str = "") -> list[str]:
    """Return the first `limit` lines, and one with the number of the others and a pointer to them.

    >>> shorten(["a", "b", "c", "d"], 2, "; see result.json")
    ['a', 'b', 'and 2 more; see result.json']
    """
    return [*lines[:limit], *count_more(len(lines) - limit, pointer)]


def count_more(count: int, pointer: str = "") -> list[str]:
    """Return a line with the number of entries that are not listed, none if all are."""
    return [f"and {count} more{pointer}"] if count > 0 else []


def under_heading(heading: str, lines: Sequence[str]) -> list[str]:
    """Return indented lines below a heading; nothing without lines.

    >>> under_heading("Warnings:", ["a", "b"]), under_heading("Warnings:", [])
    (['Warnings:', '  a', '  b'], [])
    """
    return [heading, *(f"  {line}" for line in lines)] if lines else []


def number_text(value: float | None) -> str:
    """Return a number with six digits, nothing if it is unknown."""
    return "" if value is None or math.isnan(value) else f"{value:.6g}"


def size_text(shape: Iterable[int]) -> str:
    """Return a shape as `18 x 14`."""
    return " x ".join(map(str, shape))


def quoted(name: str) -> str:
    r"""Return a name as a TOML key, in quotes if it needs them.

    >>> print(quoted("n_rpm"), quoted("air mass"), quoted(r"n\ETKC:1"), quoted(r"driver's\n"))
    n_rpm "air mass" 'n\ETKC:1' "driver's\\n"
    """
    if name.replace("_", "a").replace("-", "a").isalnum() and name.isascii():
        return name
    # single quotes spare the escapes, but cannot hold all characters
    is_literal = ("\\" in name or '"' in name) and "'" not in name and not holds_control_characters(name)
    return f"'{name}'" if is_literal else toml_text(name)


def toml_text(text: str) -> str:
    r"""Return a text as a string of TOML, which Python reads, too.

    >>> print(toml_text("bar"), toml_text('5" pipe'))
    "bar" "5\" pipe"
    """
    # strings of JSON are strings of TOML, except that TOML does not allow DEL
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
