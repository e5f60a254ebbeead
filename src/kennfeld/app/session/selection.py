"""Samples that a brush selects, and the conditions of a project file that say the same."""

import numpy as np

from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.signals import SampleSelection, SignalName
from kennfeld.base.errors import ArgumentError, Location
from kennfeld.models.formula import expression, spell_name
from kennfeld.optimize.problem.problem import Problem
from kennfeld.preprocessing.binding import bind_inputs

DIGITS = 8  # of the numbers in a condition


def condition(selection: SampleSelection, recording: LiveDataset, problem: Problem) -> str:
    """Return formula text over channels that is true at the selected samples.

    Raises:
        ArgumentError: no condition says it; the message is the reason.
    """
    if selection.point is not None:
        message = "A condition reads recorded channels, not where a table is looked up"
        raise ArgumentError(f"{message}; brush a scatter plot over the inputs of {selection.point.parameter} instead.")
    parts = []
    for part in selection.ranges:
        name = spell_name(_channel(part.signal, recording, problem))
        parts += _between(name, part.least, part.greatest)
    begin, end = selection.begin, selection.end
    if np.isfinite([begin, end]).any():
        first = _first_time(recording)
        # in a condition, t counts from the first sample of the piece
        parts += _between("t", begin - first, end - first)
    text = " and ".join(parts)
    check_clock(text, recording)
    return text


def check_clock(text: str, recording: LiveDataset) -> None:
    """Raise `ArgumentError` if a condition counts time from several begins in a dataset."""
    graph, dataset = expression(text, Location("where")), recording.bound.dataset
    if not graph.clocks:
        return
    if dataset.time is None:
        raise ArgumentError("The dataset has no time stamps, so that no condition can name a stretch of it.")
    if bind_inputs(dataset, graph, {}).starts.size > 1:
        message = "In a condition the time t begins again with every recording and after every gap"
        raise ArgumentError(f"{message}; this dataset has several such pieces.")


def outside(text: str) -> str:
    """Return the condition that is true where another one is false."""
    return f"not ({text})"


def both(first: str, second: str) -> str:
    """Return the condition that is true where two are; an empty one is always true.

    >>> both("Speed > 500 or Load > 3", "t < 8")
    '(Speed > 500 or Load > 3) and t < 8'
    """
    return f"({first}) and {second}" if first.strip() else second


def _between(name: str, least: float, greatest: float) -> list[str]:
    sides = ((">=", least), ("<=", greatest))
    return [f"{name} {sign} {value:.{DIGITS}g}" for sign, value in sides if np.isfinite(value)]


def _channel(signal: SignalName, recording: LiveDataset, problem: Problem) -> str:
    """Return the channel behind a signal. Raises `ArgumentError` if it is computed by the function."""
    if signal.kind == "channel":
        return signal.name
    if signal.kind == "target":
        target = problem.criteria[int(signal.name)].target
        if target.kind != "number" and target.name in recording.bound.dataset:
            return target.name
    if signal.kind in ("node", "start"):
        subject = signal.name
    else:
        role = "target" if signal.kind == "target" else "error"
        subject = f"the {role} of {problem.criteria[int(signal.name)].node}"
    raise ArgumentError(f"A condition reads recorded channels; {subject} is computed by the function.")


def _first_time(recording: LiveDataset) -> float:
    bound = recording.bound
    if bound.dataset.time is None:
        raise ArgumentError("The dataset has no time stamps, so that no condition can name a stretch of it.")
    return float(bound.dataset.time[bound.kept[0]]) if bound.count else 0.0


def stretch_in_other_data(selection: SampleSelection, problem: Problem) -> str:
    """Return why a selection cannot be a region of a criterion, which all datasets share; empty if it can."""
    timed = bool(np.isfinite([selection.begin, selection.end]).any())
    if not timed or len(problem.datasets) == 1:
        return ""
    return "A region holds in all datasets, and a stretch of time is of one; brush a scatter plot instead."
