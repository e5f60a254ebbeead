"""What was asked for: the settings of a project that differ from their defaults, as rows of a table."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import numpy as np

from kennfeld.project import Project
from kennfeld.project.schema import TargetEntry

__all__ = ["settings"]

Row = tuple[str, str, str]  # section, key, value

_HIDDEN = ("path", "name", "place", "findings")
_SINGULAR = {"criteria": "criterion", "equalities": "equality"}


def settings(project: Project) -> list[Row]:
    """Every setting that was given, section by section, under the names of the project file's parts."""
    rows: list[Row] = []
    for field in fields(project.file):
        value = getattr(project.file, field.name)
        if field.name not in _HIDDEN:
            rows += _part(field.name, value)
    return rows


def _part(name: str, value: Any) -> Iterator[Row]:
    """A section, a table of sections, or a list of them."""
    if is_dataclass(value):
        yield from _entry(name, value, complete=name == "optimizer")
    elif isinstance(value, Mapping):
        for key, inner in value.items():
            if is_dataclass(inner):
                yield from _entry(f"{name}.{key}", inner)
            else:
                yield name, key, worded(inner)
    elif isinstance(value, tuple):
        for number, inner in enumerate(value, 1):
            if is_dataclass(inner):
                called = getattr(inner, "name", "") or getattr(inner, "node", "") or str(number)
                yield from _entry(f"{_SINGULAR.get(name, name.removesuffix('s'))} {called}", inner)


def _entry(section: str, entry: Any, *, complete: bool = False) -> Iterator[Row]:
    for field in fields(entry):
        value = getattr(entry, field.name)
        if field.name in _HIDDEN or value is None:
            continue
        if complete or not _is_default(value, field):
            yield section, field.name, worded(value)


def _is_default(value: Any, field: Any) -> bool:
    if isinstance(value, np.ndarray):
        return False
    if isinstance(value, tuple | Mapping) and not value:
        return True
    return field.default is not MISSING and type(field.default) is type(value) and bool(field.default == value)


def worded(value: Any) -> str:
    """A setting as text, short.

    >>> worded((0.0, 600.0)), worded({"x": 0.1}), worded(True), worded(np.zeros((20, 20)))
    ('0, 600', 'x 0.1', 'yes', '20 x 20 values from 0 to 0')
    """
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.8g}"
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {worded(inner)}" for key, inner in value.items())
    if isinstance(value, TargetEntry):
        return worded(value.value) if value.kind == "number" else f"{value.kind} {value.name}".removeprefix("name ")
    if hasattr(value, "__dataclass_fields__"):
        return ", ".join(f"{key} {text}" for _, key, text in _entry("", value) if text)
    if isinstance(value, Sequence) and not isinstance(value, str):
        shown = [worded(inner) for inner in value[:40]]
        return ", ".join([*shown, f"... {len(value)} in all"] if len(value) > 40 else shown)
    return str(value)


def _array(value: Any) -> str:
    if value.size == 1:
        return f"{value.item():.8g}"
    shape = " x ".join(map(str, value.shape))
    return f"{shape} values from {np.nanmin(value):.6g} to {np.nanmax(value):.6g}"
