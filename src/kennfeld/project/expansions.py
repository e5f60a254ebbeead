"""`[parameters.NAME]` of an expansion in radial basis functions, which has no axes and comes from a file."""

from collections.abc import Callable

import numpy as np

from kennfeld.parameters import Parameter
from kennfeld.project.schema import ParameterEntry
from kennfeld.rbf import RBF

__all__ = ["settled"]

Report = Callable[[str, str, str], None]  # key, what, mend
TABLES = "Tables have it; remove it."


def settled(old: RBF, entry: ParameterEntry, report: Report) -> Parameter | None:
    """The expansion as the project file wants it; None where that cannot be, and `report` hears why."""
    found = [*_meaningless(entry), *_wrong_lock(entry), *_wrong_bounds(old, entry)]
    for key, what, mend in found:
        report(key, what, mend)
    if found:
        return None
    given = {"unit": entry.unit, "description": entry.description}
    made = old.changed(**{key: value for key, value in given.items() if value is not None})
    if entry.bounds is not None:
        lower, upper = entry.bounds
        made = made.changed(lower=lower, upper=upper)
    return made.changed(locked=np.full(made.values.shape, entry.lock is True))


def _meaningless(entry: ParameterEntry) -> list[tuple[str, str, str]]:
    given = {
        "initial": entry.initial is not None,
        "smoothness": entry.smoothness is not None,
        "gradient": bool(entry.gradient),
        "curvature": bool(entry.curvature),
        "pin": bool(entry.pins),
        "extrapolation": entry.extrapolation is not None,
    }
    what = f"{entry.name} is an expansion in radial basis functions, which has no"
    initial = "Its values are those of the initial file; remove it."
    return [
        (
            key,
            f"{what} {'values of its own here' if key == 'initial' else key}",
            initial if key == "initial" else TABLES,
        )
        for key, there in given.items()
        if there
    ]


def _wrong_lock(entry: ParameterEntry) -> list[tuple[str, str, str]]:
    if isinstance(entry.lock, bool):
        return []
    what = f"{entry.name} is an expansion in radial basis functions, of which no part has a place on an axis"
    return [("lock", what, "Write lock = true, or give values that shall stay the same lower and upper bound.")]


def _wrong_bounds(old: RBF, entry: ParameterEntry) -> list[tuple[str, str, str]]:
    if entry.bounds is None or all(side.shape == old.values.shape for side in entry.bounds):
        return []
    what = f"{entry.name} has {old.size} values of several kinds: offset, slopes, weights, centres and widths"
    return [("bounds", what, f"Write two lists of {old.size} numbers, in the order of trust.csv.")]
