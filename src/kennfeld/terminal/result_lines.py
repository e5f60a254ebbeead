"""Lines on the result of a calibration, and on a trained surrogate."""

from collections.abc import Sequence

import numpy as np

from kennfeld.analysis.extrapolation import Extrapolation, surrogate_coordinates
from kennfeld.formatting import shorten
from kennfeld.optimize.quality import r2_text
from kennfeld.optimize.result import Result
from kennfeld.optimize.trust.trust import Trust
from kennfeld.surrogate.surrogate_file import Surrogate
from kennfeld.surrogate.surrogate_models import DynamicSurrogate

MAX_LINES = 3  # under one heading
MORE = "; see result.json"


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
    undetermined = shorten(list(map(str, trust.directions)), MAX_LINES, MORE)
    if trust.null_space.dimension > 1:
        undetermined.insert(0, str(trust.null_space))
    outputs = [str(limit) for limit in trust.holdings if limit.samples]  # the message names those of breakpoints
    return [
        *remark,
        *_section("Parameters not determined by the data:", undetermined),
        *_section("Active output limits:", shorten(outputs, MAX_LINES, MORE)),
    ]


def extrapolation_lines(extrapolations: Sequence[Extrapolation], pointer: str = MORE) -> list[str]:
    """Return the surrogates used outside their training data, the largest share first.

    Args:
        extrapolations: one row for each surrogate.
        pointer: where to find the rows that are not listed.
    """
    outside = sorted((row for row in extrapolations if row.worst is not None), key=lambda row: -row.share)
    return _section("Surrogate extrapolation:", shorten(list(map(str, outside)), MAX_LINES, pointer))


def _section(heading: str, lines: Sequence[str]) -> list[str]:
    return [heading, *(f"  {line}" for line in lines)] if lines else []


def describe_surrogate(surrogate: Surrogate) -> str:
    """Return a sentence with the inputs, lags and size of a surrogate."""
    call = f"{surrogate.output} = {surrogate.name}({', '.join(surrogate.inputs)})"
    centres = f"{surrogate.expansion.size} centres"
    if not isinstance(surrogate, DynamicSurrogate):
        return f"{call}, {centres}"
    delayed = [*zip(surrogate.inputs, surrogate.lags, strict=True), (surrogate.output, surrogate.output_lags)]
    lags = "; ".join(f"{name} {', '.join(map(str, numbers)) or 'none'}" for name, numbers in delayed)
    return f"{call}, steps of {surrogate.step:g} s, {centres}; lags in samples: {lags}"


def quality_table(surrogate: Surrogate) -> list[list[str]]:
    """Return a row for each dataset and mode of evaluation."""
    rows = [
        [
            *(q.dataset, q.use, q.mode, str(q.samples)),
            *(f"{q.rmse:.4g}", r2_text(q.r2, q.samples, q.rmse), f"{q.max_abs:.4g}"),
        ]
        for q in surrogate.quality
    ]
    return [["dataset", "use", "mode", "samples", "RMSE", "R2", "max |error|"], *rows]


def ranges_table(surrogate: Surrogate) -> list[list[str]]:
    """Return the range of the training data for each input, and for the output if it is fed back."""
    rows = [["trained on", "unit", "from", "to"]]
    validity = surrogate.validity
    if validity is None:
        return rows
    names = np.array([name for name, _ in surrogate_coordinates(surrogate)])
    units = dict(zip([*surrogate.inputs, surrogate.output], surrogate.units, strict=False))
    for name in dict.fromkeys(names.tolist()):
        ends = validity.least[names == name].min(), validity.most[names == name].max()
        rows.append([name, units.get(name, ""), *(f"{end:.6g}" for end in ends)])
    return rows
