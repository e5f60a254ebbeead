"""The layout of a calibration workbook, which its writer and its reader share.

    Parameters   the index: a row for each parameter, with the sheet that holds its values
    Scalars      a row for each single value
    Texts        a row for each text
    Axes         a row for each group axis, where it is edited; tables hold formulas that follow it
    MapX         a sheet for each table: its axes, then the numbers

A table has x to the right and y down; the cell left above the numbers says so (`y down / x right`). Higher directions
are tables below each other, each with its breakpoints in a row `z | 0.5` before it.
"""

import re
from collections.abc import Iterable

from kennfeld.parameters import TextKind

__all__ = [
    "AXES",
    "AXES_HEADING",
    "AXIS_HEADING",
    "CORNERS",
    "INDEX",
    "INDEX_HEADING",
    "KINDS",
    "LETTERS",
    "SCALARS",
    "SCALARS_HEADING",
    "TEXTS",
    "TEXTS_HEADING",
    "TEXT_KINDS",
    "sheet_names",
]

INDEX, SCALARS, TEXTS, AXES = "Parameters", "Scalars", "Texts", "Axes"
_LABELS = ("functions", "display name", "variant")
INDEX_HEADING = ("name", "kind", "size", "unit", "description", *_LABELS, "sheet")
SCALARS_HEADING = ("name", "value", "unit", "description", *_LABELS, "size")
TEXTS_HEADING = ("name", "text", "description", *_LABELS)
AXES_HEADING = ("group axis", "unit", "input", "breakpoints")
AXIS_HEADING = ("axis", "input", "unit", "group axis")
CORNERS = ("x right", "y down / x right")  # of one direction, of two and more
TEXT_KINDS: tuple[TextKind, ...] = ("text", "enumeration", "boolean")
KINDS = ("scalar", "block", "curve", "map", "cube", *TEXT_KINDS)
LETTERS = "xyzw"
_LONGEST_NAME = 31  # characters, a limit of Excel
_UNFIT = re.compile(r"[\[\]:*?/\\\x00-\x1f]")


def sheet_names(names: Iterable[str]) -> list[str]:
    """A name that Excel accepts for each sheet, different from the others without regard to case.

    >>> sheet_names(["MapX", "mapx", "a[0]", "Axes"])
    ['MapX', 'mapx (2)', 'a(0)', 'Axes (2)']
    """
    taken = {name.casefold() for name in (INDEX, SCALARS, TEXTS, AXES, "History")}
    found = []
    for name in names:
        wanted = _UNFIT.sub("_", name.replace("[", "(").replace("]", ")")).strip("' ") or "_"
        made, count = wanted[:_LONGEST_NAME].rstrip("' "), 1
        while made.casefold() in taken or not made:
            count += 1
            ending = f" ({count})"
            made = wanted[: _LONGEST_NAME - len(ending)] + ending
        taken.add(made.casefold())
        found.append(made)
    return found
