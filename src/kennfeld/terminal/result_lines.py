"""Lines on the result of a calibration, and on a trained surrogate."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kennfeld.optimize.quality import r2_text
from kennfeld.optimize.result import Result
from kennfeld.optimize.trust.trust import Trust
from kennfeld.surrogate.surrogate_file import Surrogate
from kennfeld.surrogate.surrogate_models import DynamicSurrogate
from kennfeld.terminal.output import aligned

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation


MAX_LINES = 3  # under one heading
UNDETERMINED = "Parameters not determined by the data:"


def choice_lines(result: Result) -> list[str]:
    """Return a line for each estimated shift, and for each table with automatic smoothness."""
    shifts = [
        f"shift of {channel} in {name}: {shift:g}"
        for name, channels in result.shifts.items()
        for channel, shift in channels.items()
    ]
    factors = [
        f"smoothness of {name}: {', '.join(f'{axis} {factor:.3g}' for axis, factor in by_axis.items())}"
        for name, by_axis in result.smoothness.items()
    ]
    return shifts + factors


def undetermined_lines(trust: Trust) -> list[str]:
    """Return the directions that the data determine worst, and the active output limits, each under a heading.

    The remark on a search that did not converge comes first. If several directions are undetermined, their number and
    a remedy for all of them come before the single ones.
    """
    remark = [trust.remark] if trust.remark else []
    outputs = [limit for limit in trust.holdings if limit.samples]  # the message names those of breakpoints
    null_space = [f"  {trust.null_space}"] if trust.null_space.dimension > 1 else []
    directions = _section(UNDETERMINED, trust.directions)
    if null_space:
        directions = [UNDETERMINED, *null_space, *directions[1:]]
    return [*remark, *directions, *_section("Active output limits:", outputs)]


def extrapolation_lines(extrapolations: "Sequence[Extrapolation]", pointer: str = "; see result.json") -> list[str]:
    """Return the surrogates used outside their training data, the largest share first.

    Args:
        extrapolations: one row for each surrogate.
        pointer: where to find the rows that are not listed.
    """
    outside = sorted((row for row in extrapolations if row.worst is not None), key=lambda row: -row.share)
    return _section("Surrogate extrapolation:", outside, pointer)


def _section(heading: str, items: Sequence[object], pointer: str = "; see result.json") -> list[str]:
    more = [f"  and {len(items) - MAX_LINES} more{pointer}"] if len(items) > MAX_LINES else []
    return [heading, *(f"  {item}" for item in items[:MAX_LINES]), *more] if items else []


def summarize_surrogate(surrogate: Surrogate) -> list[str]:
    """Return lines on a surrogate: its structure, its stability check, and its quality by dataset."""
    lines = [describe_surrogate(surrogate)]
    if isinstance(surrogate, DynamicSurrogate) and surrogate.stability:
        lines.append(surrogate.stability)
    return [*lines, "", *aligned(quality_table(surrogate))]


def describe_surrogate(surrogate: Surrogate) -> str:
    """Return a sentence with the inputs, lags and size of a surrogate."""
    call = f"{surrogate.output} = {surrogate.name}({', '.join(surrogate.inputs)})"
    centres = f"{surrogate.expansion.size} centres"
    if not isinstance(surrogate, DynamicSurrogate):
        return f"{call}, {centres}"
    lags = [
        f"{name} {_join_numbers(own)}"
        for name, own in zip(
            (*surrogate.inputs, surrogate.output), (*surrogate.lags, surrogate.output_lags), strict=True
        )
    ]
    return f"{call}, steps of {surrogate.step:g} s, {centres}; lags in samples: {'; '.join(lags)}"


def _join_numbers(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers)) or "none"


def quality_table(surrogate: Surrogate) -> list[list[str]]:
    """Return a row for each dataset and mode of evaluation."""
    rows = [["dataset", "use", "mode", "samples", "RMSE", "R2", "max |error|"]]
    for q in surrogate.quality:
        errors = [f"{q.rmse:.4g}", r2_text(q.r2, q.samples, q.rmse), f"{q.max_abs:.4g}"]
        rows.append([q.dataset, q.use, q.mode, str(q.samples), *errors])
    return rows


def ranges_table(surrogate: Surrogate) -> list[list[str]]:
    """Return the range of the training data for each input, and for the output if it is fed back."""
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
        columns = slice(first, first + count)
        first += count
        if count:
            ends = validity.least[columns].min(), validity.most[columns].max()
            rows.append([name, units.get(name, ""), *(f"{end:.6g}" for end in ends)])
    return rows
