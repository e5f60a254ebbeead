"""Lines on the result of a calibration."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from kennfeld.base.formatting import shorten, under_heading

if TYPE_CHECKING:
    from kennfeld.analysis.extrapolation import Extrapolation
    from kennfeld.optimize.fit.result import Checkpoint, Result

MAX_LINES = 3  # under one heading
MAX_STARTS = 12  # that are listed one by one
MORE = "; see result.json"


def choice_lines(result: "Result") -> list[str]:
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


def resume_lines(states: "Mapping[int, Checkpoint]", starts: int) -> list[str]:
    """Return from where each start resumes, given the checkpoints by the number of the start."""
    numbers = range(1, starts + 1)
    prefixes = [f"start {number:>2}  " if starts > 1 else "" for number in numbers]
    lines = [f"{prefix}{_resumption(states.get(number))}" for prefix, number in zip(prefixes, numbers, strict=True)]
    return shorten(lines, MAX_STARTS)


def _resumption(state: "Checkpoint | None") -> str:
    if state is None:
        return "begins anew: it has no checkpoint"
    if state.ended is not None and state.ended.status == "converged":
        return f"had converged at cost {state.cost:.5g}: {state.name}"
    step = f"step {state.step}, " if state.step > 1 else ""
    return f"resumes from {state.name}: {step}iteration {state.iteration}, cost {state.cost:.5g}"


def extrapolation_lines(extrapolations: Sequence["Extrapolation"], pointer: str = MORE) -> list[str]:
    """Return the surrogates used outside their training data, the largest share first.

    Args:
        extrapolations: one row for each surrogate.
        pointer: where to find the rows that are not listed.
    """
    outside = sorted((row for row in extrapolations if row.worst is not None), key=lambda row: -row.share)
    return under_heading("Surrogate extrapolation:", shorten(list(map(str, outside)), MAX_LINES, pointer))
