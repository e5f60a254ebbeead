"""Details of a strip, which it shows when it is zoomed, and further signals that a reader adds to it.

The first view of a strip has few points. Its details have as many as the page has room for: if possible all samples,
else the range of each few. Inputs and named nodes have details alone.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kennfeld.analysis.part_evaluation import DatasetExtent, EvaluatedPart, PartEvaluator, PartPlace
from kennfeld.analysis.residuals import Fit
from kennfeld.arrays import Float
from kennfeld.lazy_dataclass import dataclass
from kennfeld.optimize.problem import Problem
from kennfeld.report.coded_numbers import code_numbers
from kennfeld.report.stamps import Stamps
from kennfeld.trace_envelope import Trace, TraceEnvelope

TOTAL_NUMBERS = 3_000_000  # of all details of a page, about 5 MB of text
SHARE_OF_CRITERIA = 0.6  # the rest is for inputs and nodes
MAX_SIGNALS = 40  # of a dataset, inputs first
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

    @classmethod
    def of(cls, problem: Problem, data: DatasetExtent, datasets: int) -> "SignalPlan | None":
        """Return the plan for a dataset, one of `datasets`; None if it has no time or no signals."""
        signals = tuple(_signals(problem, data))[:MAX_SIGNALS] if data.is_timed else ()
        if not signals:
            return None
        room = TOTAL_NUMBERS * (1 - SHARE_OF_CRITERIA) / (max(datasets, 1) * len(signals))
        return cls(TraceEnvelope(data.count, int(max(room, 400))), signals)


def detail_groups(fit: Fit, view: TraceEnvelope, series: int) -> TraceEnvelope | None:
    """Return the groups of a strip's details, one of `series`; None if its first view shows as much."""
    if not fit.data.is_timed or view.whole:
        return None
    room = TOTAL_NUMBERS * SHARE_OF_CRITERIA / max(series, 1)
    whole = TraceEnvelope(fit.data.count, int(room / 3))
    groups = whole if whole.whole else TraceEnvelope(fit.data.count, int(room / 5))
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
        points.pop("errorBefore")
        step = min(_range(*points.values()) / LEVELS, _range(points.pop("error")) / ERROR_LEVELS or np.inf)
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
    return {"whole": groups.whole, "size": groups.size, "x": code_numbers(x, step * 1e-3, order=2)}
