"""What was asked for: the settings of a project that differ from their defaults, as rows of a table."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

from kennfeld.project import Project
from kennfeld.project.schema import TargetEntry

__all__ = ["settings"]

Row = tuple[str, str, str]  # section, key, value

_HIDDEN = ("place", "findings")


def settings(project: Project) -> list[Row]:
    """Every setting that was given, section by section, as the project file calls them."""
    file = project.file
    rows = [*_entry("model", file.model)]
    rows += [("channels", name, channel) for name, channel in file.channels.items()]
    rows += [("calculated", name, text) for name, text in file.calculated.items()]
    for dataset in file.datasets:
        rows += _entry(f"dataset {dataset.name}".strip(), dataset)
    rows += _entry("calibration", file.calibration)
    for name, axis in file.axes.items():
        rows += _entry(f"axes.{name}", axis)
    for name, parameter in file.parameters.items():
        rows += _entry(f"parameters.{name}", parameter)
    for criterion in file.criteria:
        rows += _entry(f"criterion {criterion.node}", criterion)
    rows += _entry("optimizer", file.optimizer, complete=True)
    return rows


def _entry(section: str, entry: Any, *, complete: bool = False) -> Iterator[Row]:
    for field in fields(entry):
        value = getattr(entry, field.name)
        if field.name in _HIDDEN or value is None or (field.name == "name" and section.endswith(str(value))):
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
