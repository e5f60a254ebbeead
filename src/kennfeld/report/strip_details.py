"""Details of a strip, which it shows when it is zoomed, and further signals that a reader adds to it.

The first view of a strip has few points. Its details have as many as the page has room for: if possible all samples,
else the range of each few. Inputs and named nodes have details alone.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kennfeld.analysis.part_evaluation import DatasetExtent, EvaluatedPart, PartEvaluator, PartPlace
from kennfeld.analysis.residuals import Fit
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.trace_envelope import Trace, TraceEnvelope
from kennfeld.optimize.problem.problem import Problem
from kennfeld.report.coded_numbers import code_numbers
from kennfeld.report.stamps import Stamps

TOTAL_NUMBERS = 3_000_000  # of all details of a page: 3 to 9 MB of text
RESERVE = 0.1  # share of them for strips whose samples have no room, and as much for inputs and nodes
LEAST_POINTS = 400  # of a signal
MAX_SIGNALS = 40  # of a dataset, inputs first
SAMPLED = ("measured", "before", "after")  # columns of samples, from which the errors follow
SIGNALS_OF_SAMPLES, SIGNALS_OF_RANGES = len(SAMPLED), 5  # columns of a strip
GAIN = 2  # times the points of the first view from which details are worth their room
LEVELS = 65_535  # steps of the range of a signal: more than a screen has pixels
ERROR_LEVELS = 4_095  # steps of the range of its errors, which are differences of signals


class StripSignal(NamedTuple):
    """An input of the function, or a named node of it."""

    name: str
    unit: str
    kind: str  # input or node


@dataclass(frozen=True, eq=False)
class SignalPlan:
    """The further signals of a dataset, and how many samples a point of them stands for."""

    groups: TraceEnvelope
    signals: tuple[StripSignal, ...]
    left_out: int  # signals for which there is no room

    @classmethod
    def of(cls, problem: Problem, data: DatasetExtent, room: float) -> "SignalPlan | None":
        """Return the plan for a dataset in a room of so many numbers; None if it has no time or no signals."""
        signals = tuple(_signals(problem, data)) if data.is_timed else ()
        if not signals:
            return None
        shown = signals[:MAX_SIGNALS]
        points = max(int(room / len(shown)), LEAST_POINTS)
        return cls(TraceEnvelope(data.count, points), shown, len(signals) - len(shown))


@dataclass(frozen=True, eq=False)
class DetailRoom:
    """Division of the numbers of a page: samples of criteria first, then ranges of others, then signals.

    Attributes:
        groups: the groups of each strip's details; None if its first view shows as much.
        signals: numbers for the signals of each dataset.
    """

    groups: tuple[TraceEnvelope | None, ...]
    signals: float

    @classmethod
    def of(cls, fits: Sequence[Fit], views: Sequence[TraceEnvelope]) -> "DetailRoom":
        """Divide the room among the strips of fits, given the groups of their first views."""
        room = TOTAL_NUMBERS * (1.0 - RESERVE)
        detailed = [fit.data.is_timed and not view.whole for fit, view in zip(fits, views, strict=True)]
        needs = [SIGNALS_OF_SAMPLES * fit.data.count if own else 0 for fit, own in zip(fits, detailed, strict=True)]
        scarce = sum(needs) > room
        # if not all samples fit, the others need room for ranges
        left = room - TOTAL_NUMBERS * RESERVE if scarce else room
        whole = []
        for need in needs:
            # first come, first served: a strip that does not fit leaves its room to smaller ones
            whole.append(need <= left)
            left -= need if whole[-1] else 0
        others = sum(not each for each in whole)
        points = int((left + TOTAL_NUMBERS * RESERVE) / (SIGNALS_OF_RANGES * others)) if others else 0
        groups = tuple(
            _detail_groups(fit.data.count, view, fit.data.count if all_samples else points) if own else None
            for fit, view, own, all_samples in zip(fits, views, detailed, whole, strict=True)
        )
        datasets = len({id(fit.data) for fit in fits})
        return cls(groups, (TOTAL_NUMBERS * RESERVE + (0.0 if others else left)) / max(datasets, 1))


def _detail_groups(count: int, view: TraceEnvelope, points: int) -> TraceEnvelope | None:
    groups = TraceEnvelope(count, points)
    return groups if groups.whole or view.size >= GAIN * groups.size else None


def _signals(problem: Problem, data: DatasetExtent) -> Sequence[StripSignal]:
    graph, dataset = problem.model.graph, data.dataset
    shown = {criterion.node for criterion in problem.criteria}
    signals = []
    for name in graph.inputs:
        channel = problem.channels.get(name, name)
        unit = graph.units.get(name, "") or (dataset[channel].unit if channel in dataset else "")
        signals.append(StripSignal(name, unit, "input"))
    nodes = [name for name in graph.names if name not in shown and name not in graph.inputs]
    return [*signals, *(StripSignal(name, graph.units.get(name, ""), "node") for name in nodes)]


@dataclass
class DrawnSignals:
    """The further signals of a dataset or a part of it."""

    plan: SignalPlan
    stamps: Stamps
    traces: dict[str, Trace]

    @classmethod
    def of(
        cls, plan: SignalPlan, evaluator: PartEvaluator, evaluated: EvaluatedPart, place: PartPlace
    ) -> "DrawnSignals":
        """Return the signals of a part."""
        traces = {signal.name: Trace() for signal in plan.signals}
        columns = evaluated.bound.columns
        inputs = {signal.name for signal in plan.signals if signal.kind == "input"}
        for name in inputs & set(columns):
            traces[name].add(plan.groups, place.first, columns[name])
        nodes = [signal.name for signal in plan.signals if signal.kind == "node"]
        for name, values in evaluator.nodes(evaluated, nodes):
            traces[name].add(plan.groups, place.first, values)
        return cls(plan, Stamps.of(plan.groups, True, place, evaluated.after[0]), traces)

    def merge(self, later: "DrawnSignals") -> None:
        """Take in the signals of the following part."""
        self.stamps.merge(later.stamps)
        for name, trace in later.traces.items():
            self.traces[name].merge(trace)

    def figure(self) -> Mapping[str, Any]:
        """Return the signals as the page decodes them."""
        return {
            **_coded_stamps(self.stamps, self.plan.groups),
            "leftOut": self.plan.left_out,
            "signals": [
                {**signal._asdict(), "values": _coded(self.traces[signal.name].points(self.plan.groups))}
                for signal in self.plan.signals
            ],
        }


def coded_details(stamps: Stamps, traces: Mapping[str, Trace], groups: TraceEnvelope) -> Mapping[str, Any]:
    """Return the details of a criterion as the page decodes them.

    If they are the samples, errors are left out: they are differences of the signals.
    """
    points = {name: trace.points(groups) for name, trace in traces.items()}
    if groups.whole:
        errors = points["after"] - points["measured"]
        # one step for all columns, fine enough for their differences, which the page draws as errors
        step = min(_range(*points.values()) / LEVELS, _range(errors) / ERROR_LEVELS or np.inf)
        coded = {name: code_numbers(values, step) for name, values in points.items()}
    else:
        coded = {name: _coded(values) for name, values in points.items()}
    return {**_coded_stamps(stamps, groups), "traces": coded}


def _coded(values: Float) -> Mapping[str, Any]:
    return code_numbers(values, _range(values) / LEVELS)


def _range(*columns: Float) -> float:
    known = [values[np.isfinite(values)] for values in columns]
    ends = [(each.min(), each.max()) for each in known if each.size]
    with np.errstate(over="ignore"):
        reach = float(max(high for _, high in ends) - min(low for low, _ in ends)) if ends else 0.0
    return min(reach, np.finfo(float).max)


def _coded_stamps(stamps: Stamps, groups: TraceEnvelope) -> Mapping[str, Any]:
    x = stamps.along()[0]
    x = x if groups.whole else x[::2]  # one for each group
    steps = np.diff(x)
    step = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 1.0
    # second differences of an even raster are 0
    return {"whole": groups.whole, "size": groups.size, "x": code_numbers(x, step * 1e-3, order=2)}
