"""Many solvers on one problem: each in processes of its own, with the same cost function and the same start."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import apart, threads
from benchmarks.table import seconds

__all__ = ["HIGHER", "REPEATS", "Entrant", "agreement", "cells", "reached", "scaled_and_not", "solved"]

Float = NDArray[np.float64]
SHORT = 10.0  # s; what takes less is run again
REPEATS = 5
HIGHER = 1e-3  # relative distance from the best cost at which a solver counts as stopped higher
AGREE = 1e-10


class Given(Protocol):
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
        """Whether it is not Kennfeld."""
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


def agreement(given: Given, modules: Iterable[str]) -> str:
    """How far the cost functions differ at the start and at a random point; raises where it is too far."""
    points = [given.start, given.random()]
    expected = np.array([given.cost(point) for point in points])
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


def solved(entrant: Entrant, given: Given, rmse: Callable[[Float], float], cap: float) -> dict[str, Any]:
    """Runs on one thread and on all; those count that were faster, or that came lower in the time they had."""
    found = [_fastest(entrant, cores, given, rmse, cap) for cores in (1, None)]
    good = [one for one in found if "error" not in one]
    if not good:
        return found[0]
    return min(good, key=lambda one: (one["seconds"] > cap, one["seconds"] if one["seconds"] < cap else one["cost"]))


def _fastest(
    entrant: Entrant, cores: int | None, given: Given, rmse: Callable[[Float], float], cap: float
) -> dict[str, Any]:
    """The fastest run, with the median of all runs beside it."""
    runs: list[dict[str, Any]] = []
    while len(runs) < REPEATS:
        runs.append(apart(entrant.target, cores=cores, timeout=60 + 3 * cap, **entrant.capped(cap)))
        if "error" in runs[-1]:
            return runs[-1]
        if runs[-1]["seconds"] > SHORT:
            break
    best = min(runs, key=lambda one: one["seconds"])
    values = np.array(best["values"])
    return best | {
        "median": float(np.median([one["seconds"] for one in runs])),
        "runs": len(runs),
        "threads": threads(cores),
        "cost": given.cost(values),
        "rmse": rmse(values),
    }


def cells(one: dict[str, Any], best: float, goals: Sequence[float], unit: str) -> list[str]:
    """The row of a solver: times to its end and to the costs `goals`, and what it reached beside the `best` cost."""
    higher = one["cost"] / best - 1
    remarks = [one["note"]] if one["note"] else []
    if higher > HIGHER:
        remarks.append(f"stops {higher:.1%} higher")
    return [
        seconds(one.get("setup")),
        seconds(one["seconds"]),
        f"{seconds(one['median'])} ({one['runs']})",
        *(seconds(reached(one, goal)) for goal in goals),
        str(one["threads"]),
        f"{one['cost']:.6g}",
        f"{one['rmse']:.3f} {unit}",
        "; ".join(remarks),
    ]


def reached(one: dict[str, Any], goal: float) -> float | None:
    """When a solver's cost came down to a goal; None where it never did."""
    return next((at for at, cost in one["trace"] if cost <= goal), None)
