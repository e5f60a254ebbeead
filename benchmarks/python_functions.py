"""Topic `python`: a calibration whose formula text calls a function in Python, beside the same in formula text."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart
from benchmarks.table import Table, seconds

__all__ = ["measure", "run"]

SAMPLES = 20_000
REPEATS = 5  # processes
RUNS = 6  # in each, the first of which compiles
TEXT = "eta = exp(-(k * delta)^2 / 800)"
CALL = "eta = efficiency(delta, k)"
MODEL = "delta = zopt(n, load) - spark\n{}\ntorque = top(n, load) * eta"
FORMS = {
    "formula text": "",
    "function of arrays": "arrays",
    "function of arrays, own derivatives": "jac",
    "function of numbers, sample by sample": "numbers",
}


class _Timed:
    """A function, and the time spent in it."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.seconds = function, 0.0

    def __call__(self, delta: Any, k: Any) -> Any:
        began = time.perf_counter()
        try:
            return self.function(delta, k)
        finally:
            self.seconds += time.perf_counter() - began


def _efficiency(delta: Any, k: Any) -> Any:
    return np.exp(-((k * delta) ** 2) / 800)


def _efficiency_of_numbers(delta: float, k: float) -> float:
    return float(_efficiency(float(delta), float(k)))


def _slopes(delta: Any, k: Any) -> Any:
    common = -_efficiency(delta, k) * k * delta / 400
    return common * k, common * delta


def measure(form: str) -> dict[str, Any]:
    """The shortest of several calibrations in a process of its own."""
    import kennfeld as kf

    random = np.random.default_rng(0)
    n, air, spark = random.uniform(size=(3, SAMPLES)) * [[5000], [90], [40]] + [[1000], [10], [0]]
    optimum = 10 + 15 * n / 6000 + 10 * (1 - air / 100)
    torque = (40 + 2.5 * air + n / 100) * np.exp(-((optimum - spark) ** 2) / 800) + random.normal(0, 2, SAMPLES)
    data = {"n": n, "load": air, "spark": spark, "measured": torque}
    axes = kf.Axis(np.linspace(1000, 6000, 12), "n"), kf.Axis(np.linspace(10, 100, 10), "load")
    top, zopt = kf.Map("top", *axes, np.full((12, 10), 150.0)), kf.Map("zopt", *axes, np.full((12, 10), 20.0))
    start = kf.ParameterSet([top, zopt, kf.Scalar("k", 0.8)])
    function = _Timed(_efficiency_of_numbers if form == "numbers" else _efficiency)
    slopes = _Timed(_slopes)
    functions = {"efficiency": kf.function(function, slopes if form == "jac" else None, ["eta"])}
    text = MODEL.format(CALL if form else TEXT)
    smoothness = dict.fromkeys(("top", "zopt"), 1.0)
    runs = []
    for _ in range(RUNS):
        function.seconds = slopes.seconds = 0.0
        model = kf.formula(text, parameters=list(start), functions=functions)
        began = time.perf_counter()
        result = kf.calibrate(model, data, start, "measured", node="torque", smoothness=smoothness)
        runs.append((time.perf_counter() - began, function.seconds + slopes.seconds))
    total, own = min(runs)
    return {"total": total, "own": own, "evaluations": result.evaluations, "cost": result.cost_after}


def run() -> list[Table]:
    """All forms, in several processes each."""
    columns = ("form", "total", "in the function", "total less that, of formula text", "evaluations", "cost")
    table = Table(f"python: {SAMPLES} samples, 241 free values, a function in Python", columns)
    base = 0.0
    for form, key in FORMS.items():
        runs = [apart("benchmarks.python_functions:measure", form=key) for _ in range(REPEATS)]
        if failed := next((outcome for outcome in runs if "error" in outcome), None):
            table.add(form, failed["error"])
            continue
        middle = sorted(runs, key=lambda outcome: outcome["total"])[len(runs) // 2]
        base = base or middle["total"]
        share = f"{(middle['total'] - middle['own']) / base:.2f}"
        own = seconds(middle["own"]) if key else "-"
        table.add(form, seconds(middle["total"]), own, share, str(middle["evaluations"]), f"{middle['cost']:.8g}")
    table.notes.append(
        f"Median of {REPEATS} processes, each with the shortest of {RUNS} calibrations, as the first one compiles. "
        f"Load: {load()}."
    )
    return [table]
