"""Reads `[[step]]` of a project file."""

from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from kennfeld.project.schema import DIRECTIONS, Lock, StepEntry
from kennfeld.project.structuring import Section
from kennfeld.project.table_sections import read_factor, read_lock

Value = TypeVar("Value")


def read_steps(root: Section) -> tuple[StepEntry, ...]:
    """Read the steps of a sequence."""
    return tuple(_step(section) for section in root.sections("step"))


def _step(section: Section) -> StepEntry:
    continuation = section.choice("continuation", "", ("auto", "off"))
    entry = StepEntry(
        place=section.place,
        name=section.text("name"),
        free=section.texts("free") if section.has("free") else None,
        lock=_locks(section),
        smoothness=_by_axis(section, "smoothness", read_factor),
        grid_reduction=_by_axis(section, "grid_reduction", partial(Section.whole, default=1, least=1)),
        criteria=_criteria(section),
        max_iterations=section.whole("max_iterations", 0, 1) or None,
        tolerance=section.number("tolerance", 0.0, 0.0, above=True) or None,
        continuation="auto" if continuation == "auto" else "off" if continuation == "off" else None,
    )
    section.end()
    return entry


def _locks(section: Section) -> dict[str, Lock]:
    if not section.has("lock"):
        return {}
    inner = section.inner("lock")
    return {name: read_lock(inner, name) for name in inner.values} if inner else {}


def _by_axis(
    section: Section, key: str, read: Callable[[Section, str], Value]
) -> Value | dict[str, Value | dict[str, Value]] | None:
    """Read a value for all tables, or by parameter a value or one per axis."""
    setting = section.get(key)
    if setting is None:
        return None
    if not isinstance(setting, dict):
        return read(section, key)
    inner = Section(setting, f"{section.place} {key}", section.findings)
    values: dict[str, Value | dict[str, Value]] = {}
    for name, value in setting.items():
        if isinstance(value, dict):
            axes = Section(value, f"{inner.place} {name}", section.findings)
            values[name] = {axis: read(axes, axis) for axis in DIRECTIONS if axes.has(axis)}
            axes.end()
        else:
            values[name] = read(inner, name)
    return values


def _criteria(section: Section) -> tuple[str | int, ...] | dict[str | int, float] | None:
    """Read nodes or numbers of criteria, or their weights by node."""
    setting: Any = section.get("criteria")
    if setting is None:
        return None
    if isinstance(setting, dict):
        inner = Section(setting, f"{section.place} criteria", section.findings)
        return {(int(name) if name.isdecimal() else name): inner.number(name, 0.0, 0.0) for name in setting}
    items = setting if isinstance(setting, list) else [setting]
    if all(isinstance(item, str | int) and not isinstance(item, bool) for item in items):
        return tuple(items)
    remedy = 'Write criteria = ["node", 2] or criteria = { node = 1.0 }.'
    section.report("criteria", f"must name criteria, got {setting!r}", remedy)
    return None
