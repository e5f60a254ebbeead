"""Topic `designs`: 30 of 1000 candidate points for a quadratic model, D-optimal, beside `fedorov` of pyDOE3."""

import time
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.table import Table, seconds
from kennfeld.base.arrays import Float
from kennfeld.design.regression_models import polynomial_rows

__all__ = ["measure", "run"]

CANDIDATES, POINTS = 1000, 30
FACTORS = (3, 4)
TOOLS = {"Kennfeld": "kennfeld", "pyDOE3, fedorov": "pyDOE3"}


def _points(factors: int) -> Float:
    return np.random.default_rng(0).uniform(-1, 1, (CANDIDATES, factors))


def measure(tool: str, factors: int) -> dict[str, Any]:
    """The processor time of one design, and the log determinant of its information matrix."""
    points = _points(factors)
    rows = polynomial_rows(points, "quadratic")
    began = time.process_time()
    chosen = rows[_kennfeld(rows)] if tool == "kennfeld" else polynomial_rows(_fedorov(points), "quadratic")
    return {"seconds": time.process_time() - began, "log det": float(np.linalg.slogdet(chosen.T @ chosen)[1])}


def _kennfeld(rows: Float) -> list[int]:
    from kennfeld.design.optimal_exchange import exchange

    return list(exchange(rows, POINTS).chosen)


def _fedorov(points: Float) -> Float:
    from pyDOE3.doe_optimal.algorithms import fedorov

    return np.asarray(fedorov(points, POINTS, 2, "D"))


def run() -> list[Table]:
    """Return the table of the topic."""
    table = Table("Exact D-optimal designs", ["tool", "factors", "log det", "processor time"])
    for factors in FACTORS:
        for label, tool in TOOLS.items():
            if not installed(tool):
                table.add(label, "not installed")
                continue
            done = apart("benchmarks.exact_designs:measure", cores=1, tool=tool, factors=factors)
            if "error" in done:
                table.add(label, str(factors), done["error"])
                continue
            table.add(label, str(factors), f"{done['log det']:.3f}", seconds(done["seconds"]))
    table.notes.append(
        f"{POINTS} of {CANDIDATES} random points, all terms of a quadratic model, repeats admitted; {load()}"
    )
    return [table]
