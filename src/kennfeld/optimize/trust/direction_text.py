"""Badly determined directions in plain words, each with the mend."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kennfeld.arrays import Bool, Float, Int
from kennfeld.graph import Graph
from kennfeld.optimize.trust.weak_directions import TableChange, WeakDirection
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter
from kennfeld.rbf import RBF

__all__ = ["Describer", "Direction", "listed"]

PERCENT = 0.01
NAMED = 3  # grid points of a table that a sentence names
LISTED = 8  # grid points of a table that a remedy lists
SHARE = 0.3  # of the strongest grid point that another needs to be named
SLIGHT = 0.3  # of the strongest table that another needs to be named
RELATIVE = ("scale", "stretch", "follow")
ORDER = ("scale", "stretch", "offset", "follow", "shift")
DIRECTIONS = ("x", "y", "z", "w")
Amounts = Sequence[tuple[TableChange, float]]


@dataclass(frozen=True)
class Direction:
    """A common change of values that the data do not see, or hardly.

    Attributes:
        sentence: what the change is, and who holds it.
        remedy: what would settle it.
        parts: the change that the sentence speaks of, by parameter, of the shape of its values and in their unit.
        exact: whether the data say nothing about it.
        ratio: what the change costs, against what it would cost if each value moved alone; 0 where nothing holds it.
        deviation: how many times this change the values may be off; inf where nothing holds them.
    """

    sentence: str
    remedy: str
    parts: Mapping[str, Float]
    exact: bool
    ratio: float
    deviation: float

    def __str__(self) -> str:
        return f"{self.sentence} {self.remedy}"


class Describer:
    """Words for directions around calibrated `parameters` of a function; `start` is the calibration before.

    `samples` counts the training samples at each value. `free_axes` names the axes among them whose breakpoints are
    values, each with a table that lies on it and its direction there.
    """

    def __init__(
        self,
        graph: Graph,
        parameters: ParameterSet,
        start: ParameterSet,
        samples: Mapping[str, Int],
        free_axes: Mapping[str, tuple[str, int]] | None = None,
    ) -> None:
        self._parameters, self._start, self._samples = parameters, start, samples
        axes = {} if free_axes is None else free_axes
        self._free_axes = {name: parameters[table].axes[which] for name, (table, which) in axes.items()}
        self._axes = {name: _axes(graph, parameters[name]) for name in samples if name not in axes}

    def uninformed(self, name: str, where: Bool) -> Direction:
        """Values of one table that neither data nor smoothness inform."""
        count = int(np.count_nonzero(where))
        if name in self._free_axes:
            return self._idle_breakpoints(name, where)
        which = self._some(name, where, f"any value of {name}")
        keeps = "it keeps its start" if count == 1 else "they keep their start"
        mends = ["Record samples there", "lock it" if count == 1 else "lock them"]
        if self._samples[name].any() and max(where.shape, default=0) > 2:
            mends.insert(1, f"give {name} a smoothness")
        sentence = f"No data and no smoothness inform {which}: {keeps}."
        return Direction(sentence, f"{listed(mends, 'or')}.", {name: where.astype(np.float64)}, True, 0.0, float("inf"))

    def searched(self, name: str, where: Bool) -> Direction:
        """Values that a search has moved, and that change nothing in small steps."""
        which = self._some(name, where, f"the values of {name}")
        they = "it" if np.count_nonzero(where) == 1 else "they"
        sentence = (
            f"The search has moved {which}, but small changes around what it found change nothing: "
            f"how far {they} may be off is not known."
        )
        return Direction(
            sentence, "Simulate with neighbouring values.", {name: where.astype(np.float64)}, True, 0.0, float("inf")
        )

    def _some(self, name: str, where: Bool, all_of_them: str) -> str:
        """Some values of a parameter by their places, or all of them."""
        count = int(np.count_nonzero(where))
        if count == where.size:
            return name if count == 1 else all_of_them
        places = [self.place(name, at) for at in np.argwhere(where)[:NAMED].tolist()]
        more = ", ..." if count > NAMED else ""
        return f"{count} of {where.size} values of {name} ({', '.join(places)}{more})"

    def places(self, name: str, where: Bool) -> str:
        """Which values of a parameter are marked, by their coordinates; how many where these would be a long list."""
        count = int(np.count_nonzero(where))
        if count == where.size:
            return name if count == 1 else f"all {count} values of {name}"
        if count > LISTED:
            return f"{count} of the {where.size} values of {name}"
        return f"{name} at {listed([self.place(name, at) for at in np.argwhere(where).tolist()])}"

    def _idle_breakpoints(self, name: str, where: Bool) -> Direction:
        """Breakpoints without data around them, or on a flat part of all their tables."""
        numbers = np.flatnonzero(where).tolist()
        which = [self._breakpoint(name, i) for i in numbers[:NAMED]] + (["..."] if len(numbers) > NAMED else [])
        one = len(numbers) == 1
        sentence = (
            f"No data tell where {listed(which)} of {name} {'lies' if one else 'lie'}: "
            f"the tables are flat there, or without data; {'it keeps its' if one else 'they keep their'} place."
        )
        return Direction(
            sentence,
            "Give the axis fewer breakpoints, or fix them.",
            {name: where.astype(np.float64)},
            True,
            0.0,
            float("inf"),
        )

    def named(self, weak: WeakDirection, parts: Mapping[str, Float]) -> Direction:
        """A direction of named shapes; `parts` are its changes of each parameter."""
        ordered = sorted(weak.amounts, key=lambda pair: ORDER.index(pair[0].kind))
        unit = self._picture(ordered[0][0]) / ordered[0][1]
        amounts = [(shape, amount * unit) for shape, amount in ordered]
        deviation = weak.deviation / abs(unit)
        message = _clauses([self._verb(shape, amount) for shape, amount in amounts])
        effect = _effect(weak, self._size(amounts, deviation))
        changed = {name: part * unit for name, part in parts.items() if np.any(part)}
        return Direction(
            f"{message} {effect}.", self._pin(amounts, changed), changed, weak.exact, weak.ratio, deviation
        )

    def nameless(self, weak: WeakDirection, parts: Mapping[str, Float], weights: Mapping[str, Float]) -> Direction:
        """A direction told by its strongest grid points; `weights` say what each value's change does to the data."""
        strongest = max(float(weight.max()) for weight in weights.values())
        shares = {name: _rounded(weight / strongest) for name, weight in weights.items()}
        strength = {name: float(share.max()) for name, share in shares.items()}
        ranked = sorted(strength, key=lambda name: (-strength[name], name not in self._free_axes))
        names = [name for name in ranked if strength[name] >= SLIGHT]
        first = int(shares[names[0]].argmax())
        unit = PERCENT * self._typical(names[0]) / float(parts[names[0]].ravel()[first])
        verbs = [v for name in names for v in self._points(name, parts[name] * unit, shares[name])]
        deviation = weak.deviation / abs(unit)
        whole = "mean distance of breakpoints" if names[0] in self._free_axes else "largest value"
        size = f"{100 * PERCENT * deviation:.2g} % of the {whole} of {names[0]}"
        changed = {name: part * unit for name, part in parts.items() if np.any(part)}
        together = " together" if len(verbs) > 1 else ""
        sentence = f"{_clauses(verbs)}{together} {_effect(weak, size)}."
        return Direction(sentence, self._separate(names), changed, weak.exact, weak.ratio, deviation)

    def _typical(self, name: str) -> float:
        if name in self._free_axes:
            return float(np.diff(self._free_axes[name].breakpoints).mean())
        return float(np.abs(np.nan_to_num(self._parameters[name].values)).max()) or 1.0

    def _picture(self, shape: TableChange) -> float:
        """An amount that is easily pictured: 1 %, or a round number."""
        if shape.kind in RELATIVE:
            return PERCENT
        if shape.kind == "shift":
            points = self._parameters[shape.table].index_axes[shape.axis].breakpoints
            return _round(PERCENT * float(np.ptp(points)))
        return _round(PERCENT * self._typical(shape.table))

    def _verb(self, shape: TableChange, amount: float) -> tuple[str, str]:
        table = self._parameters[shape.table]
        more = "raising" if amount > 0 else "lowering"
        match shape.kind:
            case "scale":
                return "scaling", f"{shape.table} by {_factor(amount)}"
            case "stretch":
                return "stretching", f"{shape.table} about {shape.about:.4g} by {_factor(amount)}"
            case "follow":
                return more, f"{shape.table} by {abs(amount):.2g} times {shape.other}"
            case "shift":
                unit = _unit(table.index_axes[shape.axis].unit)
                return "shifting", f"{shape.table} along {self._axes[shape.table][shape.axis]} by {amount:.2g}{unit}"
            case "offset":
                return more, f"{shape.table} by {abs(amount):.2g}{_unit(table.unit)}"

    def _size(self, amounts: Amounts, deviation: float) -> str:
        """How far off the values may be, in the terms of the first shape."""
        shape, amount = amounts[0]
        size = abs(amount) * deviation
        if shape.kind in RELATIVE:
            return f"{100 * size:.2g} %"
        table = self._parameters[shape.table]
        return f"{size:.2g}{_unit(table.index_axes[shape.axis].unit if shape.kind == 'shift' else table.unit)}"

    def _points(self, name: str, part: Float, weight: Float) -> list[tuple[str, str]]:
        """The strongest grid points of a table, those that go up and those that go down."""
        order = np.argsort(-weight, axis=None, kind="stable")
        some = int(np.count_nonzero(part)) > NAMED
        chosen = [int(i) for i in order[:NAMED] if weight.flat[i] >= SHARE * weight.flat[order[0]]]
        chosen = chosen[:1] if some else chosen
        if name in self._free_axes:
            return [self._moved_breakpoint(name, i, float(part.flat[i]), others=some) for i in chosen]
        verbs = []
        for sign, verb in ((1, "raising"), (-1, "lowering")):
            places = [
                self.place(name, np.unravel_index(i, part.shape)) for i in chosen if np.sign(part.flat[i]) == sign
            ]
            if places:
                at = f" at {listed([p for p in places if p])}" if any(places) else ""
                verbs.append((verb, f"{name}{' around' if some else at}{at.removeprefix(' at') if some else ''}"))
        return verbs

    def _moved_breakpoint(self, name: str, number: int, change: float, *, others: bool) -> tuple[str, str]:
        around = " and others" if others else ""
        verb = "raising" if change > 0 else "lowering"
        return verb, f"{self._breakpoint(name, number)}{around} of {name}"

    def _breakpoint(self, name: str, number: int) -> str:
        """Which one it is, and where it stands."""
        return f"the {_ordinal(number + 1)} breakpoint ({self._free_axes[name].breakpoints[number]:.6g})"

    def _pin(self, amounts: Amounts, parts: Mapping[str, Float]) -> str:
        """One value that settles the direction once it is known: of the smallest table that is not just shifted."""
        shape, _ = min(amounts, key=lambda pair: (pair[0].kind == "shift", self._parameters[pair[0].table].size))
        name, table = shape.table, self._parameters[shape.table]
        if table.size == 1:
            return f"Do not free {name}, or bound it by what you know."
        start = np.nan_to_num(self._start[name].values)
        telling = shape.kind == "scale" and float(np.ptp(start)) > 0
        strength = np.abs(start if telling else parts[name])
        best = np.where(strength >= (1 - 1e-6) * strength.max(), self._samples[name], -1)
        at = np.unravel_index(int(best.argmax()), best.shape)
        value = float(np.ravel(start if telling else table.values)[int(best.argmax())])
        return f"Pin a value of {name} that you know, e.g. at {self.place(name, at).strip('()')} to {value:.4g}."

    def place(self, name: str, at: Iterable[Any]) -> str:
        """The coordinates of a grid point; empty for a scalar. A number of an expansion has a name."""
        parameter = self._parameters[name]
        if isinstance(parameter, RBF):
            return parameter.value_name(int(next(iter(at))))
        values = [f"{axis.breakpoints[i]:.6g}" for axis, i in zip(self._parameters[name].index_axes, at, strict=True)]
        if len(values) == 1:
            return values[0]
        named = ", ".join(f"{axis} {value}" for axis, value in zip(self._axes[name], values, strict=True))
        return f"({named})" if named else ""

    def _separate(self, names: Sequence[str]) -> str:
        if all(name in self._free_axes for name in names):
            return "Give the axis fewer breakpoints, or fix them."
        named = [name for name in names if name not in self._free_axes]
        if all(self._parameters[name].kind == "rbf" for name in named):
            return f"Record more samples, or give {listed(named)} fewer centres."
        tables = [name for name in named if max(self._parameters[name].values.shape, default=0) > 2]
        smoother = f"give {listed(tables, 'or')} more smoothness" if tables else "lock one of them"
        axes = [name for name in names if name in self._free_axes]
        mends = ["Record samples that tell them apart", *(f"give {name} fewer breakpoints" for name in axes), smoother]
        return f"{', '.join(mends[:-1])}, or {mends[-1]}."


