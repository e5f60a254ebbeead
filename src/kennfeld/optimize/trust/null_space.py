"""Combinations of values that nothing determines: their number, and a smallest set of values to fix."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.constraints import Pin
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.trust.active_limits import combinations_of_values
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.direction_text import Describer, join_items
from kennfeld.optimize.trust.remedies import Marks, Remedy

PREFERENCE_PER_SIZE = 0.1  # weight of the values of a table, relative to those of the next smaller table
MIN_PREFERENCE = 1e-4  # relative to the smallest table


@dataclass(frozen=True)
class NullSpace:
    """The space of changes of values that neither data, smoothness nor limits determine.

    Attributes:
        dimension: number of independent combinations of values that nothing determines.
        by_smoothness: number of further ones determined by smoothness alone, among values that samples influence.
        remedy: as few values as possible to fix so that `dimension` becomes 0.
        sentence: the dimension and the parameters concerned; empty if the data determine all values.
        advice: the remedy in words; empty if there is none.
    """

    dimension: int = 0
    by_smoothness: int = 0
    remedy: Remedy = field(default_factory=Remedy)
    sentence: str = ""
    advice: str = ""

    def __str__(self) -> str:
        return f"{self.sentence} {self.advice}".strip()

    def as_json(self) -> dict[str, Any]:
        """Return the entry `null_space` of `result.json`; locks are counted, `trust.csv` marks them as not informed."""
        return {
            "dimension": self.dimension,
            "by_smoothness": self.by_smoothness,
            "sentence": self.sentence,
            "remedy": self.advice,
            "pins": [{"parameter": pin.parameter, "at": list(pin.at), "value": pin.value} for pin in self.remedy.pins],
            "locks": {name: int(np.count_nonzero(where)) for name, where in self.remedy.locks.items()},
            "axes": list(self.remedy.axes),
        }


def null_space(
    estimate: Estimate, columns: Mapping[str, Int], parameters: ParameterSet, moving: Collection[str], words: Describer
) -> NullSpace:
    """Find the undetermined combinations of values at the end of a fit, with a smallest set of values to fix.

    Values of small tables are preferred: of the sum of a map and a curve, the curve is fixed.

    Args:
        estimate: covariance around the end of the fit.
        columns: columns of each parameter and of each axis with free breakpoints among all values, Int[its values].
        parameters: the fitted parameters.
        moving: tables on an axis with free breakpoints; their values are locked, since a pin needs coordinates.
        words: describes places of values.
    """
    uninformed, chosen = estimate.open_values(_preference(columns, parameters, estimate.reduction.size))
    pinned, locked, axes = _values_to_fix(columns, parameters, {*moving, *words.layers}, (uninformed, chosen))
    dimension, by_smoothness = uninformed.size + chosen.size, estimate.by_smoothness
    changed = [name for name, at in columns.items() if estimate.undetermined[at].any()]
    pins = []
    for name, where in pinned.items():
        table = parameters[name]
        for at in np.argwhere(where).tolist():
            places = tuple(float(axis.breakpoints[i]) for axis, i in zip(table.index_axes, at, strict=True))
            pins.append(Pin(name, places, float(table.values[tuple(at)])))
    return NullSpace(
        dimension=dimension,
        by_smoothness=by_smoothness,
        remedy=Remedy(tuple(pins), locked, axes),
        sentence=_sentence(dimension, uninformed.size, by_smoothness, changed, words),
        advice=_advice(dimension, pinned, locked, axes, words),
    )


def _preference(columns: Mapping[str, Int], parameters: ParameterSet, size: int) -> Float:
    """Return weights that prefer values of small tables to those of large ones, and all of them to breakpoints."""
    # by rank among the sizes that occur, not by the sizes themselves
    sizes = sorted({at.size for name, at in columns.items() if name in parameters})
    preference = np.full(size, MIN_PREFERENCE * PREFERENCE_PER_SIZE)
    for name, at in columns.items():
        if name in parameters:
            preference[at] = max(PREFERENCE_PER_SIZE ** sizes.index(at.size), MIN_PREFERENCE)
    return preference


def _values_to_fix(
    columns: Mapping[str, Int], parameters: ParameterSet, unpinned: Collection[str], numbers: tuple[Int, Int]
) -> tuple[Marks, Marks, tuple[str, ...]]:
    """Return values to pin, values to lock, and axes to fix.

    `numbers` are those of values that nothing informs, which are locked, and of chosen other values, which are pinned,
    or locked if they belong to a table in `unpinned` or have no coordinates.
    """
    pinned: dict[str, Bool] = {}
    locked: dict[str, Bool] = {}
    axes: list[str] = []
    for name, at in columns.items():
        uninformed, chosen = (np.isin(at, each) for each in numbers)
        if name not in parameters:
            axes += [name] if (uninformed | chosen).any() else []
            continue
        # a pin is stated by coordinates, which move with the axis or do not exist
        if name in unpinned or parameters[name].kind == "rbf":
            uninformed, chosen = uninformed | chosen, np.zeros(at.size, dtype=bool)
        for marks, where in ((pinned, chosen), (locked, uninformed)):
            if where.any():
                marks[name] = where.reshape(parameters[name].values.shape)
    return pinned, locked, tuple(axes)


def _sentence(dimension: int, uninformed: int, by_smoothness: int, changed: Sequence[str], words: Describer) -> str:
    parts = []
    if dimension:
        single = "weights without effect" if words.layers.issuperset(changed) else "values without data"
        some = f", {uninformed} of them single {single}" if 0 < uninformed < dimension else ""
        count = combinations_of_values(dimension).capitalize()
        parts.append(f"{count} of {join_items(changed)} {'is' if dimension == 1 else 'are'} undetermined{some}.")
    if by_smoothness:
        others = f"{by_smoothness} more" if dimension else combinations_of_values(by_smoothness)
        parts.append(f"Smoothness alone determines {others}.")
    return " ".join(parts)


def _advice(dimension: int, pinned: Marks, locked: Marks, axes: Sequence[str], words: Describer) -> str:
    if not dimension:
        return ""
    parts = [f"lock {words.places(name, where)}" for name, where in locked.items()]
    parts += [f"fix the breakpoints of {name}" for name in axes]
    parts += [f"pin {words.places(name, where)}" for name, where in pinned.items()]
    several = sum(int(np.count_nonzero(where)) for where in pinned.values()) > 1
    known = " to known values, or else to the fitted ones" if several else " to a known value"
    fewer = ", or fit fewer layers" if words.layers.intersection(locked) else ""
    return (
        f"To determine {'it' if dimension == 1 else 'all of them'}, {'; '.join(parts)}{known if pinned else ''}{fewer}."
    )
