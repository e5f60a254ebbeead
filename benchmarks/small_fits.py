"""Topic `small`: 1000 fits of one model with three values to 100 samples, beside SciPy's `curve_fit` and lmfit."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.machine import load
from benchmarks.measure import apart, installed
from benchmarks.table import Table, seconds

__all__ = ["measure", "run"]

FITS = 1000
SAMPLES = 100
X = np.linspace(0.0, 5.0, SAMPLES)
START = {"a": 1.0, "b": 1.0, "c": 0.0}
TOOLS = {"Kennfeld": "kennfeld", "SciPy, curve_fit": "scipy", "lmfit": "lmfit"}

Fit = Callable[[Any], list[float]]


def _decay(x: Any, a: Any, b: Any, c: Any) -> Any:
    return a * np.exp(-b * x) + c


def _kennfeld() -> Fit:
    import kennfeld as kf

    model = kf.formula("m = a * exp(-b * x) + c", parameters=list(START))
    return lambda y: [p.value for p in kf.calibrate(model, {"x": X, "y": y}, START, "y").parameters.values()]


def _scipy() -> Fit:
    from scipy.optimize import curve_fit

    return lambda y: list(curve_fit(_decay, X, y, list(START.values()))[0])


def _lmfit() -> Fit:
    from lmfit import Model

    model = Model(_decay)
    return lambda y: [model.fit(y, x=X, **START).params[name].value for name in START]


def measure(tool: str, fits: int = FITS) -> dict[str, Any]:
    """The processor time of so many fits to different noise after a first one, and the mean of the fitted values."""
    fit: Fit = {"kennfeld": _kennfeld, "scipy": _scipy, "lmfit": _lmfit}[tool]()
    random = np.random.default_rng(0)
    exact = _decay(X, 2.0, 0.7, 0.3)
    noisy = exact + random.normal(0.0, 0.01, (fits, SAMPLES))
    began = time.process_time()
    fit(exact + 0.01 * np.cos(40 * X))
    first = time.process_time() - began
    began = time.process_time()
    fitted = [fit(y) for y in noisy]
    return {"first": first, "total": time.process_time() - began, "values": np.mean(fitted, axis=0).tolist()}


def run() -> list[Table]:
    """Return the table of the topic."""
    table = Table(f"{FITS} fits of one model", ["tool", "first fit", "each of the others", "mean of the values"])
    for label, tool in TOOLS.items():
        if not installed(tool):
            table.add(label, "not installed")
            continue
        done = apart("benchmarks.small_fits:measure", cores=1, tool=tool)
        if "error" in done:
            table.add(label, done["error"])
            continue
        values = ", ".join(f"{value:.6f}" for value in done["values"])
        table.add(label, seconds(done["first"]), seconds(done["total"] / FITS), values)
    table.notes.append(
        f"m = a exp(-b x) + c, {SAMPLES} samples, one core, the same noise for all; processor time; {load()}"
    )
    return [table]
