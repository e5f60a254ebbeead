"""`[parameters.NAME]` and `[axes.NAME]` of a project file, and the axes in them."""

from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.project.limit_sections import shape_ranges
from kennfeld.project.schema import DIRECTIONS, AxisEntry, Factor, Freedom, Lock, ParameterEntry, PinEntry, Range
from kennfeld.project.structuring import Section, array

__all__ = ["group_axis", "parameter_entry", "read_factor", "read_lock"]

_MOST_POINTS = 100_000
_WAYS = "{ input, breakpoints }, { input, begin, end, count }, { input, count }"
_FREE = "free"  # instead of breakpoints, or as a key beside them


def parameter_entry(name: str, section: Section) -> ParameterEntry:
    """One `[parameters.NAME]`."""
    extrapolation = section.choice("extrapolation", "clip", ("clip", "linear"))
    entry = ParameterEntry(
        place=section.place,
        name=name,
        axes=_axes(section),
        unit=section.free_text("unit"),
        description=section.free_text("description"),
        initial=_initial(section),
        free=section.flag("free"),
        bounds=_bounds(section),
        smoothness=_smoothness(section),
        lock=read_lock(section, "lock"),
        pins=_pins(section),
        gradient=shape_ranges(section, "gradient"),
        curvature=shape_ranges(section, "curvature"),
        extrapolation=None
        if "extrapolation" not in section.values
        else "linear"
        if extrapolation != "clip"
        else "clip",
    )
    section.end()
    return entry


def group_axis(name: str, section: Section) -> AxisEntry:
    """One `[axes.NAME]`."""
    made = _axis(section)
    section.end()
    return made


def _axes(section: Section) -> dict[str, AxisEntry]:
    made = {}
    for direction in DIRECTIONS:
        if not section.has(direction):
            continue
        given = section.values[direction]
        if isinstance(given, list):
            section.report(
                direction, "breakpoints alone are no axis", f"Write {direction} = {{ breakpoints = [...] }}."
            )
        elif inner := section.inner(direction):
            made[direction] = _axis(inner, grouped=True)
            inner.end()
    return made


def _axis(section: Section, *, grouped: bool = False) -> AxisEntry:
    quantity = section.text("input")
    freedom = _freedom(section)
    if grouped and section.has("axis"):
        if len(section.values) > 1:
            remedy = 'Write { axis = "..." } alone; what frees its breakpoints belongs into its section.'
            section.report("", "a group axis brings its own breakpoints", remedy)
        return AxisEntry(section.place, group=section.text("axis"))
    spread = {key: section.number(key, np.nan) for key in ("begin", "end") if section.has(key)}
    count = section.whole("count", 0, 2) if section.has("count") else 0
    if section.has("breakpoints") and section.values["breakpoints"] != _FREE:
        if spread or count:
            section.report("", "breakpoints stand beside begin, end or count", "Keep one of them.")
        return AxisEntry(section.place, quantity, _breakpoints(section), freedom=freedom)
    if count > _MOST_POINTS:
        section.report("count", f"{count} breakpoints are more than {_MOST_POINTS}")
    elif len(spread) == 2 and count:
        points = _even(section, spread["begin"], spread["end"], count)
        return AxisEntry(section.place, quantity, points, freedom=freedom)
    elif spread or ("count" not in section.values and freedom is None):
        ways = _WAYS + (' or { axis = "..." }' if grouped else "")
        section.report("", f"the axis has {_listed(section)}", f"Write {ways}.")
    return AxisEntry(section.place, quantity, quantiles=count, freedom=freedom)


def _freedom(section: Section) -> Freedom | None:
    """Whether breakpoints are fitted: `breakpoints = "free"` or `free = true`."""
    word = section.get("breakpoints") == _FREE
    flag = section.flag("free")
    if word and flag is False:
        section.report("free", 'breakpoints = "free" stands beside free = false', "Remove one of them.")
    distance = section.number("min_distance", 0.0, 0.0, above=True) or None if section.has("min_distance") else None
    ends = _ends(section)
    if word or flag or (flag is None and "free" in section.values):
        return Freedom(distance, ends)
    for key in ("min_distance", "range"):
        if key in section.values:
            section.report(key, "has a meaning for free breakpoints alone", "Write free = true beside it.")
    return None


def _ends(section: Section) -> tuple[float, float] | None:
    if not section.has("range"):
        return None
    ends = _numbers(section.values["range"])
    if ends is None or len(ends) != 2 or not ends[0] < ends[1]:
        section.report("range", "must be a lowest and a highest breakpoint", "Write range = [lowest, highest].")
        return None
    return ends[0], ends[1]


def _listed(section: Section) -> str:
    return f"{', '.join(section.values)} alone" if section.values else "no breakpoints"


def _even(section: Section, begin: float, end: float, count: int) -> tuple[float, ...]:
    if not begin < end:
        if np.isfinite(begin) and np.isfinite(end):
            section.report("end", f"{end:g} must lie above begin, {begin:g}", "Exchange them.")
        return ()
    return tuple(np.linspace(begin, end, count).tolist())


def _breakpoints(section: Section) -> tuple[float, ...]:
    given = array(section.get("breakpoints"))
    if isinstance(given, str):
        section.report("breakpoints", given)
    elif given.ndim != 1 or not np.all(np.isfinite(given)):
        section.report("breakpoints", "must be one list of finite numbers")
    else:
        falling = np.flatnonzero(np.diff(given) <= 0)
        if not falling.size:
            return tuple(given.tolist())
        at = int(falling[0])
        message = f"breakpoints must increase: number {at + 2} ({given[at + 1]:g}) does not exceed number {at + 1}"
        section.report("breakpoints", f"{message} ({given[at]:g})", "Sort them and remove equal ones.")
    return ()


