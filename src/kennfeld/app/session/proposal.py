"""Proposals for what a project lacks: tables with axes from the data, scalars, the channel of the criterion."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from kennfeld.base.errors import InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph.traversal import coordinates_of
from kennfeld.models import Model
from kennfeld.models.formula import formula
from kennfeld.models.model_function import ModelFunction
from kennfeld.project.value_forms import DIRECTIONS

SMOOTHNESS = 0.1  # so that values beside the data follow their neighbours
POINTS = {1: 10, 2: 10, 3: 6, 4: 4}  # along each axis, by number of axes


@dataclass(frozen=True)
class Range:
    """Least and greatest value of a channel over the files."""

    least: float
    greatest: float


@dataclass(frozen=True)
class KeyChoice:
    """A key, by path, whose value the user chooses among options."""

    path: tuple[str | int, ...]
    options: Sequence[str]


@dataclass(frozen=True)
class Proposal:
    """Something that the project lacks.

    Attributes:
        title: what it is: `map MapX over Speed, Load`.
        changes: the keys that provide it, by path.
        choice: a key that only the user knows.
    """

    title: str
    changes: Sequence[tuple[tuple[str | int, ...], Any]]
    choice: KeyChoice | None = None


def read_function(
    text: str, functions: Collection[ModelFunction] = (), known: Collection[str] | None = None
) -> Model | None:
    """Return the function of a formula text; None if the text has errors.

    Args:
        text: formula text.
        functions: functions of other tools that it calls.
        known: names of the parameters; None takes every unknown name for a table or an input.
    """
    try:
        return formula(text, parameters=known, functions=tuple(functions))
    except InputError:
        return None


def propose(
    function: Model,
    settings: Mapping[str, Any],
    known: Sequence[str],
    channels: Mapping[str, Range],
    declared: Collection[str] = (),
) -> Iterator[Proposal]:
    """Yield what the function needs and the project lacks.

    Args:
        function: the function, see `read_function`.
        settings: the tables of the project file.
        known: parameters that the initial files provide.
        channels: channels of the files, by name.
        declared: inputs that the function declares, which are not parameters.
    """
    mapped: Mapping[str, str] = settings.get("channels", {})
    own = {*known, *function.values, *settings.get("parameters", {})}
    for name, count in function.graph.parameters.items():
        if name not in own:
            yield _table(function, name, count, mapped, channels)
    for name in function.graph.inputs:
        channel = mapped.get(name, name)
        if channel in channels or name in own or name in settings.get("calculated", {}):
            continue
        if name in declared:
            if channels:
                choice = KeyChoice(("channels", name), list(channels))
                yield Proposal(f"{name} reads the channel", [(("channels", name), "")], choice)
        else:
            # an input that no channel has may be a parameter, which a section of its name makes it
            yield Proposal(f"scalar {name}", [(("parameters", name), {"initial": 1.0})])
    if not settings.get("criterion"):
        yield from _criterion(function, mapped, channels)


def _table(
    function: Model, name: str, count: int, mapped: Mapping[str, str], channels: Mapping[str, Range]
) -> Proposal:
    inputs = coordinates_of(function.graph, name)
    if not count:
        return Proposal(f"scalar {name}", [(("parameters", name), {"initial": 1.0})])
    kind = {1: "curve", 2: "map"}.get(count, "cube")
    table: dict[str, Any] = {}
    for direction, quantity in zip(DIRECTIONS, [*inputs, *[""] * count][:count], strict=False):
        reach = channels.get(mapped.get(quantity, quantity))
        axis: dict[str, Any] = {"input": quantity} if quantity else {}
        if reach is None:
            # over an inner node, whose range a trial finds, see `trial`
            axis |= {"begin": 0, "end": 1, "count": POINTS[count]}
        else:
            axis["breakpoints"] = even_breakpoints(reach, POINTS[count])
        table[direction] = axis
    table |= {"initial": 1.0, "smoothness": SMOOTHNESS}
    over = f" over {', '.join(inputs)}" if inputs else ""
    return Proposal(f"{kind} {name}{over}", [(("parameters", name), table)])


def even_breakpoints(reach: Range, count: int) -> list[float]:
    """Return about `count` evenly spaced round breakpoints that cover a range.

    >>> even_breakpoints(Range(812.0, 3978.0), 8)
    [500, 1000, 1500, 2000, 2500, 3000, 3500, 4000]
    """
    span = reach.greatest - reach.least
    if not (span > 0 and math.isfinite(span)):
        return [reach.least, reach.least + 1.0]
    raw = span / max(count - 1, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    # the nearest round step by ratio, so that 2 and 8 are equally far from 4
    step = min((factor * power for factor in (1, 2, 5, 10)), key=lambda each: abs(math.log(each / raw)))
    # an end that exceeds a breakpoint by rounding needs no further one
    first, last = math.floor(reach.least / step + 1e-9), math.ceil(reach.greatest / step - 1e-9)
    points = [float(f"{number * step:.12g}") for number in range(first, last + 1)]
    return [int(point) if point.is_integer() else point for point in points]


def _criterion(function: Model, mapped: Mapping[str, str], channels: Mapping[str, Range]) -> Iterator[Proposal]:
    """Yield the criterion: the node that is named like a channel, or the last output with a channel to choose."""
    outputs = function.graph.outputs or tuple(function.graph.names)[-1:]
    used = {mapped.get(name, name) for name in function.graph.inputs}
    # an input or the time is hardly what the function is to reproduce
    unused = [name for name in channels if name not in used and name.lower() not in ("time", "t")]
    if not outputs or not unused:
        return
    node = next((name for name in outputs if name in unused), outputs[-1])
    target = node if node in unused else unused[0] if len(unused) == 1 else ""
    entry = {"node": node, "target": {"channel": target}}
    choice = None if target else KeyChoice(("criterion", 1, "target", "channel"), unused)
    yield Proposal(f"{node} follows {target or 'the channel'}", [(("criterion", 1), entry)], choice)
