"""Reads `[parameters.NAME]` and `[axes.NAME]` of a project file, and the axes in them."""

from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.project.limit_sections import read_ranges
from kennfeld.project.schema import DIRECTIONS, AxisEntry, Factor, Freedom, Lock, ParameterEntry, PinEntry, Range
from kennfeld.project.structuring import Section, as_array

_MAX_BREAKPOINTS = 100_000
_AXIS_FORMS = "{ input, breakpoints }, { input, begin, end, count }, { input, count }"
_FREE = "free"  # in place of breakpoints, or as a key


def read_parameter(name: str, section: Section) -> ParameterEntry:
    """Read one `[parameters.NAME]`."""
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
        gradient=read_ranges(section, "gradient"),
        curvature=read_ranges(section, "curvature"),
        extrapolation=None
        if "extrapolation" not in section.values
        else "linear"
        if extrapolation != "clip"
        else "clip",
    )
    section.end()
    return entry


def read_group_axis(name: str, section: Section) -> AxisEntry:
    """Read one `[axes.NAME]`."""
    axis = _axis(section)
    section.end()
    return axis


def _axes(section: Section) -> dict[str, AxisEntry]:
    axes = {}
    for direction in DIRECTIONS:
        if not section.has(direction):
            continue
        value = section.values[direction]
        if isinstance(value, list):
            section.report(direction, "must be a table, got a list", f"Write {direction} = {{ breakpoints = [...] }}.")
        elif inner := section.inner(direction):
            axes[direction] = _axis(inner, grouped=True)
            inner.end()
    return axes


def _axis(section: Section, *, grouped: bool = False) -> AxisEntry:
    quantity = section.text("input")
    freedom = _freedom(section)
    if grouped and section.has("axis"):
        if len(section.values) > 1:
            remedy = 'Write { axis = "..." } alone; its breakpoints are set in its own section.'
            section.report("", "the keys of a group axis belong in its own section", remedy)
        return AxisEntry(section.place, group=section.text("axis"))
    spread = {key: section.number(key, np.nan) for key in ("begin", "end") if section.has(key)}
    count = section.whole("count", 0, 2) if section.has("count") else 0
    if section.has("breakpoints") and section.values["breakpoints"] != _FREE:
        if spread or count:
            section.report("", "breakpoints contradict begin, end and count", "Keep one of them.")
        return AxisEntry(section.place, quantity, _breakpoints(section), freedom=freedom)
    if count > _MAX_BREAKPOINTS:
        section.report("count", f"must be <= {_MAX_BREAKPOINTS}, got {count}")
    elif len(spread) == 2 and count:
        points = _even(section, spread["begin"], spread["end"], count)
        return AxisEntry(section.place, quantity, points, freedom=freedom)
    elif spread or ("count" not in section.values and freedom is None):
        forms = _AXIS_FORMS + (' or { axis = "..." }' if grouped else "")
        section.report("", f"the axis has {_present_keys(section)}", f"Write {forms}.")
    return AxisEntry(section.place, quantity, quantiles=count, freedom=freedom)


def _freedom(section: Section) -> Freedom | None:
    """Return the constraints on breakpoints that are fitted (`breakpoints = "free"` or `free = true`), else None."""
    word = section.get("breakpoints") == _FREE
    flag = section.flag("free")
    if word and flag is False:
        section.report("free", 'breakpoints = "free" contradicts free = false', "Remove one of them.")
    distance = section.number("min_distance", 0.0, 0.0, above=True) or None if section.has("min_distance") else None
    ends = _ends(section)
    if word or flag or (flag is None and "free" in section.values):
        return Freedom(distance, ends)
    for key in ("min_distance", "range"):
        if key in section.values:
            section.report(key, "requires free breakpoints", "Write free = true, or remove it.")
    return None


def _ends(section: Section) -> tuple[float, float] | None:
    if not section.has("range"):
        return None
    ends = _numbers(section.values["range"])
    if ends is None or len(ends) != 2 or not ends[0] < ends[1]:
        section.report("range", "must be the lowest and the highest breakpoint", "Write range = [lowest, highest].")
        return None
    return ends[0], ends[1]


def _present_keys(section: Section) -> str:
    return f"only {', '.join(section.values)}" if section.values else "no breakpoints"


def _even(section: Section, begin: float, end: float, count: int) -> tuple[float, ...]:
    if not begin < end:
        if np.isfinite(begin) and np.isfinite(end):
            section.report("end", f"must be > begin = {begin:g}, got {end:g}", "Swap them.")
        return ()
    return tuple(np.linspace(begin, end, count).tolist())


def _breakpoints(section: Section) -> tuple[float, ...]:
    points = as_array(section.get("breakpoints"))
    if isinstance(points, str):
        section.report("breakpoints", points)
    elif points.ndim != 1 or not np.all(np.isfinite(points)):
        section.report("breakpoints", "must be a list of finite numbers")
    else:
        falling = np.flatnonzero(np.diff(points) <= 0)
        if not falling.size:
            return tuple(points.tolist())
        at = int(falling[0])
        message = (
            f"must increase strictly: breakpoint {at + 2} ({points[at + 1]:g}) does not exceed breakpoint {at + 1}"
        )
        section.report("breakpoints", f"{message} ({points[at]:g})", "Sort them and remove duplicates.")
    return ()


