"""`[[limit]]` and `[[equality]]` of a project file, and the shapes of a `[parameters.NAME]`."""

import math
from typing import Any

from kennfeld.project.schema import DIRECTIONS, EqualityEntry, LimitEntry, TermEntry
from kennfeld.project.structuring import Section, numeric

__all__ = ["equality_entry", "limit_entry", "shape_ranges"]


def limit_entry(section: Section) -> LimitEntry:
    """One `[[limit]]`: bounds of an output."""
    if not section.has("node"):
        section.report("node", "the key is missing", 'Write node = "..."; an expression may stand there.')
    if not section.has("min") and not section.has("max"):
        section.report("max", "neither min nor max is given", "Write max = ... or min = ...")
    lower, upper = section.number("min", -math.inf), section.number("max", math.inf)
    if lower > upper:
        section.report("min", f"{lower:g} lies above max, {upper:g}", "Exchange them.")
        lower, upper = upper, lower
    entry = LimitEntry(section.place, section.text("node"), lower, upper, section.text("where"))
    section.end()
    return entry


def equality_entry(section: Section) -> EqualityEntry:
    """One `[[equality]]`: terms that sum to a value."""
    given = section.get("terms")
    terms: tuple[TermEntry, ...] = ()
    if not isinstance(given, list) or not given or not all(isinstance(part, dict) for part in given):
        remedy = 'Write terms = [{ parameter = "...", at = [...], factor = 1 }, ...].'
        section.report("terms", "is missing" if given is None else f"{given!r} is no list of terms", remedy)
    else:
        terms = tuple(
            _term(Section(part, f"{section.place} term {i}", section.findings)) for i, part in enumerate(given, 1)
        )
    entry = EqualityEntry(section.place, terms, section.number("value", 0.0))
    section.end()
    return entry


def _term(section: Section) -> TermEntry:
    if not section.has("parameter"):
        section.report("parameter", "the key is missing", 'Write parameter = "...".')
    at: Any = section.get("at")
    coordinates = None
    if at is not None:
        numbers = [numeric(x) for x in (at if isinstance(at, list) else [at])]
        if any(x is None or not math.isfinite(x) for x in numbers):
            section.report("at", f"{at!r} is no list of coordinates", "Write at = [x, y], one an axis.")
        coordinates = tuple(x for x in numbers if x is not None)
    entry = TermEntry(section.text("parameter"), coordinates, section.number("factor", 1.0))
    section.end()
    return entry


def shape_ranges(section: Section, key: str) -> dict[str, tuple[float, float]]:
    """`gradient = { x = [0, inf] }`: the range of each direction; `key` is `gradient` or `curvature`."""
    if not section.has(key):
        return {}
    inner = section.inner(key)
    if inner is None:
        return {}
    made = {}
    for direction in DIRECTIONS:
        if inner.has(direction):
            given = inner.values[direction]
            ends = [_side(x) for x in given] if isinstance(given, list) else []
            if len(ends) != 2 or any(math.isnan(x) for x in ends):
                remedy = f"Write {direction} = [0, inf]; one side 0 makes it monotonic."
                inner.report(direction, f"{given!r} is no range of two numbers", remedy)
            elif not ends[0] <= ends[1]:
                inner.report(direction, f"{ends[0]:g} lies above {ends[1]:g}", "Exchange them.")
            else:
                made[direction] = (ends[0], ends[1])
    inner.end()
    return made


def _side(value: Any) -> float:
    """A number, also an infinite one or one written as text; NaN where it is none."""
    if isinstance(value, str) and value.strip().casefold() in ("inf", "+inf", "-inf"):
        return float(value)
    number = numeric(value)
    return math.nan if number is None else number