def _effect(weak: WeakDirection, size: str) -> str:
    if weak.exact and not np.isfinite(weak.deviation):
        return "changes nothing"
    if not np.isfinite(weak.deviation):
        return "changes hardly anything"
    if weak.exact:
        return f"changes nothing that the data show; smoothness alone holds it, to +-{size}"
    if weak.seen < 0.1 * weak.ratio:
        return f"changes hardly anything; mostly smoothness holds it, to +-{size}"
    return f"changes hardly anything; it is known to +-{size}"


def _rounded(shares: Float) -> Float:
    """Shares in so few digits that rounding errors decide no order."""
    found: Float = np.round(shares, 6)
    return found


def _ordinal(number: int) -> str:
    """A number as one counts.

    >>> _ordinal(3), _ordinal(12), _ordinal(21)
    ('third', '12th', '21st')
    """
    small = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
    if number <= len(small):
        return small[number - 1]
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"


def _clauses(verbs: Sequence[tuple[str, str]]) -> str:
    """One after the other, a verb that repeats left out."""
    said = [rest if i and verbs[i - 1][0] == verb else f"{verb} {rest}" for i, (verb, rest) in enumerate(verbs)]
    whole = listed(said)
    return f"{whole[0].upper()}{whole[1:]}"


def _round(value: float) -> float:
    """The next of 1, 2 and 5 times a power of ten.

    >>> _round(0.55), _round(3.0)
    (0.5, 2.0)
    """
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))


