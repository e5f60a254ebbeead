"""Rows of numbers, which tell a table from languages whose statements a heading may resemble."""

import re

_NUMBER = r"[+-]?(?:\d[\d.]*|\.\d+)(?:[eE][+-]?\d+)?"
_ROW = re.compile(rf"\s*\"?{_NUMBER}\"?\s*(?:[,;\t|]\s*\"?(?:{_NUMBER})?\"?\s*)+")


def is_row(line: str) -> bool:
    """Return whether a line holds separated numbers and nothing else.

    >>> is_row("0.1;1000;;80"), is_row("3 y[-] = 2 * x"), is_row("x = 3")
    (True, False, False)
    """
    return _ROW.fullmatch(line) is not None
