"""Sentences that describe poorly determined directions of a result, each with a remedy."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.constraints import Pin
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.rbf import RBF
from kennfeld.graph import Graph
from kennfeld.optimize.trust.remedies import Remedy
from kennfeld.optimize.trust.table_changes import TableChange, WeakDirection

PERCENT = 0.01
MAX_NAMED = 3  # grid points of a table that a sentence names
MAX_LISTED = 8  # grid points of a table that a remedy lists
MIN_POINT_SHARE = 0.3  # of the strongest grid point that another needs to be named
MIN_TABLE_SHARE = 0.3  # of the strongest table that another needs to be named
DETERMINED = 0.01  # standard deviation, relative to the values, up to which a direction is known well enough
RELATIVE = ("scale", "stretch", "follow")
ORDER = ("scale", "stretch", "offset", "follow", "shift")
Amounts = Sequence[tuple[TableChange, float]]


@dataclass(frozen=True)
class Direction:
    """A joint change of values that has no or almost no effect on the training data.

    Attributes:
        sentence: description of the change and of what determines it, if anything.
        remedy: what would determine it.
        parts: the change described, by parameter, in the shape and unit of its values.
        exact: True if the data do not constrain the change at all.
        ratio: cost of the change relative to its cost if each value changed alone; 0 if nothing determines it.
        deviation: standard deviation of the values along the change, as a multiple of it; inf if undetermined.
        remedies: the part of `remedy` that a project can apply; any of them is enough.
        determined: True if the data couple the values, but determine them to 1 %.
    """

    sentence: str
    remedy: str
    parts: Mapping[str, Float]
    exact: bool
    ratio: float
    deviation: float
    remedies: tuple[Remedy, ...] = ()
    determined: bool = False

    def __str__(self) -> str:
        return f"{self.sentence} {self.remedy}".strip()


class Describer:
    """Describes directions around the calibrated `parameters` of a function.

    Args:
        graph: the function.
        parameters: the calibrated parameters.
        start: the parameters before the calibration.
        samples: number of training samples at each value, by parameter and axis with free breakpoints.
        free_axes: for each axis with free breakpoints a table on it, and the number of the axis in that table.
        admits: returns True if a change of all values, Float[values], keeps their bounds and limits.
    """

    def __init__(
        self,
        graph: Graph,
        parameters: ParameterSet,
        start: ParameterSet,
        samples: Mapping[str, Int],
        free_axes: Mapping[str, tuple[str, int]],
        admits: Callable[[Float], bool] = lambda change: True,
    ) -> None:
        self._parameters, self._start, self._samples, self._admits = parameters, start, samples, admits
        self._free_axes = {name: parameters[table].axes[number] for name, (table, number) in free_axes.items()}
        self.layers = graph.layers
        self._axes = {name: _axes(graph, parameters[name]) for name in samples if name not in free_axes}

    def uninformed(self, name: str, where: Bool) -> Direction:
        """Describe values of one table that neither data nor smoothness determine."""
        if name in self._free_axes:
            return self._describe_uninformed_breakpoints(name, where)
        single = np.count_nonzero(where) == 1
        start, lock = ("its start value", "lock it") if single else ("their start values", "lock them")
        smooth = self._samples[name].any() and _has_smoothness(self._parameters[name])
        record = "Start from other weights" if name in self.layers else "Record samples there"
        remedies = [record, *([f"set a smoothness for {name}"] if smooth else []), lock]
        sources = "the data" if name in self.layers else "data or smoothness"
        sentence = f"Not determined by {sources}, kept at {start}: {self._some_values(name, where)}."
        choices = (*([Remedy(smoother=(name,))] if smooth else []), Remedy(locks={name: where}))
        return _undetermined(sentence, f"{join_items(remedies, 'or')}.", name, where, choices)

    def searched(self, name: str, where: Bool, intervals: Float) -> Direction:
        """Describe values that a global search moved, although small changes of them have no effect.

        `intervals` are the lower and upper ends between which the cost is the same, of shape (2, shape of the table).
        """
        known = where & np.isfinite(intervals).all(axis=0)
        ranges = [
            f"{name}{f' at {place}' if (place := self.place(name, at)) else ''} between "
            f"{intervals[0][tuple(at)]:.6g} and {intervals[1][tuple(at)]:.6g}"
            for at in np.argwhere(known)[:MAX_NAMED].tolist()
        ]
        flat = f", for {join_items(ranges)}; beyond, the function switches at other samples and" if ranges else ";"
        their = "its" if np.count_nonzero(where) == 1 else "their"
        sentence = (
            f"The search moved {self._some_values(name, where)}, but the cost is flat around the result{flat} "
            f"{their} uncertainty is unknown."
        )
        return _undetermined(sentence, "Simulate with neighbouring values.", name, where)

    def jumping(self, name: str, where: Bool) -> Direction:
        """Describe values as which change the cost jumps, without a derivative."""
        single = np.count_nonzero(where) == 1
        sentence = (
            f"The cost jumps as {self._some_values(name, where)} {'changes' if single else 'change'}, which "
            f"derivatives do not show; kept at {'its start value' if single else 'their start values'}."
        )
        remedy = f'Search with method = "global", and bounds for {name}.'
        return _undetermined(sentence, remedy, name, where, (Remedy(locks={name: where}),))

    def _some_values(self, name: str, where: Bool) -> str:
        count = int(np.count_nonzero(where))
        if name in self.layers:
            return name_weights(name, count, where.size)
        if count == where.size:
            return name if count == 1 else f"all values of {name}"
        places = [self.place(name, at) for at in np.argwhere(where)[:MAX_NAMED].tolist()]
        more = ", ..." if count > MAX_NAMED else ""
        return f"{count} of {where.size} values of {name} ({', '.join(places)}{more})"

    def places(self, name: str, where: Bool) -> str:
        """Name the marked values of a parameter by their coordinates, or count them if the list would be long."""
        count = int(np.count_nonzero(where))
        if count == where.size:
            return name if count == 1 else f"all {count} {self._noun(name)} of {name}"
        if count > (MAX_NAMED if name in self.layers else MAX_LISTED):
            return f"{count} of the {where.size} {self._noun(name)} of {name}"
        return f"{name} at {join_items([self.place(name, at) for at in np.argwhere(where).tolist()])}"

    def _noun(self, name: str) -> str:
        return "weights" if name in self.layers else "values"

    def _describe_uninformed_breakpoints(self, name: str, where: Bool) -> Direction:
        numbers = np.flatnonzero(where).tolist()
        breakpoints = [self._breakpoint(name, i) for i in numbers[:MAX_NAMED]]
        breakpoints += ["..."] if len(numbers) > MAX_NAMED else []
        stays = "It stays where it is" if len(numbers) == 1 else "They stay where they are"
        sentence = (
            f"The position of {join_items(breakpoints)} of {name} is not determined: "
            f"the tables are flat there or have no data. {stays}."
        )
        choices = Remedy(coarser=(name,)), Remedy(axes=(name,))
        return _undetermined(sentence, "Use fewer breakpoints on this axis, or fix them.", name, where, choices)

    def named(self, weak: WeakDirection, parts: Mapping[str, Float], *, scaled: bool = True) -> Direction:
        """Describe a direction that consists of table changes.

        Args:
            weak: the direction.
            parts: its changes of each parameter.
            scaled: True if its effect is that of factors, False if it is that of differences.
        """
        ordered = sorted(weak.amounts, key=lambda pair: ORDER.index(pair[0].kind))
        first, first_amount = ordered[0]
        # the amount of the first table change is round; all others follow in proportion
        unit = self._possible(weak, self._round_amount(first) / first_amount)
        amounts = [(shape, amount * unit) for shape, amount in ordered]
        size = abs(amounts[0][1]) * weak.deviation / abs(unit)  # as an amount of the first table change
        text = f"{100 * size:.2g} %" if first.kind in RELATIVE else f"{size:.2g}{self._unit_of(first)}"
        verbs = [self._verb(shape, amount) if scaled else self._difference(shape, amount) for shape, amount in amounts]
        changed = {name: part * unit for name, part in parts.items() if np.any(part)}
        remedy, choices = self._pin(amounts, changed, exact=weak.exact)
        sizes = [abs(amount) / self._round_amount(shape) for shape, amount in amounts]
        relative = max(sizes) * PERCENT * weak.deviation / abs(unit)
        sentence = f"{_clauses(verbs)} {_effect(weak, text, relative)}."
        return _direction(weak, unit, sentence, remedy, changed, choices, relative)

    def by_points(self, weak: WeakDirection, parts: Mapping[str, Float], weights: Mapping[str, Float]) -> Direction:
        """Describe a direction by its strongest grid points; `weights` are the effect of each value on the data."""
        shares = _shares(weights)
        names = self.strongest(weights)
        first = int(shares[names[0]].argmax())
        unit = self._possible(weak, PERCENT * self._typical_size(names[0]) / float(parts[names[0]].ravel()[first]))
        verbs = [v for name in names for v in self._points(name, parts[name] * unit, shares[name])]
        reference = "mean distance of breakpoints" if names[0] in self._free_axes else "largest value"
        relative = PERCENT * weak.deviation / abs(unit)
        size = f"{100 * relative:.2g} % of the {reference} of {names[0]}"
        changed = {name: part * unit for name, part in parts.items() if np.any(part)}
        sentence = f"{_clauses(verbs)}{' together' if len(verbs) > 1 else ''} {_effect(weak, size, relative)}."
        remedy, choices = self._separation_remedy(names), self._separations(names)
        return _direction(weak, unit, sentence, remedy, changed, choices, relative)

    def second_minimum(
        self,
        weak: WeakDirection,
        along: Mapping[str, Float],
        parts: Mapping[str, Float],
        costs: tuple[float, float],
        *,
        equal: bool,
    ) -> Direction:
        """Describe values that fit as well as those found, or better.

        Args:
            weak: the direction in which they are.
            along: its changes of each parameter.
            parts: the change to these values, by parameter.
            costs: here and there.
            equal: True if noise may have decided which cost is lower.
        """
        towards = self.named(weak, along)
        clauses = [self._two_values(name, parts[name]) for name in towards.parts if np.any(parts[name])]
        here, there = (f"{cost:.6g}" for cost in costs)
        fits = "equally well" if equal else "better"
        sentence = f"Other values fit {fits} (cost {here} here, {there} there): {'; '.join(clauses)}."
        remedy = towards.remedy if equal else f"Start from those values. {towards.remedy}"
        changed = {name: part for name, part in parts.items() if np.any(part)}
        return Direction(sentence, remedy, changed, False, towards.ratio, 1.0, towards.remedies)

    def _possible(self, weak: WeakDirection, amount: float) -> float:
        """Return an amount of a direction, or its opposite if only that keeps the limits."""
        backwards = not self._admits(amount * weak.change) and self._admits(-amount * weak.change)
        return -amount if backwards else amount

    def _two_values(self, name: str, change: Float) -> str:
        """Name the value of a table that changes most, and what it is here and there."""
        values = self._parameters[name].values
        at = np.unravel_index(int(np.abs(change).argmax()), change.shape)
        place = f" at {self.place(name, at)}" if values.ndim else ""
        return f"{name}{place} is {values[at]:.4g} here and {values[at] + change[at]:.4g} there"

    def strongest(self, weights: Mapping[str, Float]) -> list[str]:
        """Return the tables with a large part in a direction, largest first; `weights` as in `by_points`."""
        strength = {name: float(share.max()) for name, share in _shares(weights).items()}
        ranked = sorted(strength, key=lambda name: (-strength[name], name not in self._free_axes))
        return [name for name in ranked if strength[name] >= MIN_TABLE_SHARE]

    def _typical_size(self, name: str) -> float:
        if name in self._free_axes:
            return float(np.diff(self._free_axes[name].breakpoints).mean())
        return float(np.abs(np.nan_to_num(self._parameters[name].values)).max()) or 1.0

    def _round_amount(self, shape: TableChange) -> float:
        """Return an amount for the sentence: 1 %, or a round number."""
        if shape.kind in RELATIVE:
            return PERCENT
        if shape.kind == "shift":
            points = self._parameters[shape.table].index_axes[shape.axis].breakpoints
            return _round(PERCENT * float(np.ptp(points)))
        return _round(PERCENT * self._typical_size(shape.table))

    def _verb(self, shape: TableChange, amount: float) -> tuple[str, str]:
        more = "raising" if amount > 0 else "lowering"
        match shape.kind:
            case "scale":
                return "scaling", f"{shape.table} by {_factor(amount)}"
            case "stretch":
                return "stretching", f"{shape.table} about {shape.about:.4g} by {_factor(amount)}"
            case "follow":
                return more, f"{shape.table} by {abs(amount):.2g} times {shape.other}"
            case "shift":
                axis = self._axes[shape.table][shape.axis]
                return "shifting", f"{shape.table} along {axis} by {amount:.2g}{self._unit_of(shape)}"
            case "offset":
                return more, f"{shape.table} by {abs(amount):.2g}{self._unit_of(shape)}"

    def _difference(self, shape: TableChange, amount: float) -> tuple[str, str]:
        """Return `_verb` of a change that is a difference, not a factor."""
        table = self._parameters[shape.table]
        if shape.kind != "scale":
            return self._verb(shape, amount)
        change = amount * (float(table.values.ravel()[0]) if table.size == 1 else 1.0)
        size = f"{abs(change):.2g}{self._unit_of(shape)}" if table.size == 1 else f"{100 * abs(change):.2g} %"
        return "raising" if change > 0 else "lowering", f"{shape.table} by {size}"

    def _unit_of(self, shape: TableChange) -> str:
        """Return the unit of the amount of an offset or a shift, after a blank; empty without unit."""
        table = self._parameters[shape.table]
        unit = table.index_axes[shape.axis].unit if shape.kind == "shift" else table.unit
        return f" {unit}" if unit not in ("", "-") else ""

    def _points(self, name: str, part: Float, weight: Float) -> list[tuple[str, str]]:
        """Return verb and object for the strongest grid points of a table: those raised, those lowered."""
        if name in self.layers:
            return [("changing", f"weights of {name}")]
        order = np.argsort(-weight, axis=None, kind="stable")
        some = int(np.count_nonzero(part)) > MAX_NAMED
        chosen = [int(i) for i in order[:MAX_NAMED] if weight.flat[i] >= MIN_POINT_SHARE * weight.flat[order[0]]]
        # if more values change than a sentence can name, the strongest one stands for all
        chosen = chosen[:1] if some else chosen
        if name in self._free_axes:
            others = " and others" if some else ""
            verbs = ["raising" if part.flat[i] > 0 else "lowering" for i in chosen]
            return [(v, f"{self._breakpoint(name, i)}{others} of {name}") for v, i in zip(verbs, chosen, strict=True)]
        clauses = []
        for sign, verb in ((1, "raising"), (-1, "lowering")):
            places = [
                self.place(name, np.unravel_index(i, part.shape)) for i in chosen if np.sign(part.flat[i]) == sign
            ]
            if places:
                preposition = "around" if some else "at"
                at = f" {preposition} {join_items(places)}" if any(places) else ""  # a scalar has no place
                clauses.append((verb, f"{name}{at}"))
        return clauses

    def _breakpoint(self, name: str, number: int) -> str:
        return f"the {_ordinal(number + 1)} breakpoint ({self._free_axes[name].breakpoints[number]:.6g})"

    def _pin(self, amounts: Amounts, parts: Mapping[str, Float], *, exact: bool) -> tuple[str, tuple[Remedy, ...]]:
        """Return the advice to fix one value, of the smallest table that is not merely shifted, as text and data.

        The value is that of the fit. If nothing determines the scale of the table, that of the start is as good, and
        often known: an efficiency of 1 at its maximum.
        """
        shape, _ = min(amounts, key=lambda pair: (pair[0].kind == "shift", self._parameters[pair[0].table].size))
        name, table = shape.table, self._parameters[shape.table]
        if table.size == 1:
            bounded = np.isfinite(table.lower).all() and np.isfinite(table.upper).all()
            advice = f"Fix {name}." if bounded else f"Fix {name}, or set bounds for it."
            return advice, (Remedy(locks={name: np.ones(table.values.shape, dtype=bool)}),)
        start = np.nan_to_num(self._start[name].values)
        scale_is_open = exact and shape.kind == "scale" and float(np.ptp(start)) > 0
        strength = np.abs(start if scale_is_open else parts[name])
        # of equally strong grid points, the one with most samples
        best = np.where(strength >= (1 - 1e-6) * strength.max(), self._samples[name], -1)
        at = np.unravel_index(int(best.argmax()), best.shape)
        value = table.values[at]
        if scale_is_open and _can_be_scaled(table, at, start[at]):
            value = start[at]
        advice = f"Pin a known value of {name}, e.g. at {self.place(name, at).strip('()')} to {value:.4g}."
        return advice, (self._fixed_value(table, at, float(value)),)

    def _fixed_value(self, table: Parameter, at: tuple[Any, ...], value: float) -> Remedy:
        """Return a pin, or a lock if a pin has no fixed coordinates."""
        # coordinates on an axis with free breakpoints move away from a pin
        if not any(axis.free for axis in table.axes):
            places = (float(axis.breakpoints[i]) for axis, i in zip(table.index_axes, at, strict=True))
            return Remedy(pins=(Pin(table.name, tuple(places), value),))
        where = np.zeros(table.values.shape, dtype=bool)
        where[at] = True
        return Remedy(locks={table.name: where})

    def place(self, name: str, at: Iterable[Any]) -> str:
        """Return the coordinates of a grid point, empty for a scalar; the name of a coefficient of an RBF."""
        parameter = self._parameters[name]
        if isinstance(parameter, RBF):
            return parameter.value_name(int(next(iter(at))))
        values = [f"{axis.breakpoints[i]:.6g}" for axis, i in zip(parameter.index_axes, at, strict=True)]
        if len(values) == 1:
            return values[0]
        coordinates = ", ".join(f"{axis} {value}" for axis, value in zip(self._axes[name], values, strict=True))
        return f"({coordinates})" if coordinates else ""

    def _separation_remedy(self, names: Sequence[str]) -> str:
        axes = [name for name in names if name in self._free_axes]
        if len(axes) == len(names):
            return "Use fewer breakpoints on this axis, or fix them."
        parameters = [name for name in names if name not in self._free_axes]
        if self.layers.intersection(names):
            return f"Lock {join_items(parameters, 'or')}."
        if all(self._parameters[name].kind == "rbf" for name in parameters):
            return f"Record more samples, or use fewer centres for {join_items(parameters)}."
        scalars = self._scalars(parameters)
        if scalars:  # whether smoothness would determine the tables beside them depends on their shape
            return f"Fix {join_items(scalars, 'or')}, or record samples that distinguish them."
        tables = self._smoothable(parameters)
        last = f"increase the smoothness of {join_items(tables, 'or')}" if tables else "lock one of them"
        remedies = ["Record samples that distinguish them", *(f"use fewer breakpoints for {name}" for name in axes)]
        return f"{', '.join(remedies)}, or {last}."

    def _scalars(self, names: Sequence[str]) -> list[str]:
        return [name for name in names if self._parameters[name].size == 1]

    def _smoothable(self, names: Sequence[str]) -> list[str]:
        return [name for name in names if _has_smoothness(self._parameters[name])]

    def _separations(self, names: Sequence[str]) -> tuple[Remedy, ...]:
        """Return `_separation_remedy` as data."""
        axes = [name for name in names if name in self._free_axes]
        parameters = [name for name in names if name not in self._free_axes]
        if parameters and all(self._parameters[name].kind == "rbf" for name in parameters):
            return ()
        if scalars := self._scalars(parameters):
            return tuple(Remedy(locks={name: np.ones(self._parameters[name].values.shape, bool)}) for name in scalars)
        smoothable = [] if self.layers.intersection(names) else self._smoothable(parameters)
        smoother = [Remedy(smoother=(name,)) for name in smoothable]
        sizes = {name: self._parameters[name].values.shape for name in ([] if smoother else parameters)}
        locks = [Remedy(locks={name: np.ones(shape, dtype=bool)}) for name, shape in sizes.items()]
        fixed = [Remedy(axes=(name,)) for name in ([] if parameters else axes)]
        return (*(Remedy(coarser=(name,)) for name in axes), *smoother, *locks, *fixed)


def _can_be_scaled(table: Parameter, at: tuple[Any, ...], value: float) -> bool:
    """Return True if a factor gives one value of a table without moving another one out of its bounds."""
    factor = value / table.values[at] if table.values[at] else -1.0
    scaled = factor * table.values
    within = (scaled >= table.lower) & (scaled <= table.upper)
    return factor > 0 and bool(np.all(within | ~np.isfinite(scaled)))


def _has_smoothness(table: Parameter) -> bool:
    """Return if a smoothness can act on a table: it has breakpoints, not only positions, and three of them."""
    return any(len(axis) > 2 for axis in table.axes)


def _shares(weights: Mapping[str, Float]) -> dict[str, Float]:
    strongest = max(float(weight.max()) for weight in weights.values())
    # rounded, so that rounding errors decide no order
    return {name: np.round(weight / strongest, 6) for name, weight in weights.items()}


def name_weights(layer: str, count: int, size: int) -> str:
    """Return how many weights of a layer are meant.

    >>> name_weights("net.layer1", 3, 48), name_weights("net.layer1", 48, 48)
    ('3 of 48 weights of net.layer1', 'all 48 weights of net.layer1')
    """
    return f"all {size} weights of {layer}" if count == size else f"{count} of {size} weights of {layer}"


def _undetermined(sentence: str, remedy: str, name: str, where: Bool, remedies: tuple[Remedy, ...] = ()) -> Direction:
    return Direction(sentence, remedy, {name: where.astype(np.float64)}, True, 0.0, float("inf"), remedies)


def _direction(
    weak: WeakDirection,
    unit: float,
    sentence: str,
    remedy: str,
    changed: Mapping[str, Float],
    remedies: tuple[Remedy, ...],
    relative: float,
) -> Direction:
    deviation, known = weak.deviation / abs(unit), _is_determined(weak, relative)
    return Direction(sentence, remedy, changed, weak.exact, weak.ratio, deviation, remedies, known)


def _is_determined(weak: WeakDirection, relative: float) -> bool:
    """Return True if the data determine a direction up to a small standard deviation, relative to the values."""
    return relative < DETERMINED and not weak.mainly_smooth and not weak.exact


def _effect(weak: WeakDirection, size: str, relative: float) -> str:
    if _is_determined(weak, relative):
        return f"has little effect on the fit: coupled, but determined (standard deviation {size})"
    some = "no" if weak.exact else "almost no"
    if not np.isfinite(weak.deviation):
        return f"has {some} effect on the fit"
    if weak.exact:
        return f"has no effect on the data; it is determined by smoothness alone (standard deviation {size})"
    mainly = "; it is determined mainly by smoothness" if weak.mainly_smooth else ""
    return f"has almost no effect on the fit{mainly} (standard deviation {size})"


def _ordinal(number: int) -> str:
    """Return an ordinal number in words, or in digits above ten.

    >>> _ordinal(3), _ordinal(12), _ordinal(21)
    ('third', '12th', '21st')
    """
    small = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth", "tenth")
    if number <= len(small):
        return small[number - 1]
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"


def _clauses(verbs: Sequence[tuple[str, str]]) -> str:
    """Join clauses of verb and object, without repeating a verb."""
    clauses = [rest if i and verbs[i - 1][0] == verb else f"{verb} {rest}" for i, (verb, rest) in enumerate(verbs)]
    text = join_items(clauses)
    return f"{text[0].upper()}{text[1:]}"


def _round(value: float) -> float:
    """Round down to 1, 2 or 5 times a power of ten.

    >>> _round(0.55), _round(3.0)
    (0.5, 2.0)
    """
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)))


def _factor(amount: float) -> str:
    """Return 1 + amount in few digits; slightly below 1 as the inverse of a factor above 1.

    >>> _factor(0.01), _factor(-0.0100004), _factor(-0.5)
    ('1.01', '1/1.01', '0.5')
    """
    text = f"{1 + float(f'{abs(amount):.2g}'):.6g}"
    return text if amount > 0 else f"1/{text}" if amount > -0.1 else f"{1 + amount:.3g}"


def _axes(graph: Graph, table: Parameter) -> tuple[str, ...]:
    """Name the axes of a table: by the table itself, else by the coordinates of its lookup, else x, y, z, w."""
    if table.name in graph.layers:
        return "row", "column"
    lookup = next((n.args for n in graph.nodes if n.op == "lookup" and n.payload == table.name), ())
    names = {at: name for name, at in graph.names.items()}
    names |= {at: graph.nodes[at].payload for at in lookup if graph.nodes[at].op == "input"}
    coordinates = [names.get(at, letter) for at, letter in zip(lookup, AXIS_LETTERS, strict=False)]
    return tuple(axis.input or axis.name or name for axis, name in zip(table.index_axes, coordinates, strict=False))


def join_items(items: Sequence[str], word: str = "and") -> str:
    """Join items as in a sentence.

    >>> join_items(["A", "B", "C"])
    'A, B and C'
    """
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {word} {items[-1]}"
