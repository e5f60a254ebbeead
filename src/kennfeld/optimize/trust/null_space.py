"""The changes of values that nothing determines: how many there are, and which values to hold to determine them all."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.constraints import Pin
from kennfeld.optimize.trust.covariance import Estimate
from kennfeld.optimize.trust.direction_text import Describer, listed
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter

__all__ = ["NullSpace", "Remedy", "null_space"]

PREFERRED = 0.1  # part in the space that a value of a table needs, of what one of the next larger table needs
LEAST = 1e-4  # the same between the smallest table and any other

Marks = Mapping[str, Bool]  # by parameter, of the shape of its values


@dataclass(frozen=True)
class Remedy:
    """Values to hold so that nothing stays undetermined.

    `pins` are an argument of `calibrate`; with `locks` go parameters that have the fitted values already.

    Attributes:
        pins: values to pin, at what the fit gave them; a value that is known serves as well.
        locks: values to lock, marked by parameter, arrays of the shape of its values.
        axes: axes whose breakpoints to fix.
    """

    pins: tuple[Pin, ...] = ()
    locks: Marks = field(default_factory=dict)
    axes: tuple[str, ...] = ()


@dataclass(frozen=True)
class NullSpace:
    """The space of the changes of values that neither data, smoothness nor limits determine.

    Attributes:
        dimension: number of independent changes that nothing determines.
        by_smoothness: number of further ones that smoothness alone determines, of values that samples reach.
        remedy: values to hold so that `dimension` becomes 0; as few as possible.
        sentence: the dimension, and whose values change; empty where the data determine every value.
        advice: the remedy in words; empty where there is none.
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
    estimate: Estimate,
    columns: Mapping[str, Int],
    parameters: ParameterSet,
    moving: Collection[str],
    words: Describer,
) -> NullSpace:
    """Return what is undetermined at the end of a fit, with a smallest set of values that settles it.

    Values of small tables are preferred: of a sum of a map and a curve, it is the curve that is held.

    Args:
        estimate: what is known of the values around the end of the fit.
        columns: the columns of each parameter among all values, and of each axis whose breakpoints are free.
        parameters: the fitted ones.
        moving: tables that lie on an axis whose breakpoints are free; no coordinate is fixed in them.
        words: names the places of values.
    """
    idle, chosen = estimate.open_values(_preference(columns, parameters, estimate.reduction.size))
    pinned, locked, axes = _held(columns, parameters, moving, (idle, chosen))
    dimension, by_smoothness = idle.size + chosen.size, estimate.by_smoothness
    changed = [name for name, at in columns.items() if estimate.undetermined[at].any()]
    pins = tuple(pin for name, where in pinned.items() for pin in _pins(parameters[name], where))
    return NullSpace(
        dimension=dimension,
        by_smoothness=by_smoothness,
        remedy=Remedy(pins, locked, axes),
        sentence=_sentence(dimension, idle.size, by_smoothness, changed),
        advice=_advice(dimension, pinned, locked, axes, words),
    )


def _preference(columns: Mapping[str, Int], parameters: ParameterSet, size: int) -> Float:
    """Prefer the values of small tables to those of large ones, and all of them to breakpoints."""
    sizes = sorted({at.size for name, at in columns.items() if name in parameters})
    preference = np.zeros(size)
    for name, at in columns.items():
        table = name in parameters
        preference[at] = max(PREFERRED ** sizes.index(at.size), LEAST) if table else LEAST * PREFERRED
    return preference


def _held(
    columns: Mapping[str, Int], parameters: ParameterSet, moving: Collection[str], numbers: tuple[Int, Int]
) -> tuple[Marks, Marks, tuple[str, ...]]:
    """Values to pin, values to lock, and axes to fix, of values that nothing informs and of those chosen among others.

    The former are locked. So are the latter where they have no coordinates that stand still.
    """
    pinned: dict[str, Bool] = {}
    locked: dict[str, Bool] = {}
    axes: list[str] = []
    for name, at in columns.items():
        idle, chosen = (np.isin(at, each) for each in numbers)
        if name not in parameters:
            axes += [name] if (idle | chosen).any() else []
            continue
        table = parameters[name]
        if name in moving or table.kind == "rbf":
            idle, chosen = idle | chosen, np.zeros(at.size, dtype=bool)
        for marks, where in ((pinned, chosen), (locked, idle)):
            if where.any():
                marks[name] = where.reshape(table.values.shape)
    return pinned, locked, tuple(axes)


def _pins(table: Parameter, where: Bool) -> Iterator[Pin]:
    for at in np.argwhere(where).tolist():
        places = tuple(float(axis.breakpoints[i]) for axis, i in zip(table.index_axes, at, strict=True))
        yield Pin(table.name, places, float(table.values[tuple(at)]))


def _sentence(dimension: int, idle: int, by_smoothness: int, changed: Sequence[str]) -> str:
    parts = []
    if dimension:
        some = f", {idle} of them of single values that no data inform" if 0 < idle < dimension else ""
        parts.append(f"Nothing determines {_changes(dimension)} of {listed(changed)}{some}.")
    if by_smoothness:
        others = f"{by_smoothness} more" if dimension else f"{_changes(by_smoothness)} of the values"
        parts.append(f"Smoothness alone determines {others}.")
    return " ".join(parts)


def _changes(count: int) -> str:
    return "one independent change" if count == 1 else f"{count} independent changes"


def _advice(dimension: int, pinned: Marks, locked: Marks, axes: Sequence[str], words: Describer) -> str:
    if not dimension:
        return ""
    parts = [f"lock {words.places(name, where)}" for name, where in locked.items()]
    parts += [f"fix the breakpoints of {name}" for name in axes]
    parts += [f"pin {words.places(name, where)}" for name, where in pinned.items()]
    several = sum(int(np.count_nonzero(where)) for where in pinned.values()) > 1
    known = " to values that you know, or else to the fitted ones" if several else " to a value that you know"
    return f"To determine {'it' if dimension == 1 else 'all of them'}, {'; '.join(parts)}{known if pinned else ''}."
