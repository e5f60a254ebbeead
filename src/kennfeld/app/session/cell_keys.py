"""Locks and pins of single values as keys of the project file."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool
from kennfeld.base.errors import ArgumentError
from kennfeld.domain.parameters import Parameter
from kennfeld.project.remedies import DIGITS, Change, Path, boxes


def lock_changes(settings: Mapping[str, Any], table: Parameter, where: Bool, *, locked: bool) -> list[Change]:
    """Return the changes of a project file that lock values, or unlock them.

    Args:
        settings: tables of the project file.
        table: on the breakpoints that the project file and its initial files state, with its present locks.
        where: the values, Bool of the shape of the table.
        locked: True to lock them.

    Raises:
        ArgumentError: it has no grid points, so that only all of its values can be locked.
    """
    path: Path = ("parameters", table.name, "lock")
    after = table.locked | where if locked else table.locked & ~where
    if after.all():
        return [(path, True)]
    if table.kind == "rbf":
        raise ArgumentError(f"{table.name} has no grid points: only all its values can be locked")
    if not after.any():
        # without the key, locks of the initial file would hold
        return [(path, False if _own(settings, table.name, "lock") is None else None)]
    return [(path, boxes(table, after))]


def pin_changes(settings: Mapping[str, Any], table: Parameter, cells: Sequence[int], *, pinned: bool) -> list[Change]:
    """Return the changes of a project file that pin values to the present ones, or remove such pins.

    Args:
        settings: tables of the project file.
        table: with its present values and breakpoints.
        cells: numbers of the values in C order.
        pinned: True to pin them.

    Raises:
        ArgumentError: it has no grid points.
    """
    if table.kind == "rbf":
        raise ArgumentError(f"{table.name} has no grid points: only its values as a whole can be held")
    chosen = set(cells)
    others = [entry for entry, cell in _pins(settings, table) if cell not in chosen]
    values = table.values.ravel()
    own = [{"at": _place(table, cell), "value": float(f"{values[cell]:.{DIGITS}g}")} for cell in sorted(chosen)]
    entries = [*others, *(own if pinned else ())]
    return [(("parameters", table.name, "pin"), entries or None)]


def pinned_cells(settings: Mapping[str, Any], table: Parameter) -> list[int]:
    """Return the numbers of the values of a table that a pin of the project file holds, in C order."""
    return sorted({cell for _, cell in _pins(settings, table) if cell is not None})


def _pins(settings: Mapping[str, Any], table: Parameter) -> list[tuple[Any, int | None]]:
    """Return the pins of a table, each with the number of the value at its place; None between grid points."""
    entries = _own(settings, table.name, "pin")
    return [(entry, _cell_at(table, entry)) for entry in (entries if isinstance(entries, list) else [])]


def _cell_at(table: Parameter, entry: Any) -> int | None:
    place = entry.get("at") if isinstance(entry, Mapping) else None
    place = [place] if isinstance(place, int | float) else place or []
    if not isinstance(place, list) or len(place) != len(table.index_axes):
        return None
    index = []
    for axis, at in zip(table.index_axes, place, strict=True):
        points = axis.breakpoints
        k = int(np.abs(points - at).argmin()) if isinstance(at, int | float) else 0
        if not isinstance(at, int | float) or not np.isclose(points[k], at, rtol=1e-9, atol=1e-12):
            return None
        index.append(k)
    return int(np.ravel_multi_index(index, table.values.shape)) if index else 0


def _place(table: Parameter, cell: int) -> list[float]:
    index = np.unravel_index(cell, table.values.shape) if table.values.shape else ()
    return [float(axis.breakpoints[k]) for axis, k in zip(table.index_axes, index, strict=True)]


def _own(settings: Mapping[str, Any], name: str, key: str) -> Any:
    for part in ("parameters", name, key):
        settings = settings.get(part) if isinstance(settings, Mapping) else None  # type: ignore[assignment]
    return settings
