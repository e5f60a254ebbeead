"""The channels of the data that may take part in terms, with their hat functions."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from fnmatch import fnmatchcase
from functools import partial

import numpy as np

from kennfeld.analysis.missing.channel_survey import ChannelSurvey, scored_values, survey_channels
from kennfeld.analysis.missing.families import HatAxis
from kennfeld.analysis.missing.recordings import RECORDING
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.threads import map_in_order
from kennfeld.domain.breakpoint_rounding import rounded, separated
from kennfeld.domain.dataset import Dataset
from kennfeld.graph import CLOCK
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.quantiles import DigitCounts, Digits, count_digits, quantiles
from kennfeld.preprocessing.recordings import RECORDING as NUMBER

POINTS = 6  # breakpoints of a curve
ENDS = 0.01  # share of the samples beyond each end
MAX_GAPS = 0.05  # share of missing samples
SAME = 0.999  # correlation with the target from which a channel says the same
CLOSEST = 0.03  # distance of breakpoints, of the whole range


@dataclass(frozen=True)
class Channels:
    """The channels that take part.

    Attributes:
        axes: their hat functions.
        excluded: why others do not take part, by name.
        gaps: share of the samples at which they are missing, by the name of the input, of those that have gaps.
    """

    axes: tuple[HatAxis, ...]
    excluded: dict[str, str]
    gaps: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, problem: Problem, patterns: Sequence[str] = ("*",), points: int = POINTS) -> "Channels":
        """Return the channels of the training data.

        Raises:
            ArgumentError: a pattern matches no channel.
        """
        datasets = problem.fitted_datasets
        known = dict.fromkeys(name for data in datasets for name in data if name != RECORDING)
        inputs = {channel: name for name, channel in _inputs(problem).items()}
        for pattern in patterns:
            if not any(fnmatchcase(name, pattern) or inputs.get(name) == pattern for name in known):
                remedy = nearest(pattern, known)
                raise ArgumentError(f"channels: the training data have no channel {pattern}. {remedy}".strip())
        asked = [n for n in known if any(fnmatchcase(n, p) or inputs.get(n) == p for p in patterns)]
        excluded = {name: reason for name in asked if (reason := _reason(problem, datasets, name))}
        rest = [name for name in asked if name not in excluded]
        surveys = survey_channels(problem, rest, sorted(_targets(problem)))
        excluded |= {name: reason for name in rest if (reason := _reason_of_values(problem, name, surveys[name]))}
        rest = [name for name in rest if name not in excluded]
        axes: list[HatAxis] = []
        # partitions have threads or processes of their own
        each = map if problem.partitions is not None else map_in_order
        for name, steps in zip(rest, each(partial(_points, problem, points), rest), strict=True):
            if len(steps) < 2:
                excluded[name] = "it is constant"
            else:
                axes.append(HatAxis(inputs.get(name, name), name, steps))
        gaps = {axis.name: share for axis in axes if (share := surveys[axis.channel].missing_share)}
        return cls(tuple(axes), {name: excluded[name] for name in asked if name in excluded}, gaps)


def _inputs(problem: Problem) -> dict[str, str]:
    """Return the channel of each input of the function."""
    return {name: problem.channels.get(name, name) for name in problem.model.graph.inputs}


def _targets(problem: Problem) -> set[str]:
    """Return the channels that are the target of a criterion."""
    kinds = [c for c in problem.criteria if c.target.kind != "number" and problem.target_node(c) is None]
    return {c.target.name for c in kinds}


def _reason(problem: Problem, datasets: Sequence[Dataset], name: str) -> str:
    """Return why a channel cannot take part, whatever its values; "" if it can."""
    targets = _targets(problem)
    if name in targets:
        return "it is the target"
    if name == NUMBER:
        return "it numbers the recordings"
    if name in CLOCK:
        return "formulas use its name for the time"
    graph = problem.model.graph
    if name in graph.names or name in graph.parameters:
        return "a node or a parameter of the function has its name"
    # also test data: the function with the term could not be evaluated on them
    lacking = next((data.name for data in (*datasets, *problem.datasets) if name not in data), None)
    return "" if lacking is None else f"dataset {lacking} has no such channel"


def _reason_of_values(problem: Problem, name: str, survey: ChannelSurvey) -> str:
    """Return why the values of a channel let it take no part; "" if it can."""
    if survey.missing_share > MAX_GAPS:
        return f"{survey.missing_share:.0%} of its samples are missing"
    if name in _inputs(problem).values():
        return ""
    for target, moments in survey.moments.items():
        if moments.correlation > SAME:
            return f"its correlation with the target {target} is {moments.correlation:.4f}"
    return ""


def _points(problem: Problem, points: int, name: str) -> tuple[float, ...]:
    """Return round breakpoints at quantiles of all training samples; those of few different numbers are these."""
    shares = np.linspace(ENDS, 1 - ENDS, points)

    def run(digits: Digits) -> Iterator[DigitCounts]:
        return problem.each(_count, name, digits)

    if problem.partitions is None:
        values = scored_values(problem.fitted_datasets, name)
        values = values[np.isfinite(values)]
        found = np.quantile(values, shares) if values.size else np.zeros(0)
    else:
        found = quantiles(run, shares)
    found = np.unique(found)
    return tuple(float(x) for x in _spread(rounded(separated(found)).points)) if found.size > 1 else ()


def _spread(points: Float) -> Float:
    """Return points without those that are close to the one before."""
    if points.size < 2:
        return points
    least = CLOSEST * (points[-1] - points[0])
    kept = [points[0]]
    for point in points[1:-1]:
        if point - kept[-1] > least and points[-1] - point > least:
            kept.append(point)
    return np.array([*kept, points[-1]])


def _count(problem: Problem, name: str, digits: Digits) -> DigitCounts:
    return count_digits([data[name].values[data.counting] for data in problem.fitted_datasets], digits)