def _factor(amount: float) -> str:
    """1 + amount in few digits; a little less than 1 as the inverse of what it undoes.

    >>> _factor(0.01), _factor(-0.0100004), _factor(-0.5)
    ('1.01', '1/1.01', '0.5')
    """
    text = f"{1 + float(f'{abs(amount):.2g}'):.6g}"
    return text if amount > 0 else f"1/{text}" if amount > -0.1 else f"{1 + amount:.3g}"


def _unit(unit: str) -> str:
    return f" {unit}" if unit not in ("", "-") else ""


def _axes(graph: Graph, table: Parameter) -> tuple[str, ...]:
    """What lies on each axis of a table: as the table says, else as the function looks it up, else x, y, z, w."""
    lookup = next((n.args for n in graph.nodes if n.op == "lookup" and n.payload == table.name), ())
    names = {at: name for name, at in graph.names.items()}
    names |= {at: graph.nodes[at].payload for at in lookup if graph.nodes[at].op == "input"}
    fed = [names.get(at, direction) for at, direction in zip(lookup, DIRECTIONS, strict=False)]
    return tuple(axis.input or axis.name or given for axis, given in zip(table.index_axes, fed, strict=False))


def listed(items: Sequence[str], word: str = "and") -> str:
    """Join items as in a sentence.

    >>> listed(["A", "B", "C"])
    'A, B and C'
    """
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {word} {items[-1]}"
