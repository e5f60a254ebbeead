"""Texts of CSV files that a spreadsheet does not take for formulas.

Names and units come from files of others. A spreadsheet evaluates a cell that begins with `=`, `+`, `-` or `@`, which
can start programs or send data away. An apostrophe in front makes it a text there, as in Excel itself.
"""

MARK = "'"
# the list of OWASP, "CSV Injection"
_BEGINS = ("=", "+", "-", "@", "\t", "\r")


def neutral_cell(text: str) -> str:
    """Return a text that no spreadsheet evaluates; a single character, such as the unit `-`, stays.

    >>> neutral_cell("=cmd|' /C calc'!A0"), neutral_cell("-"), neutral_cell("1/min")
    ("'=cmd|' /C calc'!A0", '-', '1/min')
    """
    return f"{MARK}{text}" if len(text) > 1 and text.lstrip(MARK).startswith(_BEGINS) else text


def original_cell(text: str) -> str:
    """Return the text that `neutral_cell` was given.

    >>> original_cell(neutral_cell("=K")), original_cell(neutral_cell("'=K")), original_cell("K")
    ('=K', "'=K", 'K')
    """
    return text[1:] if text.startswith(MARK) and text.lstrip(MARK).startswith(_BEGINS) else text
