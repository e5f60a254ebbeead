"""Remedies of undetermined values as changes of a project file."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.free_axes import free_axes
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.trust.remedies import Remedy
from kennfeld.project.value_forms import DIRECTIONS

MORE_SMOOTHNESS = 10.0  # factor
DIGITS = 8  # of a pinned value

Path = tuple[str | int, ...]
Change = tuple[Path, Any]  # None removes the key


@dataclass(frozen=True)
class KeyChanges:
    """A remedy as keys of the project file.

    Attributes:
        kind: pin, lock, smoothness, fix or coarsen.
        title: the remedy in a few words: `Pin CurveEta at 40 to 0.75`.
        changes: path and value of each key; None removes one.
        applied: True if the project file has these keys already.
    """

    kind: str
    title: str
    changes: tuple[Change, ...]
    applied: bool


def key_changes(
    remedy: Remedy,
    problem: Problem,
    settings: Mapping[str, Any],
    chosen: Mapping[str, Mapping[str, float]] | None = None,
) -> KeyChanges | None:
    """Return a remedy as changes of a project file; None if the file has no keys for it.

    Args:
        remedy: the remedy.
        problem: the problem that left something undetermined.
        settings: tables of the project file.
        chosen: smoothness that was chosen from the data, as in `Result.smoothness`.
    """
    writer = _Writer(problem, settings, chosen or {})
    changes, titles, kinds = list[Change](), list[str](), list[str]()
    for kind, title, change in writer.parts(remedy):
        # a remedy that the file can hold in part only is not offered
        if change is None:
            return None
        kinds.append(kind)
        titles.append(title)
        changes += change
    if not changes:
        return None
    applied = all(_value_at(settings, path) == value for path, value in changes)
    return KeyChanges(kinds[0], "; ".join(titles), tuple(changes), applied)


def _value_at(settings: Any, path: Path) -> Any:
    for key in path:
        settings = settings.get(key) if isinstance(settings, Mapping) else None
    return settings


class _Writer:
    def __init__(
        self, problem: Problem, settings: Mapping[str, Any], chosen: Mapping[str, Mapping[str, float]]
    ) -> None:
        self._problem, self._settings, self._chosen = problem, settings, chosen

    def parts(self, remedy: Remedy) -> Iterator[tuple[str, str, list[Change] | None]]:
        """Yield kind, title and changes of each part; None if there are no keys for it."""
        if remedy.pins:
            yield "pin", self._pin_title(remedy), self._pins(remedy)
        for name, where in remedy.locks.items():
            yield "lock", self._lock_title(name, where), self._lock(name, where)
        for name in remedy.smoother:
            yield self._smoother(name)
        for name in remedy.axes:
            yield "fix", f"Fix the breakpoints of {name}", self._axis(name, coarser=False)
        for name in remedy.coarser:
            yield "coarsen", f"Halve the breakpoints of {name}", self._axis(name, coarser=True)

    def _own(self, path: Path) -> Any:
        return _value_at(self._settings, path)

    def _pin_title(self, remedy: Remedy) -> str:
        first = remedy.pins[0]
        if len(remedy.pins) > 1:
            return f"Pin {count_noun(len(remedy.pins), 'value')}"
        at = ", ".join(f"{place:g}" for place in first.at)
        return f"Pin {first.parameter}{f' at {at}' if at else ''} to {first.value:.4g}"

    def _pins(self, remedy: Remedy) -> list[Change]:
        lists: dict[str, list[Any]] = {}
        for pin in remedy.pins:
            # pins that the file has stay, and one at the same place is not written twice
            pins = lists.setdefault(pin.parameter, list(self._own(("parameters", pin.parameter, "pin")) or ()))
            entry = {"at": list(pin.at), "value": float(f"{pin.value:.{DIGITS}g}")}
            if not any(isinstance(other, Mapping) and other.get("at") == entry["at"] for other in pins):
                pins.append(entry)
        return [(("parameters", name, "pin"), pins) for name, pins in lists.items()]

    def _lock_title(self, name: str, where: Bool) -> str:
        count = int(np.count_nonzero(where))
        return f"Lock {name}" if count == where.size else f"Lock {count_noun(count, 'value')} of {name}"

    def _lock(self, name: str, where: Bool) -> list[Change] | None:
        path: Path = ("parameters", name, "lock")
        table, present = self._problem.parameters[name], self._own(path)
        if where.all() or present is True:
            return [(path, True)]
        if table.kind == "rbf":
            return None
        # this lock and ranges exclude each other: what it locks is written as ranges
        if present == "no-data":
            present, where = None, where | table.locked
        kept = list(present) if isinstance(present, list) else []
        ranges = [box for box in boxes(table, where) if box not in kept]
        return [(path, [*kept, *ranges])]

    def _smoother(self, name: str) -> tuple[str, str, list[Change]]:
        factors: Sequence[Any] = self._problem.factors(name)
        if name in self._chosen:
            by_axis = self._chosen[name]
            factors = [by_axis.get(direction, factor) for direction, factor in zip(DIRECTIONS, factors, strict=False)]
        path: Path = ("parameters", name, "smoothness")
        if not any(factors):
            return "smoothness", f"Smoothness of {name} from the data", [(path, "auto")]
        more = [float(f"{MORE_SMOOTHNESS * factor:.4g}") for factor in factors]
        # one number for all axes if they agree, as a user would write it
        value = more[0] if len(set(more)) == 1 else dict(zip(DIRECTIONS, more, strict=False))
        shown = ", ".join(f"{factor:g}" for factor in dict.fromkeys(more))
        return "smoothness", f"Smoothness of {name} {MORE_SMOOTHNESS:g} times as large: {shown}", [(path, value)]

    def _axis(self, name: str, *, coarser: bool) -> list[Change] | None:
        """Return changes of a free axis: fixed where it started, or with half as many breakpoints."""
        for key, axis in free_axes(self._problem.parameters).items():
            if name not in (str(key), f"axis {key}"):
                continue
            table, which = axis.places[0]
            own = axis.axis.name
            path: Path = ("axes", own) if own else ("parameters", table, DIRECTIONS[which])
            points = axis.axis.breakpoints.tolist()
            keys = ("begin", "end", "count", *(() if coarser else ("free", "min_distance", "range")))
            removed: list[Change] = [((*path, each), None) for each in keys if self._own((*path, each)) is not None]
            if not coarser:
                return [*removed, ((*path, "breakpoints"), points)]
            if len(points) < 4:
                return None
            freed: list[Change] = [((*path, "free"), True)]
            # every second one, with both ends
            return [*removed, *freed, ((*path, "breakpoints"), [*points[:-1:2], points[-1]])]
        return None


def boxes(table: Parameter, where: Bool) -> list[dict[str, list[float]]]:
    """Cover exactly the marked grid points, Bool of the table's shape, by ranges of axis values as `lock` lists them.

    >>> from kennfeld.domain.parameters import Curve
    >>> boxes(Curve("C", [0.0, 1.0, 2.0], [0.0] * 3), np.array([True, True, False]))
    [{'x': [0.0, 1.0]}]
    """
    ranges, remaining = [], where.copy()
    while remaining.any():
        # greedy: from the first marked point, grow along the last axis, then along those before
        begin = tuple(int(i) for i in np.argwhere(remaining)[0])
        end = list(begin)
        for axis in reversed(range(where.ndim)):
            while end[axis] + 1 < where.shape[axis]:
                grown = [*end[:axis], end[axis] + 1, *end[axis + 1 :]]
                if not remaining[_slices(begin, grown)].all():
                    break
                end = grown
        remaining[_slices(begin, end)] = False
        ranges.append(_range(table, begin, end))
    return ranges


def _slices(begin: Sequence[int], end: Sequence[int]) -> tuple[slice, ...]:
    return tuple(slice(first, last + 1) for first, last in zip(begin, end, strict=True))


def _range(table: Parameter, begin: Sequence[int], end: Sequence[int]) -> dict[str, list[float]]:
    points = [axis.breakpoints for axis in table.index_axes]
    return {
        direction: [float(points[i][begin[i]]), float(points[i][end[i]])]
        for i, direction in enumerate(DIRECTIONS[: len(points)])
        if begin[i] > 0 or end[i] < len(points[i]) - 1
    }