def _initial(section: Section) -> Float | None:
    if not section.has("initial"):
        return None
    given = array(section.values["initial"])
    if isinstance(given, str):
        section.report("initial", given)
        return None
    if not np.all(np.isfinite(given)):
        at = tuple(int(i) + 1 for i in np.argwhere(~np.isfinite(given))[0])
        where = f" number {', '.join(map(str, at))}" if at else ""
        section.report("initial", f"value{where} is {given[tuple(i - 1 for i in at)]:g}", "Give a finite number.")
        return None
    return given


def _bounds(section: Section) -> tuple[Float, Float] | None:
    if not section.has("bounds"):
        return None
    given = section.values["bounds"]
    if not isinstance(given, list) or len(given) != 2:
        section.report("bounds", "must be a lower and an upper bound", "Write bounds = [lower, upper].")
        return None
    sides: list[Float] = []
    for word, value in zip(("lower", "upper"), given, strict=True):
        side = array(value)
        if isinstance(side, str):
            section.report("bounds", f"the {word} bound: {side}")
        elif np.isnan(side).any():
            section.report("bounds", f"the {word} bound is not a number", "Write inf or -inf for none.")
        else:
            sides.append(side)
    if len(sides) < 2 or _crossed(section, *sides):
        return None
    return sides[0], sides[1]


def _crossed(section: Section, lower: Float, upper: Float) -> bool:
    """Whether a lower bound lies above its upper one. Whether both fit the table is found where its axes are known."""
    if lower.ndim and upper.ndim and lower.shape != upper.shape:
        section.report("bounds", f"the sides have the shapes {list(lower.shape)} and {list(upper.shape)}")
        return True
    if not np.any(lower > upper):
        return False
    at = tuple(np.argwhere(lower > upper)[0])
    one, other = (np.broadcast_to(side, np.broadcast_shapes(lower.shape, upper.shape))[at] for side in (lower, upper))
    where = f" at value {', '.join(str(int(i) + 1) for i in at)}" if at else ""
    message = f"the lower bound {one:g} lies above the upper bound {other:g}{where}"
    section.report("bounds", message, "Exchange them.")
    return True


def _smoothness(section: Section) -> Factor | dict[str, Factor] | None:
    given = section.get("smoothness")
    if given is None:
        return None
    if isinstance(given, dict):
        inner = Section(given, f"{section.place} smoothness", section.findings)
        factors = {key: read_factor(inner, key) for key in DIRECTIONS if inner.has(key)}
        inner.end()
        return factors
    return read_factor(section, "smoothness")


def read_factor(section: Section, key: str) -> Factor:
    """A factor of smoothness: a number from 0 on, or "auto"."""
    given = section.get(key)
    if isinstance(given, str):
        if given != "auto":
            section.report(key, f"{given!r} is no factor", 'Write a number from 0 on, or "auto".')
        return "auto"
    return section.number(key, 0.0, 0.0)


def read_lock(section: Section, key: str) -> Lock:
    """A lock: true, false, "no-data" or a list of ranges."""
    given = section.get(key)
    if isinstance(given, bool) or given is None:
        return bool(given)
    if given == "no-data":
        return "no-data"
    if not isinstance(given, list) or not all(isinstance(part, dict) for part in given):
        remedy = 'Write true, "no-data" or a list of ranges, [{ x = [0, 10] }].'
        section.report(key, f"{given!r} is no lock", remedy)
        return False
    return tuple(
        _range(Section(part, f"{section.place} {key} {i}", section.findings)) for i, part in enumerate(given, 1)
    )


def _range(section: Section) -> Range:
    made = {}
    for direction in DIRECTIONS:
        if not section.has(direction):
            continue
        ends = _numbers(section.values[direction])
        if ends is None or len(ends) != 2 or not ends[0] <= ends[1]:
            section.report(direction, "must be a first and a last axis value", f"Write {direction} = [first, last].")
        else:
            made[direction] = (ends[0], ends[1])
    if not section.values:
        section.report("", "the range is empty", "Write lock = true for the whole table.")
    section.end()
    return made


def _pins(section: Section) -> tuple[PinEntry, ...]:
    given = section.get("pin")
    if given is None:
        return ()
    if not isinstance(given, list) or not all(isinstance(part, dict) for part in given):
        section.report("pin", f"{given!r} is no list of pins", "Write pin = [{ at = [...], value = ... }].")
        return ()
    return tuple(_pin(Section(part, f"{section.place} pin {i}", section.findings)) for i, part in enumerate(given, 1))


def _pin(section: Section) -> PinEntry:
    at: Any = section.get("at")
    coordinates = () if at is None else _numbers(at if isinstance(at, list) else [at])
    if coordinates is None:
        section.report("at", f"{at!r} is no list of coordinates", "Write at = [x, y], one an axis.")
    if not section.has("value"):
        section.report("value", "the key is missing", "Write value = ...")
    pin = PinEntry(coordinates or (), section.number("value", 0.0))
    section.end()
    return pin


def _numbers(given: Any) -> tuple[float, ...] | None:
    """A list of numbers; None where it is none. Infinite ones are allowed, as ends of a range."""
    if not isinstance(given, list):
        return None
    found = array(given) if given else np.zeros(0)
    return None if isinstance(found, str) or found.ndim != 1 or np.isnan(found).any() else tuple(found.tolist())