def _initial(section: Section) -> Float | None:
    if not section.has("initial"):
        return None
    values = as_array(section.values["initial"])
    if isinstance(values, str):
        section.report("initial", values)
        return None
    if not np.all(np.isfinite(values)):
        at = tuple(int(i) + 1 for i in np.argwhere(~np.isfinite(values))[0])
        where = f" number {', '.join(map(str, at))}" if at else ""
        section.report("initial", f"value{where} must be finite, got {values[tuple(i - 1 for i in at)]:g}")
        return None
    return values


def _bounds(section: Section) -> tuple[Float, Float] | None:
    if not section.has("bounds"):
        return None
    pair = section.values["bounds"]
    if not isinstance(pair, list) or len(pair) != 2:
        section.report("bounds", "must be a lower and an upper bound", "Write bounds = [lower, upper].")
        return None
    sides: list[Float] = []
    for word, value in zip(("lower", "upper"), pair, strict=True):
        side = as_array(value)
        if isinstance(side, str):
            section.report("bounds", f"{word} bound: {side}")
        elif np.isnan(side).any():
            section.report("bounds", f"{word} bound: must be a number, got nan", "Write inf or -inf for no bound.")
        else:
            sides.append(side)
    if len(sides) < 2 or _crossed(section, *sides):
        return None
    return sides[0], sides[1]


def _crossed(section: Section, lower: Float, upper: Float) -> bool:
    """Report a lower bound above its upper bound. `parameter_tables` checks the shapes against the table."""
    if lower.ndim and upper.ndim and lower.shape != upper.shape:
        section.report(
            "bounds", f"lower and upper bounds have different shapes, {list(lower.shape)} and {list(upper.shape)}"
        )
        return True
    if not np.any(lower > upper):
        return False
    at = tuple(np.argwhere(lower > upper)[0])
    low, high = (np.broadcast_to(side, np.broadcast_shapes(lower.shape, upper.shape))[at] for side in (lower, upper))
    where = f" at value {', '.join(str(int(i) + 1) for i in at)}" if at else ""
    message = f"lower bound {low:g} exceeds upper bound {high:g}{where}"
    section.report("bounds", message, "Swap them.")
    return True


def _smoothness(section: Section) -> Factor | dict[str, Factor] | None:
    value = section.get("smoothness")
    if value is None:
        return None
    if isinstance(value, dict):
        inner = Section(value, f"{section.place} smoothness", section.findings)
        factors = {key: read_factor(inner, key) for key in DIRECTIONS if inner.has(key)}
        inner.end()
        return factors
    return read_factor(section, "smoothness")


def read_factor(section: Section, key: str) -> Factor:
    """Read a smoothness factor, a number >= 0 or "auto"."""
    value = section.get(key)
    if isinstance(value, str):
        if value != "auto":
            section.report(key, f'must be a number >= 0 or "auto", got {value!r}')
        return "auto"
    return section.number(key, 0.0, 0.0)


def read_lock(section: Section, key: str) -> Lock:
    """Read a lock: true, false, "no-data" or a list of ranges."""
    value = section.get(key)
    if isinstance(value, bool) or value is None:
        return bool(value)
    if value == "no-data":
        return "no-data"
    if not isinstance(value, list) or not all(isinstance(part, dict) for part in value):
        remedy = 'Write true, "no-data" or a list of ranges, [{ x = [0, 10] }].'
        section.report(key, f"must be a lock, got {value!r}", remedy)
        return False
    return tuple(
        _range(Section(part, f"{section.place} {key} {i}", section.findings)) for i, part in enumerate(value, 1)
    )


def _range(section: Section) -> Range:
    ranges = {}
    for direction in DIRECTIONS:
        if not section.has(direction):
            continue
        ends = _numbers(section.values[direction])
        if ends is None or len(ends) != 2 or not ends[0] <= ends[1]:
            section.report(
                direction, "must be the first and the last axis value", f"Write {direction} = [first, last]."
            )
        else:
            ranges[direction] = (ends[0], ends[1])
    if not section.values:
        section.report("", "the range is empty", "Write lock = true for the whole table.")
    section.end()
    return ranges


def _pins(section: Section) -> tuple[PinEntry, ...]:
    tables = section.get("pin")
    if tables is None:
        return ()
    if not isinstance(tables, list) or not all(isinstance(part, dict) for part in tables):
        section.report("pin", f"must be a list of pins, got {tables!r}", "Write pin = [{ at = [...], value = ... }].")
        return ()
    return tuple(_pin(Section(part, f"{section.place} pin {i}", section.findings)) for i, part in enumerate(tables, 1))


def _pin(section: Section) -> PinEntry:
    at: Any = section.get("at")
    coordinates = () if at is None else _numbers(at if isinstance(at, list) else [at])
    if coordinates is None:
        section.report("at", f"must be a list of coordinates, got {at!r}", "Write at = [x, y], one per axis.")
    if not section.has("value"):
        section.report("value", "the key is missing", "Write value = ...")
    pin = PinEntry(coordinates or (), section.number("value", 0.0))
    section.end()
    return pin


def _numbers(value: Any) -> tuple[float, ...] | None:
    """Return a list of numbers, which may be infinite, None for anything else."""
    if not isinstance(value, list):
        return None
    numbers = as_array(value) if value else np.zeros(0)
    return None if isinstance(numbers, str) or numbers.ndim != 1 or np.isnan(numbers).any() else tuple(numbers.tolist())
