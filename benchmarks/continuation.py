"""Topic `continuation`: which descents are worth their time on chained lookups, and how far each has to go."""

import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.continuation_problems import Case, cases, missing
from benchmarks.machine import load
from benchmarks.measure import apart
from benchmarks.table import Table, seconds
from kennfeld.optimize.fit.descent_strategy import SearchPlan
from kennfeld.optimize.strategies.smoothing_continuation import LONG_SCHEDULE, SHORT_SCHEDULE, SmoothingSchedule

__all__ = ["run", "solve"]

DEFAULT = SearchPlan()
DRAWS = 3
NEAR = (1e-3, 1e-2, 5e-2)  # relative distances from the lowest cost of any setting


@dataclass(frozen=True)
class Setting:
    """A way to search; `tolerance` is that of the last descent, None for the default."""

    name: str
    plan: SearchPlan = DEFAULT
    tolerance: float | None = None
    continuation: str = "auto"


def _uniform(tolerance: float) -> SearchPlan:
    return _changed(tolerances=lambda schedule: (tolerance,) * len(schedule.widths))


def _changed(**changes: Any) -> SearchPlan:
    """Return the default plan with changed schedules; a function gets the schedule."""

    def altered(schedule: SmoothingSchedule) -> SmoothingSchedule:
        values = {name: change(schedule) if callable(change) else change for name, change in changes.items()}
        return replace(schedule, **values)

    return SearchPlan(altered(SHORT_SCHEDULE), altered(LONG_SCHEDULE))


def _last(count: int) -> SearchPlan:
    """Return the default plan without the last `count` widths."""
    return _changed(widths=lambda s: s.widths[:-count], tolerances=lambda s: s.tolerances[:-count])


def _further() -> SearchPlan:
    """Return the default plan with another width at the end."""
    return _changed(widths=lambda s: (*s.widths, s.widths[-1] / 2), tolerances=lambda s: (*s.tolerances, 1e-4))


def _from(width: float) -> SearchPlan:
    """Return the default plan with a long schedule from another width."""
    count = int(np.log2(width / SHORT_SCHEDULE.widths[0]))
    widths = (*(width / 2**i for i in range(count)), *SHORT_SCHEDULE.widths)
    return SearchPlan(long=SmoothingSchedule(widths, (*(1e-2,) * count, *SHORT_SCHEDULE.tolerances)))


OLD = SearchPlan(
    SmoothingSchedule(tuple(1.0 / 2**i for i in range(6)), (3e-5,) * 6, damping=(1e-4, 1e-4)),
    SmoothingSchedule(tuple(4.0 / 2**i for i in range(8)), (1e-5,) * 8, damping=(1e-4, 1e-4)),
    tolerance=1e-5,
)
SETTINGS = (
    Setting("default"),
    Setting("tight: stages to 3e-5 and 1e-5, ends to 1e-8", OLD, 1e-8),
    *(Setting(f"all stages to {t:g}", _uniform(t)) for t in (1e-2, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)),
    Setting("long schedule as loose as the short one", _from(4.0)),
    Setting("patience of the stages 1", _changed(patience=1)),
    Setting("patience of the stages 3", _changed(patience=3)),
    Setting("widths to 1/32", _further()),
    Setting("widths to 1/8 only", _last(1)),
    Setting("long schedule from 2", _from(2.0)),
    Setting("long schedule from 8", _from(8.0)),
    Setting("damping 1e-4 at each stage", _changed(damping=(1e-4, 1e-4))),
    Setting("damping kept up to 0.1", _changed(damping=(1e-10, 1e-1))),
    Setting("no direct descent, long schedule never", SearchPlan(direct=False, long=None)),
    Setting("no long schedule", SearchPlan(long=None)),
    Setting("long schedule if ends differ at all", SearchPlan(kink_difference=0.0)),
    Setting("long schedule if ends differ by 1 %", SearchPlan(kink_difference=1e-2)),
    Setting("ends compared at 1e-2", SearchPlan(tolerance=1e-2)),
    Setting("ends compared at 1e-4", SearchPlan(tolerance=1e-4)),
    *(Setting(f"last descent to {t:g}", tolerance=t) for t in (1e-3, 1e-4, 1e-5, 1e-6, 1e-8)),
    Setting("direct descent alone", continuation="off"),
)


def solve(number: int, file: str, draws: int = DRAWS) -> dict[str, int]:
    """Search a case with all settings in turn; write a line of JSON for each to a file."""
    case = cases(draws)[number]
    with Path(file).open("a", encoding="utf-8") as out:
        for outcome in _outcomes(case):
            print(json.dumps({"group": case.group, "case": case.name} | outcome), file=out)
    return {"settings": len(SETTINGS)}


