"""Rows of numbers, which tell a table from languages whose statements a heading may resemble."""

import re

_SEPARATOR = re.compile(r"[,;\t|]")
_NUMBER = re.compile(r"[+-]?(?:\d[\d.]*|\.\d+)(?:[eE][+-]?\d+)?")


def is_row(line: str) -> bool:
    """Return whether a line holds separated numbers and nothing else.

    >>> is_row("0.1;1000;;80"), is_row("3 y[-] = 2 * x"), is_row("x = 3")
    (True, False, False)
    """
    first, *others = (cell.strip(' "') for cell in _SEPARATOR.split(line))
    numbers = all(not cell or _NUMBER.fullmatch(cell) for cell in others)
    return bool(others) and _NUMBER.fullmatch(first) is not None and numbers
