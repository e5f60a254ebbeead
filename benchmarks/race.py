"""Many solvers on one problem: each in processes of its own, with the same cost function and the same start."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import apart, threads
from benchmarks.table import seconds

__all__ = [
    "HIGHER",
    "REPEATS",
    "Entrant",
    "cells",
    "compare_costs",
    "run_entrant",
    "scaled_and_not",
    "time_to_cost",
    "times_to_cost",
]

Float = NDArray[np.float64]
SHORT = 10.0  # s; what takes less is run again
REPEATS = 5
HIGHER = 1e-3  # relative distance from the best cost at which a solver counts as stopped higher
AGREE = 1e-10


class Task(Protocol):
    """A problem: its start, and the cost that all solvers lower."""

    start: Float

    def cost(self, values: Float) -> float:
        """The cost."""

    def random(self) -> Float:
        """Some other values."""


@dataclass(frozen=True)
class Entrant:
    """A solver: what it is called, the function that runs it, and the packages it needs."""

    name: str
    target: str
    packages: tuple[str, ...] = ()
    arguments: dict[str, Any] = field(default_factory=dict)

    @property
    def peer(self) -> bool:
        """True for a solver other than Kennfeld."""
        return bool(self.packages)

    def capped(self, cap: float) -> dict[str, Any]:
        """Its arguments; a peer is stopped after `cap` s."""
        return self.arguments | ({"cap": cap} if self.peer else {})


def scaled_and_not(message: str, module: str, packages: tuple[str, ...], **arguments: Any) -> tuple[Entrant, ...]:
    """A peer without and with scaling by the columns of the Jacobian."""
    target = f"benchmarks.peers.{module}:solve"
    return tuple(
        Entrant(f"{message}, x_scale={'jac' if scaled else '1'}", target, packages, {"scaled": scaled, **arguments})
        for scaled in (False, True)
    )


def compare_costs(task: Task, modules: Iterable[str]) -> str:
    """State how far the cost functions differ at the start and at a random point; raise if it is too far."""
    points = [task.start, task.random()]
    expected = np.array([task.cost(point) for point in points])
    worst = 0.0
    for module in sorted(modules):
        answer = apart(f"{module}:cost_at", points=[point.tolist() for point in points])
        if "error" in answer:
            raise RuntimeError(f"{module} cannot tell its cost: {answer['error']}")
        worst = max(worst, float(np.max(np.abs(np.array(answer["costs"]) / expected - 1))))
        if worst > AGREE:
            raise RuntimeError(f"the cost in {module} differs from the others by {worst:.1e}, relatively")
    costs = " and ".join(f"{cost:.10g}" for cost in expected)
    return f"All cost functions agree to {worst:.0e} at the start and at a random point ({costs})."


def run_entrant(entrant: Entrant, task: Task, rmse: Callable[[Float], float], cap: float) -> dict[str, Any]:
    """Run a solver on one thread and on all; those count that were faster, or that came lower in the time they had."""
    outcomes = [_fastest(entrant, cores, task, rmse, cap) for cores in (1, None)]
    completed = [outcome for outcome in outcomes if "error" not in outcome]
    if not completed:
        return outcomes[0]
    in_time = [outcome for outcome in completed if outcome["seconds"] < cap]
    return min(in_time or completed, key=lambda outcome: outcome["seconds" if in_time else "cost"])


def _fastest(
    entrant: Entrant, cores: int | None, task: Task, rmse: Callable[[Float], float], cap: float
) -> dict[str, Any]:
    """Return the fastest run, with the median of all runs beside it."""
    runs: list[dict[str, Any]] = []
    while len(runs) < REPEATS:
        runs.append(apart(entrant.target, cores=cores, timeout=60 + 3 * cap, **entrant.capped(cap)))
        if "error" in runs[-1]:
            return runs[-1]
        if runs[-1]["seconds"] > SHORT:
            break
    best = min(runs, key=lambda outcome: outcome["seconds"])
    values = np.array(best["values"])
    return best | {
        "median": float(np.median([outcome["seconds"] for outcome in runs])),
        "runs": len(runs),
        "threads": threads(cores),
        "cost": task.cost(values),
        "rmse": rmse(values),
    }


def cells(outcome: dict[str, Any], best: float, goals: Sequence[float], unit: str) -> list[str]:
    """Return the row of a solver: times to its end and to the costs `goals`, its cost compared with the `best`."""
    higher = outcome["cost"] / best - 1
    remarks = [outcome["note"]] if outcome["note"] else []
    if higher > HIGHER:
        remarks.append(f"stops {higher:.1%} higher")
    return [
        seconds(outcome.get("setup")),
        seconds(outcome["seconds"]),
        f"{seconds(outcome['median'])} ({outcome['runs']})",
        *(seconds(time_to_cost(outcome, goal)) for goal in goals),
        str(outcome["threads"]),
        f"{outcome['cost']:.6g}",
        f"{outcome['rmse']:.3f} {unit}",
        "; ".join(remarks),
    ]


def times_to_cost(outcomes: dict[str, dict[str, Any]], goal: float) -> dict[str, float]:
    """Return the time to a cost of each solver that gets there."""
    times = {name: time_to_cost(outcome, goal) for name, outcome in outcomes.items()}
    return {name: time for name, time in times.items() if time is not None}


def time_to_cost(outcome: dict[str, Any], goal: float) -> float | None:
    """Return when the cost of a solver came down to a goal, None if it never did."""
    return next((at for at, cost in outcome["trace"] if cost <= goal), None)
