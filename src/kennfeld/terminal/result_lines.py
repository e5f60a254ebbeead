"""What a calibration chose by itself, as lines for a person.

What a result leaves open, in a few lines.

A data-driven model in words.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kennfeld.optimize import Result
from kennfeld.optimize.quality import r2_text
from kennfeld.optimize.trust import Trust
from kennfeld.surrogate import DynamicSurrogate, Surrogate
from kennfeld.terminal.output import aligned

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation

__all__ = [
    "choices",
    "described",
    "extrapolation_lines",
    "quality_table",
    "ranges_table",
    "summary",
    "undetermined_lines",
]

MOST = 3  # lines of a kind


def choices(result: Result) -> list[str]:
    """A line for each table with automatic smoothness, and for each channel whose shift was found."""
    shifts = [
        f"shift of {channel} in {name}: {shift:g}"
        for name, channels in result.shifts.items()
        for channel, shift in channels.items()
    ]
    return [
        *shifts,
        *(
            f"smoothness of {name}: {', '.join(f'{axis} {factor:.3g}' for axis, factor in factors.items())}"
            for name, factors in result.smoothness.items()
        ),
    ]


def undetermined_lines(trust: Trust) -> list[str]:
    """The worst directions that the data do not determine, and what limits of outputs hold, a line each.

    Each kind under a heading; nothing where there is none. A search that did not come to its end says so first. If
    nothing determines several changes, their number comes first, with what settles all of them.
    """
    remark = [trust.remark] if trust.remark else []
    outputs = [holding for holding in trust.holdings if holding.samples]  # the message tells of breakpoints
    whole = [f"  {trust.null_space}"] if trust.null_space.dimension > 1 else []
    heading, *directions = _listed("What the data leave open:", trust.directions) or ["What the data leave open:"]
    return [
        *remark,
        *([heading, *whole, *directions] if whole or directions else []),
        *_listed("What limits hold:", outputs),
    ]


def extrapolation_lines(found: "Sequence[Extrapolation]", where: str = "; see result.json") -> list[str]:
    """The surrogates that are used outside their data, the largest share first; `where` tells of the others."""
    outside = sorted((row for row in found if row.worst is not None), key=lambda row: -row.share)
    return _listed("What leaves the data of surrogates:", outside, where)


def _listed(heading: str, found: Sequence[object], where: str = "; see result.json") -> list[str]:
    more = [f"  and {len(found) - MOST} more{where}"] if len(found) > MOST else []
    return [heading, *(f"  {one}" for one in found[:MOST]), *more] if found else []


def summary(surrogate: Surrogate) -> list[str]:
    """What it is, how it was checked, and how well it meets its recordings."""
    lines = [described(surrogate)]
    if isinstance(surrogate, DynamicSurrogate) and surrogate.stability:
        lines.append(surrogate.stability)
    return [*lines, "", *aligned(quality_table(surrogate))]


def described(surrogate: Surrogate) -> str:
    """One sentence: inputs, lags, size."""
    centres = f"{surrogate.expansion.size} centres"
    if not isinstance(surrogate, DynamicSurrogate):
        return f"{surrogate.output} = {surrogate.name}({', '.join(surrogate.inputs)}), {centres}"
    lags = [f"{name} at {_list_inputs(own)}" for name, own in zip(surrogate.inputs, surrogate.lags, strict=True)]
    looks = "; ".join([*lags, f"itself at {_list_inputs(surrogate.output_lags)}"])
    called = f"{surrogate.output} = {surrogate.name}({', '.join(surrogate.inputs)})"
    return f"{called}, steps of {surrogate.step:g} s, {centres}; samples back: {looks}"


def _list_inputs(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers)) or "none"


def quality_table(surrogate: Surrogate) -> list[list[str]]:
    """A row a dataset and way of running it."""
    rows = [["dataset", "use", "mode", "samples", "RMSE", "R2", "max |error|"]]
    rows += [
        [
            q.dataset,
            q.use,
            q.mode,
            str(q.samples),
            f"{q.rmse:.4g}",
            r2_text(q.r2, q.samples, q.rmse),
            f"{q.max_abs:.4g}",
        ]
        for q in surrogate.quality
    ]
    return rows


def ranges_table(surrogate: Surrogate) -> list[list[str]]:
    """A row an input, and for the output that is fed back: between which numbers the training data lie."""
    rows = [["trained on", "unit", "from", "to"]]
    validity = surrogate.validity
    if validity is None:
        return rows
    names, lags = [*surrogate.inputs], [1] * len(surrogate.inputs)
    if isinstance(surrogate, DynamicSurrogate):
        names = [surrogate.output, *surrogate.inputs]
        lags = [len(surrogate.output_lags), *map(len, surrogate.lags)]
    units = dict(zip([*surrogate.inputs, surrogate.output], surrogate.units, strict=False))
    first = 0
    for name, count in zip(names, lags, strict=True):
        part = slice(first, first + count)
        first += count
        if count:
            ends = validity.least[part].min(), validity.most[part].max()
            rows.append([name, units.get(name, ""), *(f"{end:.6g}" for end in ends)])
    return rows
