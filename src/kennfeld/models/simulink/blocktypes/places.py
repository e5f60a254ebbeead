"""The places that a block selects or assigns along the dimensions of an array."""

import re

from kennfeld.errors import InputError
from kennfeld.matlab import syntax as m
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.files.tree import parted
from kennfeld.models.simulink.weaving.registry import UnsupportedError
from kennfeld.models.simulink.weaving.site import Site

__all__ = ["cases_of", "length_of", "listed", "positions", "within"]

_MOST_NUMBERS = 10_000


def listed(site: Site, *names: str) -> list[str]:
    """A setting for each dimension, separated by commas or quoted; the first that the file states."""
    written = next((text for name in names if (text := site.text(name, ""))), "")
    quoted = re.findall(r"'([^']*)'", written)
    return quoted or [part.strip() for part in parted(written) if part.strip()]


def positions(site: Site, option: str, text: str, size: int, axis: int, count: int | None = None) -> list[int]:
    """The places along a dimension of some size, counted from 0.

    From a starting index there are as many as `count`, or as the file says.
    """
    if option == "Select all":
        return list(range(size))
    if option not in ("Index vector (dialog)", "Starting index (dialog)"):
        raise UnsupportedError(f"it selects by {option!r}, which is not supported")
    first = 0 if site.text("IndexMode").startswith("Zero") else 1
    places = [int(n) - first for n in site.evaluated(text).ravel()]
    if option == "Starting index (dialog)" and places:
        length = length_of(site, axis) if count is None else count
        places = list(range(places[0], places[0] + min(length, size + 1)))
    elif places == [-1 - first]:
        return list(range(size))
    within(places, size, text)
    return places


def length_of(site: Site, axis: int) -> int:
    """How many elements the file says to take along a dimension."""
    sizes = listed(site, "OutputSizes", "OutputSizeArray")
    return int(site.evaluated(sizes[axis]).item()) if axis < len(sizes) else 1


def within(places: list[int], size: int, text: str) -> None:
    """Raise `UnsupportedError` where a place is none of an array's."""
    if not places or not all(0 <= place < size for place in places):
        raise UnsupportedError(f"it selects {text[:60]} of {size} elements")


def cases_of(site: Site, field: str) -> list[list[float]]:
    """The numbers in each part of a list in braces, `{1, [2 3], Gear.First}`."""
    text = site.text(field)
    try:
        tree = parse_expression(text)
    except InputError:
        tree = m.Number(0.0)
    if not isinstance(tree, m.CellArray):
        raise UnsupportedError(f"{field} is {text[:60]}, not a list of cases in braces")
    parts = [part for row in tree.rows for part in row]
    try:
        found = [site.weaver.expressions.tree_numbers(one, site.atom.scope).ravel().tolist() for one in parts]
    except NoValueError as error:
        raise UnsupportedError(f"its {field} ({text[:60]}) has no value: {error}", undefined=error.undefined) from None
    if sum(map(len, found)) > _MOST_NUMBERS:
        raise UnsupportedError(f"{field} has {sum(map(len, found))} numbers; {_MOST_NUMBERS} are the most")
    if not all(found):
        raise UnsupportedError(f"{field} is {text[:60]}, which has an empty part")
    return found
