"""Topic `compile`: from formula text to machine code with derivatives, over nodes and states of the model."""

import os
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import random_formula
from benchmarks.machine import load
from benchmarks.measure import apart
from benchmarks.table import Table, seconds

__all__ = ["measure", "run"]

MODELS = ((1000, 5), (2000, 5), (5500, 0), (5500, 5), (5500, 127), (11_000, 5))  # about so many nodes, states
SAMPLES = 200
REPEATS = 3
SHORT = 10.0  # s; a model that takes longer is not compiled again
WATCHED = {  # column: functions whose time it sums, by the module that calls them
    "lower": ("kennfeld.optimize.problem.problem:lower_lookups",),
    "split": ("kennfeld.optimize.sums.compiled:partition_graph",),
    "differentiate": ("kennfeld.native.kernel:differentiate",),
    "IR text": tuple(f"kennfeld.native.kernel:{name}" for name in ("cost_code", "tape_code", "start_code")),
    "LLVM": ("kennfeld.base.machine_code.engine:_object_code",),
    "data-only part": ("kennfeld.optimize.sums.compiled:SampleAssembly",),
}


def measure(nodes: int, states: int) -> dict[str, Any]:
    """One model, in a process of its own, without code that was kept."""
    os.environ["KENNFELD_CACHE"] = ""
    from kennfeld.domain.criteria import Criterion
    from kennfeld.domain.dataset import Dataset
    from kennfeld.models.formula import formula
    from kennfeld.optimize import Problem
    from kennfeld.optimize.sums.compiled import CompiledProblem
    from kennfeld.optimize.sums.objective import LeastSquaresObjective

    content, parameters = random_formula.text(nodes, states), random_formula.parameters()
    random = np.random.default_rng(0)
    columns = {name: random.uniform(-2, 2, SAMPLES) for name in random_formula.INPUTS}
    columns["measured"] = random.normal(size=SAMPLES)
    data = Dataset.of("random", columns, time=0.1 * np.arange(SAMPLES))
    spent = _watch()
    began = time.perf_counter()
    model = formula(content, parameters=list(parameters))
    parsed = time.perf_counter()
    compiled = CompiledProblem(Problem(model, (data,), parameters, (Criterion("y", "measured"),)))
    ready = time.perf_counter()
    objective = LeastSquaresObjective(compiled)
    cost = objective.cost(objective.start)
    objective.normal(objective.start)
    first = time.perf_counter()
    return {
        **spent,
        "nodes": len(model.graph.nodes),
        "states": len(model.graph.states),
        "atoms": len(compiled.kernel.line.atoms),
        "derivative": len(compiled.kernel.line.nodes),
        "parse": parsed - began,
        "compile": ready - parsed,
        "first": first - ready,
        "cost": cost,
    }


def _watch() -> dict[str, float]:
    """Sum the time in the watched functions; one that has gone is left at zero."""
    from importlib import import_module

    spent: dict[str, float] = defaultdict(float)
    for column, places in WATCHED.items():
        spent[column] = 0.0
        for place in places:
            module, name = place.split(":")
            home = import_module(module)
            if hasattr(home, name):
                setattr(home, name, _timed(getattr(home, name), spent, column))
    return spent


def _timed(work: Callable[..., Any], spent: dict[str, float], column: str) -> Callable[..., Any]:
    def timed(*args: Any, **named: Any) -> Any:
        began = time.perf_counter()
        try:
            return work(*args, **named)
        finally:
            spent[column] += time.perf_counter() - began

    return timed


def run() -> list[Table]:
    """All models; the run whose total was shortest."""
    columns = (
        "nodes",
        "lookups",
        "states",
        "with derivatives",
        "parse",
        *WATCHED,
        "parse + compile",
        "first iteration",
    )
    table = Table("compile: a generated formula with derivatives", (*columns, "threads", "cost"))
    for nodes, states in MODELS:
        runs: list[dict[str, Any]] = []
        while len(runs) < REPEATS and sum(outcome.get("compile", SHORT) for outcome in runs) < SHORT:
            runs.append(apart("benchmarks.compiling:measure", cores=1, nodes=nodes, states=states))
        completed = [outcome for outcome in runs if "error" not in outcome]
        if not completed:
            table.add(f"about {nodes}", runs[0]["error"])
            continue
        fastest = min(completed, key=lambda outcome: outcome["parse"] + outcome["compile"])
        table.add(
            *(str(fastest[name]) for name in ("nodes", "atoms", "states", "derivative")),
            *(seconds(fastest[name]) for name in ("parse", *WATCHED)),
            *(seconds(fastest["parse"] + fastest["compile"]), seconds(fastest["first"]), "1", f"{fastest['cost']:.6g}"),
        )
    table.notes = [
        "Budget: 5 000 nodes in at most 2 s, parse + compile.",
        f"The shortest of up to {REPEATS} runs, each in a process of its own, imports left out. "
        "The first iteration compiles the sums over samples, which do not depend on the model. "
        f"Load at the end {load()}.",
    ]
    return [table]
