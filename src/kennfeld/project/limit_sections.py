"""Reads `[[limit]]`, `[[equality]]`, and the ranges of slopes and curvatures in `[parameters.NAME]`."""

import math
from typing import Any

from kennfeld.project.schema import DIRECTIONS, EqualityEntry, LimitEntry, TermEntry
from kennfeld.project.structuring import Section, as_number


def read_limit(section: Section) -> LimitEntry:
    """Read one `[[limit]]`: bounds of an output."""
    if not section.has("node"):
        section.report("node", "the key is missing", 'Write node = "...", a node or an expression.')
    if not section.has("min") and not section.has("max"):
        section.report("max", "min and max are missing", "Write max = ... or min = ...")
    lower, upper = section.number("min", -math.inf), section.number("max", math.inf)
    if lower > upper:
        section.report("min", f"min = {lower:g} exceeds max = {upper:g}", "Swap them.")
        lower, upper = upper, lower
    entry = LimitEntry(section.place, section.text("node"), lower, upper, section.text("where"))
    section.end()
    return entry


def read_equality(section: Section) -> EqualityEntry:
    """Read one `[[equality]]`: terms that sum to a value."""
    tables = section.get("terms")
    terms: tuple[TermEntry, ...] = ()
    if not isinstance(tables, list) or not tables or not all(isinstance(part, dict) for part in tables):
        remedy = 'Write terms = [{ parameter = "...", at = [...], factor = 1 }, ...].'
        section.report(
            "terms", "the key is missing" if tables is None else f"must be a list of terms, got {tables!r}", remedy
        )
    else:
        terms = tuple(
            _term(Section(part, f"{section.place} term {i}", section.findings)) for i, part in enumerate(tables, 1)
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
        numbers = [as_number(x) for x in (at if isinstance(at, list) else [at])]
        if any(x is None or not math.isfinite(x) for x in numbers):
            section.report("at", f"must be a list of coordinates, got {at!r}", "Write at = [x, y], one per axis.")
        coordinates = tuple(x for x in numbers if x is not None)
    entry = TermEntry(section.text("parameter"), coordinates, section.number("factor", 1.0))
    section.end()
    return entry


def read_ranges(section: Section, key: str) -> dict[str, tuple[float, float]]:
    """Read the range of each direction, as in `gradient = { x = [0, inf] }`; `key` is `gradient` or `curvature`."""
    if not section.has(key):
        return {}
    inner = section.inner(key)
    if inner is None:
        return {}
    ranges = {}
    for direction in DIRECTIONS:
        if inner.has(direction):
            value = inner.values[direction]
            ends = [_side(x) for x in value] if isinstance(value, list) else []
            if len(ends) != 2 or any(math.isnan(x) for x in ends):
                remedy = f"Write {direction} = [0, inf]; a limit of 0 makes the table monotonic."
                inner.report(direction, f"must be a range of two numbers, got {value!r}", remedy)
            elif not ends[0] <= ends[1]:
                inner.report(direction, f"lower limit {ends[0]:g} exceeds upper limit {ends[1]:g}", "Swap them.")
            else:
                ranges[direction] = (ends[0], ends[1])
    inner.end()
    return ranges


def _side(value: Any) -> float:
    """Return a number, which may be infinite or "inf", NaN for anything else."""
    if isinstance(value, str) and value.strip().casefold() in ("inf", "+inf", "-inf"):
        return float(value)
    number = as_number(value)
    return math.nan if number is None else number
