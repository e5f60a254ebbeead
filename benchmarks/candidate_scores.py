"""Topic `scores`: the scores of all candidates for a missing term, curves and maps, over up to a million samples."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

import kennfeld as kf
from benchmarks.machine import load
from benchmarks.measure import apart, peak, reset_peak, threads
from benchmarks.table import Table, megabytes, seconds
from kennfeld.base.arrays import Float
from kennfeld.base.threads import available_cores

__all__ = ["measure", "run"]

CHANNELS = 20
GRIDS = {500: (20, 100), 154: (12, 10)}  # by the number of values: breakpoints of both axes of the map, of the curve
# samples, values, with memory
CASES = (
    (10_000, 500, False),
    (100_000, 500, False),
    (1_000_000, 500, False),
    (100_000, 500, True),
    (100_000, 154, True),
    (1_000_000, 154, True),
)
TEXT = "a = M(x, z)\nb = C(c0)\nc = b * x\nd = a + c\ny = {output}\n"
COLUMNS = ("samples", "function", "values", "candidates", "CPU time", "of it maps", "per core", "memory", "data")


def run() -> list[Table]:
    """All sizes, in processes of their own."""
    table = Table(f"scores: candidates for a missing term in a function of {CHANNELS} channels", COLUMNS)
    for samples, values, timed in CASES:
        outcome = apart("benchmarks.candidate_scores:measure", samples=samples, values=values, timed=timed)
        table.add(f"{samples}", "PT1" if timed else "without memory", f"{values}", *_cells(outcome))
    table.notes = [
        "Breakpoints for all channels, one linearisation, scores of curves at each node, added and multiplied, then of "
        "products of two channels and of maps. With memory, lags and delays as well.",
        f"Per core: CPU time over {threads(None)} cores. Memory is the peak above that before the scores, of the data "
        f"what the channels take. Load at the end {load()}.",
    ]
    return [table]


def _cells(outcome: Mapping[str, Any]) -> tuple[str, ...]:
    if "error" in outcome:
        return (outcome["error"], *["-"] * 5)
    return (
        f"{outcome['curves']} + {outcome['maps']}",
        *(seconds(outcome[name]) for name in ("cpu", "of_maps", "per_core")),
        *(megabytes(outcome[name]) for name in ("peak", "bytes")),
    )


def data(samples: int, *, timed: bool) -> dict[str, Float]:
    """Return channels, and a target that lacks a curve and a product of two channels in the function."""
    random = np.random.default_rng(0)
    columns: dict[str, Float] = {
        name: random.random(samples) for name in ("x", "z", *(f"c{i}" for i in range(CHANNELS - 2)))
    }
    known = np.sin(3 * columns["x"]) + columns["z"] ** 2 + 0.3 * np.sin(6 * columns["c0"]) * columns["x"]
    lacking = 0.1 * columns["c3"] ** 2 + 0.3 * (columns["c5"] - 0.5) * (columns["c6"] - 0.5)
    columns["m"] = known + lacking + 0.1 * random.standard_normal(samples)
    if timed:
        columns["time"] = np.asarray(0.1 * np.arange(samples), dtype=np.float64)
    return columns


def measure(samples: int, values: int, timed: bool) -> dict[str, Any]:
    """Score all candidates of one size, in a process of its own."""
    from kennfeld.analysis.missing.channels import Channels
    from kennfeld.analysis.missing.map_scoring import score_maps
    from kennfeld.analysis.missing.probes import Nodes
    from kennfeld.analysis.missing.scoring import score_problem
    from kennfeld.analysis.missing.terms import OF_CHANNELS, Form
    from kennfeld.optimize.problem.setup import ProblemSetup

    x, fine = (np.linspace(0, 1, count) for count in GRIDS[values])
    table = kf.Map("M", kf.Axis(x, "x"), kf.Axis(x, "z"), np.add.outer(np.sin(3 * x), x**2))
    start = {"M": table, "C": kf.Curve("C", fine, 0.3 * np.sin(6 * fine))}
    text = TEXT.format(output="PT1(d, 0.5)" if timed else "d * (1 + 0 * x)")
    columns = data(samples, timed=timed)
    problem = ProblemSetup(text, columns, start, "m", smoothness=1e-2).problem()
    before, began = reset_peak(), time.process_time()
    channels, nodes = Channels.of(problem), Nodes.of(problem)
    in_time: tuple[Form, ...] = ("lag", "delay") if timed else ()
    curves = score_problem(problem, channels, nodes, (*OF_CHANNELS, *in_time))
    between = time.process_time()
    maps = score_maps(problem, channels, nodes, OF_CHANNELS, curves.scores)
    ended = time.process_time()
    return {
        "curves": len(curves.scores),
        "maps": maps.candidates,
        "cpu": ended - began,
        "of_maps": ended - between,
        "per_core": (ended - began) / available_cores(),
        "peak": peak() - before,
        "bytes": sum(column.nbytes for column in columns.values()),
    }