def _outcomes(case: Case) -> list[dict[str, Any]]:
    from kennfeld.base.threads import blas_threads
    from kennfeld.optimize import Options
    from kennfeld.optimize.fit.descent_strategy import DescentSetup, minimise
    from kennfeld.optimize.fit.fit import FitRun
    from kennfeld.optimize.fit.result import Seconds
    from kennfeld.optimize.limits.linear_limits import linear_limits

    problem = case.make()
    outcomes = []
    fit = FitRun(problem, Options(), None, Seconds())
    limits = linear_limits(problem, fit.exact.values)
    start, _ = fit.feasible_start(limits)
    assert start is not None
    for setting in (SETTINGS[0], *SETTINGS):  # the first search warms up
        options = replace(fit.options, tolerance=setting.tolerance or fit.options.tolerance)
        smoothed = fit.continuation if setting.continuation == "auto" else None
        significant = fit.significant if setting.tolerance is None else 0.0
        searched = fit.exact, fit.objective, fit.thinned, smoothed, None
        setup = DescentSetup(*searched, options, fit.record, setting.plan, significant)
        with blas_threads(problem.free_size):
            began = time.process_time()
            end = minimise(setup, start, limits)
            duration = time.process_time() - began
        quality = fit.scorer.scores(problem.parameters, fit.parameters(end.values)).quality
        error = next(row.rmse_after for row in quality if row.use == "test")
        outcome = {"cost": end.cost, "error": error, "iterations": end.iterations, "seconds": duration}
        outcomes.append({"setting": setting.name} | outcome)
    return outcomes[1:]


def run(draws: int = DRAWS) -> list[Table]:
    """Search all cases with all settings, each case in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "outcomes.jsonl"
        for number, case in enumerate(cases(draws)):
            answer = apart("benchmarks.continuation:solve", cores=1, number=number, file=str(file), draws=draws)
            if "error" in answer:
                raise RuntimeError(f"{case.group}, {case.name}: {answer['error']}")
            print(f"{number + 1} of {len(cases(draws))}: {case.group}, {case.name}", file=sys.stderr, flush=True)
        outcomes = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
    return [_settings(outcomes), _groups(outcomes)]


def _settings(outcomes: Sequence[Mapping[str, Any]]) -> Table:
    """Compare all settings over all cases."""
    near = [f"within {share:.1%}" for share in NEAR]
    columns = ("setting", "above the lowest cost: median", "mean", *near, "test error", "iterations", "user time")
    number = len({(o["group"], o["case"]) for o in outcomes})
    table = Table(f"continuation: {number} problems with chained lookups", columns)
    lowest, reference = _lowest(outcomes), _by_case(outcomes, SETTINGS[0].name)
    for setting in SETTINGS:
        own = _by_case(outcomes, setting.name)
        above = np.array([own[case]["cost"] / lowest[case] - 1 for case in own])
        errors = np.array([own[case]["error"] / reference[case]["error"] for case in own])
        table.add(
            setting.name,
            f"{np.median(above):.2%}",
            f"{_mean(1 + above) - 1:.2%}",
            *(f"{np.mean(above <= share):.0%}" for share in NEAR),
            f"{_mean(errors):.3f}",
            str(sum(outcome["iterations"] for outcome in own.values())),
            seconds(sum(outcome["seconds"] for outcome in own.values())),
        )
    table.notes = [
        "Lowest is the lowest cost of any setting, for each problem. Means are geometric; the test error is relative "
        "to that of the first setting. Iterations and user time are sums over all problems, without compiling.",
        f"On one core. {missing()} Load at the end {load()}.".replace("  ", " "),
    ]
    return table


def _groups(outcomes: Sequence[Mapping[str, Any]]) -> Table:
    """Show the first settings for each kind of problem."""
    shown = [SETTINGS[0], SETTINGS[1], SETTINGS[-1]]
    columns = ("problems", "number", *(f"{setting.name}: above the lowest, time" for setting in shown))
    table = Table("continuation: kinds of problems", columns)
    lowest = _lowest(outcomes)
    for group in dict.fromkeys(outcome["group"] for outcome in outcomes):
        cells = []
        for setting in shown:
            own = {case: o for case, o in _by_case(outcomes, setting.name).items() if case[0] == group}
            above = _mean(np.array([outcome["cost"] / lowest[case] for case, outcome in own.items()])) - 1
            cells.append(f"{above:.2%}, {seconds(float(np.median([o['seconds'] for o in own.values()])))}")
        table.add(group, str(len(own)), *cells)
    table.notes = ["The geometric mean of the costs, and the median user time of a problem."]
    return table


def _by_case(outcomes: Sequence[Mapping[str, Any]], name: str) -> dict[tuple[str, str], Mapping[str, Any]]:
    return {(o["group"], o["case"]): o for o in outcomes if o["setting"] == name}


def _lowest(outcomes: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], float]:
    lowest: dict[tuple[str, str], float] = {}
    for outcome in outcomes:
        case = outcome["group"], outcome["case"]
        lowest[case] = min(lowest.get(case, np.inf), outcome["cost"])
    return lowest


def _mean(ratios: Any) -> float:
    return float(np.exp(np.mean(np.log(ratios))))
