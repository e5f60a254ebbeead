"""Names of variables and fields of structs in MATLAB."""

import re
from itertools import chain, count

_WORDS = "break case catch classdef continue else elseif end for function global if otherwise parfor persistent return"
KEYWORDS = frozenset(f"{_WORDS} spmd switch try while".split())
_MAX_LENGTH = 63
_ROOM = 8  # for the number of a name that is taken


def variable_name(name: str, used: set[str], prefix: str = "x") -> str:
    """Return a valid name that is not used yet, and add it to the used ones; the same name if it is valid.

    Args:
        name: any name.
        used: names that are taken, such as `KEYWORDS`.
        prefix: begins a name that would not begin with a letter.

    >>> variable_name("1 Öl/T", set()), variable_name("end", {"end"})
    ('x1__l_T', 'end_2')
    """
    if re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) and len(name) <= _MAX_LENGTH and name not in used:
        used.add(name)
        return name
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[: _MAX_LENGTH - _ROOM]
    plain = plain if re.match(r"[A-Za-z]", plain) else f"{prefix}{plain}"
    candidates = chain([plain], (f"{plain}_{number}" for number in count(2)))
    result = next(candidate for candidate in candidates if candidate not in used)
    used.add(result)
    return result
