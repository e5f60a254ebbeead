"""Topic `large`: thousands of values, in one map or in many, from the start to the end with trust.

The models are linear in their values, so that scipy can solve them in one step from a sparse Jacobian: it has the
easier task, and shows which cost has to be reached.
"""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import load
from benchmarks.measure import apart, installed, peak, reset_peak
from benchmarks.table import Table, megabytes, seconds

__all__ = ["calibrate", "run", "solve"]

Float = NDArray[np.float64]

MAPS = ((45, 20_000), (70, 50_000), (100, 100_000))  # breakpoints of each axis, samples
MANY = (("selected", 10, 20_000), ("selected", 102, 20_000), ("selected", 204, 40_000), ("added", 102, 20_000))
POINTS = 7  # breakpoints of each axis of many maps
NOISE, SMOOTHNESS = 0.01, 1e-4
DENSE = 5000  # values up to which a dense inverse is worth waiting for
COLUMNS = ("model", "values", "samples", "tool", "optimise", "trust", "process", "memory", "final cost")


def run() -> list[Table]:
    """All models, with each tool."""
    table = Table("large: maps of thousands of values, fitted with smoothness", COLUMNS)
    cases = [("one map", 1, points, samples) for points, samples in MAPS]
    cases += [(f"maps {kind}", count, POINTS, samples) for kind, count, samples in MANY]
    for kind, count, points, samples in cases:
        case: dict[str, Any] = {"kind": kind.split()[-1], "count": count, "points": points, "samples": samples}
        label = (f"{kind} of {points} x {points}" if count == 1 else f"{count} {kind}", f"{count * points**2}")
        for tool, entry in (("Kennfeld", "calibrate"), ("scipy", "solve")):
            if tool == "Kennfeld" or installed("scipy"):
                began = time.perf_counter()
                outcome = apart(f"benchmarks.large:{entry}", **case)
                table.add(*label, f"{samples}", tool, *_cells(outcome, time.perf_counter() - began))
    table.notes = [
        "Maps that are selected: a condition selects one of them for each sample. Maps that are added: all are looked "
        "up at the same place, each with its own factor. Memory is the peak above that of the data.",
        "Trust of Kennfeld: standard deviations, weak and undetermined directions, counts. scipy: sparse normal "
        f"equations by `spsolve`; trust is a dense inverse, up to {DENSE} values. Load at the end {load()}.",
        "Budgets: 4900 values: trust <= 1 s. 10 000 values, also in 204 maps: process <= 5 s, < 1.5 GB.",
    ]
    return [table]


def _cells(outcome: Mapping[str, Any], process: float) -> Sequence[str]:
    if "error" in outcome:
        return (outcome["error"], *["-"] * 4)
    trust = "-" if outcome["trust"] is None else seconds(outcome["trust"])
    return seconds(outcome["optimize"]), trust, seconds(process), megabytes(outcome["peak"]), f"{outcome['cost']:.6g}"


def data(kind: str, count: int, samples: int) -> dict[str, Float]:
    """Inputs and target of a model."""
    rng = np.random.default_rng(0)
    columns = {name: rng.uniform(0, 1, samples) for name in "xy"}
    shape = np.sin(6 * columns["x"]) * np.cos(5 * columns["y"])
    if kind == "selected":
        columns["mode"] = rng.integers(0, count, samples).astype(np.float64)
        shape = shape * (1 + columns["mode"] / count)
    elif kind == "added":
        factors = rng.standard_normal((count, samples))
        columns |= {f"w{i}": factor for i, factor in enumerate(factors)}
        shape = sum(factor * np.sin((3 + i % 5) * columns["x"]) * columns["y"] for i, factor in enumerate(factors))
    columns["target"] = shape + NOISE * rng.standard_normal(samples)
    return columns


