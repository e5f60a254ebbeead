"""Topic `torque`: one calibration problem, many solvers, the same cost function and the same start."""

from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.race import HIGHER, REPEATS, Entrant, cells, compare_costs, run_entrant, scaled_and_not, times_to_cost
from benchmarks.table import Table, seconds
from benchmarks.torque_problem import TorqueProblem, problem

__all__ = ["run"]

GOALS = (1e-2, 1e-3)  # relative distances from the best cost of a peer, to which the time is taken
SEEDS = range(1, 9)


ENTRANTS = (
    Entrant("Kennfeld, continuation off", "benchmarks.kennfeld_torque:solve", (), {"continuation": "off"}),
    Entrant("Kennfeld, continuation auto", "benchmarks.kennfeld_torque:solve", (), {"continuation": "auto"}),
    *scaled_and_not("scipy TRF, exact sparse Jacobian, lsmr", "scipy_trf", ("scipy",), jacobian="sparse"),
    *scaled_and_not("scipy TRF, exact dense Jacobian", "scipy_trf", ("scipy",), jacobian="dense"),
    *scaled_and_not("scipy TRF, finite differences", "scipy_trf", ("scipy",), jacobian="differences"),
    Entrant("lmfit leastsq, finite differences", "benchmarks.peers.lmfit_leastsq:solve", ("lmfit",)),
    Entrant("CasADi + IPOPT, exact Hessian", "benchmarks.peers.casadi_ipopt:solve", ("casadi",)),
    Entrant("optimistix LevenbergMarquardt", "benchmarks.peers.optimistix_lm:solve", ("optimistix", "jax")),
)


def run(cap: float = 60.0) -> list[Table]:
    """Check that the cost functions agree, then let everyone solve, the peers for at most `cap` s each."""
    task = problem()
    agreement = compare_costs(task, _with_a_cost_of_their_own())
    outcomes = {e.name: run_entrant(e, task, task.fresh_rmse, cap) for e in ENTRANTS if installed(*e.packages)}
    return [_table(outcomes, task, agreement, cap), _seeds(cap)]


def _with_a_cost_of_their_own() -> set[str]:
    """The modules that do not take the problem's cost function as it is."""
    modules = {e.target.split(":")[0] for e in ENTRANTS if installed(*e.packages)}
    return modules - {"benchmarks.peers.scipy_trf", "benchmarks.peers.lmfit_leastsq"}


def _table(outcomes: dict[str, dict[str, Any]], task: TorqueProblem, agreement: str, cap: float) -> Table:
    completed = {name: outcome for name, outcome in outcomes.items() if "error" not in outcome}
    peers = [completed[e.name]["cost"] for e in ENTRANTS if e.peer and e.name in completed]
    best, known = min(outcome["cost"] for outcome in completed.values()), min(peers, default=np.inf)
    goals = [f"to {goal:.1%}" for goal in GOALS]
    columns = ("solver", "set-up", "solve", "median of", *goals, "threads", "cost", "RMSE, fresh points", "remark")
    table = Table(f"torque: {len(task.training.torque)} points, {task.start.size} free values", columns)
    for entrant in ENTRANTS:
        outcome = outcomes.get(entrant.name)
        if outcome is None:
            table.add(entrant.name, *["-"] * 8, "missing")
        elif "error" in outcome:
            table.add(entrant.name, *["-"] * 8, outcome["error"])
        else:
            table.add(entrant.name, *cells(outcome, best, [known * (1 + goal) for goal in GOALS], "Nm"))
    table.notes = [
        agreement,
        "Budget: to 0.1% in at most 250 ms, 4 times faster than the fastest peer that gets there, 100 times faster "
        "than finite differences.",
        *(
            f"To {goal:.1%}: until the cost is that close to the best of a peer, {known:.6g}. "
            + _ratios(completed, known, goal)
            for goal in GOALS
        ),
        f"A solver that ends more than {HIGHER:.1%} above the best cost of all, {best:.6g}, stops higher.",
        "Set-up is compiling, or building the solver; imports are in neither column. "
        f"Solve is the shortest of up to {REPEATS} runs, each in a process of its own, "
        f"on one thread or on all, whichever was faster; a peer is stopped after {cap:g} s. Load at the end {load()}.",
        "IPOPT's time to a cost is its share of iterations; the others' is the clock's.",
    ]
    return table


def _ratios(completed: dict[str, dict[str, Any]], known: float, goal: float) -> str:
    """Compare the peers' times to a cost with that of Kennfeld."""
    times = times_to_cost(completed, known * (1 + goal))
    own = [times[e.name] for e in ENTRANTS if not e.peer and e.name in times]
    peers = {e.name: times[e.name] for e in ENTRANTS if e.peer and e.name in times}
    if not own:
        return "Kennfeld does not get there."
    if not peers:
        return f"Kennfeld gets there in {seconds(min(own))}, no peer does."
    fastest = min(peers, key=lambda name: peers[name])
    differences = [time for name, time in peers.items() if "finite" in name]
    text = f"Kennfeld gets there in {seconds(min(own))}, "
    text += f"the fastest peer ({fastest}) in {peers[fastest] / min(own):.1f} times"
    return text + (
        f", finite differences in {min(differences) / min(own):.0f} times that." if differences else " that."
    )


def _seeds(cap: float) -> Table:
    """The fastest solvers on other noise: where a descent among creases ends is partly chance."""
    entrants = [e for e in ENTRANTS if not e.peer or "sparse" in e.name]
    entrants = [e for e in entrants if installed(*e.packages)]
    costs: dict[str, list[float]] = {e.name: [] for e in entrants}
    times: dict[str, list[float]] = {e.name: [] for e in entrants}
    for seed in SEEDS:
        task = problem(seed)
        for entrant in entrants:
            outcomes = apart(entrant.target, cores=1, timeout=60 + 3 * cap, seed=seed, **entrant.capped(cap))
            if "error" in outcomes:
                raise RuntimeError(f"{entrant.name} failed: {outcomes['error']}")
            costs[entrant.name].append(task.cost(np.array(outcomes["values"])))
            times[entrant.name].append(outcomes["seconds"])
    best = np.min(list(costs.values()), axis=0)
    columns = ("solver", "median solve", "threads", "mean cost", "above the best: median", "worst", "within 0.1%")
    table = Table(f"torque: the same with the noise of {len(SEEDS)} other seeds", columns)
    for entrant in entrants:
        above = np.array(costs[entrant.name]) / best - 1
        table.add(
            *(entrant.name, seconds(float(np.median(times[entrant.name]))), "1", f"{np.mean(costs[entrant.name]):.6g}"),
            *(f"{np.median(above):.2%}", f"{above.max():.2%}", f"{np.sum(above <= HIGHER)} of {len(SEEDS)}"),
        )
    table.notes = [
        "The best is the lowest cost of these solvers, for each seed. The table above is one draw of the noise; the "
        "cost has creases, and which of many neighbouring ends a descent finds is partly chance."
    ]
    return table