def formula(kind: str, count: int) -> str:
    """The model as text."""
    terms = {
        "map": "M0(x, y)",
        "selected": " + ".join(f"if(mode == {i}, M{i}(x, y), 0)" for i in range(count)),
        "added": " + ".join(f"w{i} * M{i}(x, y)" for i in range(count)),
    }
    inputs = {"map": [], "selected": ["mode"], "added": [f"w{i}" for i in range(count)]}
    lines = [*(f"input {name}" for name in ("x", "y", *inputs[kind])), *(f"map M{i}" for i in range(count))]
    return "\n".join([*lines, f"z = {terms[kind]}", "output z"])


def calibrate(kind: str, count: int, points: int, samples: int) -> dict[str, Any]:
    """Kennfeld from the start to the end with trust, in a process of its own."""
    import kennfeld as kf

    columns = data(kind, count, samples)
    axis = np.linspace(0, 1, points)
    names = [f"M{i}" for i in range(count)]
    start = kf.ParameterSet([kf.Map(name, axis, axis, np.zeros((points, points))) for name in names])
    dataset = kf.Dataset("samples", tuple(kf.Channel(name, values) for name, values in columns.items()))
    before = reset_peak()
    smoothness = dict.fromkeys(names, SMOOTHNESS)
    result = kf.calibrate(formula(kind, count), dataset, start, "target", node="z", smoothness=smoothness)
    began = time.perf_counter()
    trust = result.trust
    ended = time.perf_counter()
    assert trust.deviation
    return {
        "optimize": result.seconds.optimize,
        "trust": ended - began,
        "cost": result.cost_after,
        "peak": peak() - before,
    }


def solve(kind: str, count: int, points: int, samples: int) -> dict[str, Any]:
    """Solve with scipy on the sparse normal equations, in a process of its own."""
    from scipy.sparse import csc_array, vstack
    from scipy.sparse.linalg import spsolve

    columns = data(kind, count, samples)
    before = reset_peak()
    began = time.perf_counter()
    rows = vstack([_jacobian(kind, count, points, columns), _roughness(count, points)], format="csr")
    right = np.concatenate([columns["target"], np.zeros(rows.shape[0] - samples)])
    normal = csc_array(rows.T @ rows)
    values = spsolve(normal, rows.T @ right)
    ended = time.perf_counter()
    trust = None
    if rows.shape[1] <= DENSE:
        np.diag(np.linalg.inv(normal.toarray()))
        trust = time.perf_counter() - ended
    cost = float(np.sum((rows @ values - right) ** 2))
    return {"optimize": ended - began, "trust": trust, "cost": cost, "peak": peak() - before}


def _jacobian(kind: str, count: int, points: int, columns: Mapping[str, Float]) -> Any:
    from scipy.sparse import csr_array

    places, shares = [], []
    for name in "xy":
        at = columns[name] * (points - 1)
        cell = np.minimum(at.astype(np.int64), points - 2)
        places.append(np.stack([cell, cell + 1]))
        shares.append(np.stack([1 - (at - cell), at - cell]))
    corner = (places[0][:, None] * points + places[1][None]).reshape(4, -1)
    weight = (shares[0][:, None] * shares[1][None]).reshape(4, -1)
    samples = np.broadcast_to(np.arange(corner.shape[1]), corner.shape)
    parts = [(samples, corner, weight)]
    if kind == "selected":
        parts = [(samples, corner + columns["mode"].astype(np.int64) * points**2, weight)]
    elif kind == "added":
        parts = [(samples, corner + i * points**2, weight * columns[f"w{i}"]) for i in range(count)]
    rows, places_, values = (np.concatenate([part[i].ravel() for part in parts]) for i in range(3))
    return csr_array((values, (rows, places_)), shape=(corner.shape[1], count * points**2))


def _roughness(count: int, points: int) -> Any:
    """The second differences of all maps along both axes, times the root of factor over points."""
    from scipy.sparse import block_diag, diags_array, eye_array, kron, vstack

    bend = diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(points - 2, points))
    along = vstack([kron(bend, eye_array(points)), kron(eye_array(points), bend)])
    return block_diag([along * np.sqrt(SMOOTHNESS / points)] * count)
