"""Dynamic data-driven models beside linear ones and polynomial NARX models of SysIdentPy, in free run.

Set `ENGINE_TRANSIENT` to the folder of gengine1 recordings (boschresearch/Bosch-Engine-Datasets) and `CASCADED_TANKS`
to the file dataBenchmark.csv (nonlinearbenchmark.org); without them nothing is measured.
"""

import os
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import kennfeld as kf
from benchmarks.measure import installed
from benchmarks.table import Table, seconds

__all__ = ["run"]

INPUTS = ("speed", "load", "lambda", "ignition", "fuel_cutoff")
TARGETS = ("T_exh_manifold",)
HELD_OUT = "m53"
SEEDS = (0, 1)
LONG = 100_000  # steps of a free run
POLYNOMIAL = {"degree": 2, "longest": 4, "terms": 20}
FAR = 100.0  # times the output, or its spread, from which a run diverges
SAMPLES = 10_000  # that SysIdentPy is given at most


@dataclass(frozen=True)
class _System:
    """Recordings of one system; the test recordings are run freely from their first 10 samples on."""

    name: str
    unit: str
    inputs: tuple[str, ...]
    output: str
    datasets: Sequence[kf.Dataset]

    def arrays(self, use: str) -> tuple[np.ndarray, np.ndarray]:
        """Return inputs and output of one use, recording after recording."""
        used = [data for data in self.datasets if data.use == use]
        u = np.concatenate([np.column_stack([data[name].values for name in self.inputs]) for data in used])
        return u, np.concatenate([data[self.output].values for data in used])


def run() -> list[Table]:
    """Train on each system that is there, and run the test recordings freely."""
    columns = (
        "system",
        "model",
        "test RMSE",
        "in two deviations",
        "CPU of the training",
        "largest of 1e5 steps",
        "lags or filters",
    )
    table = Table("Dynamic data-driven models: free run over recordings that are not used for training", columns)
    for system in _systems():
        for seed in SEEDS:
            surrogate = _kennfeld(table, system, f"Kennfeld, seed {seed}", seed=seed)
        _linear(table, system, surrogate)
        _kennfeld(table, system, "Kennfeld, filtered", structure="filtered")
        if installed("sysidentpy"):
            _sysidentpy(table, system)
        else:
            table.add(system.name, "SysIdentPy is not installed")
    table.notes += [
        "Kennfeld with its default settings; the step is that of the recordings.",
        f"SysIdentPy: FROLS, degree {POLYNOMIAL['degree']}, lags up to {POLYNOMIAL['longest']}, {POLYNOMIAL['terms']} "
        f"terms, at most {SAMPLES} samples.",
        "1e5 steps: inputs of the training data, each held for 5 to 100 samples; the largest |output| is relative to "
        "that of the training data.",
    ]
    return [table]


def _systems() -> Iterator[_System]:
    tanks, engine = os.environ.get("CASCADED_TANKS"), os.environ.get("ENGINE_TRANSIENT")
    if tanks:
        data = kf.read(tanks)
        time_stamps = 4.0 * np.arange(data.samples)
        halves = [
            kf.Dataset.of(half, {"u": data[f"u{half}"].values, "y": data[f"y{half}"].values}, time=time_stamps, use=use)
            for half, use in (("Est", "training"), ("Val", "test"))
        ]
        yield _System("cascaded tanks", " V", ("u",), "y", halves)
    for target in TARGETS if engine else ():
        datasets = []
        for path in sorted(Path(str(engine)).glob("gengine1_*.csv.gz")):
            data, name = kf.read(path), path.name.split(".")[0]
            channels = {channel: data[channel].values for channel in (*INPUTS, target)}
            use = "test" if name.endswith(HELD_OUT) else "training"
            datasets.append(kf.Dataset.of(name, channels, time=data.time, use=use))
        yield _System(target, "", INPUTS, target, datasets)


def _kennfeld(table: Table, system: _System, label: str, **settings: Any) -> Any:
    made = kf.SurrogateSettings("model", system.inputs, system.output, kind="dynamic", **settings)
    began = time.process_time()
    surrogate = kf.train_surrogate(system.datasets, made)
    spent = time.process_time() - began
    (test,) = [row for row in surrogate.quality if row.use == "test" and row.mode == "free run"]
    reached = _largest(system, lambda u, y: surrogate.simulate(u, y[:1]))
    covered = f"{_covered(surrogate, system):.1%}"
    table.add(system.name, label, f"{test.rmse:.4f}{system.unit}", covered, seconds(spent), reached, _memory(surrogate))
    return surrogate


def _covered(surrogate: Any, system: _System) -> float:
    """Return the share of the free samples of the test recording that are within two deviations."""
    u, y = system.arrays("test")
    back = max(getattr(surrogate, "output_lags", (0,)))
    error, deviation = surrogate.simulate(u, y[:back]) - y, surrogate.deviation(u, y[:back])
    return float(np.mean((np.abs(error) <= 2 * deviation)[back:]))


def _memory(surrogate: Any) -> str:
    if isinstance(surrogate, kf.FilteredSurrogate):
        return "filters " + ", ".join(f"{T:.3g} s" for T in surrogate.time_constants)
    inputs = "; ".join(",".join(map(str, lags)) for lags in surrogate.lags)
    return f"y {','.join(map(str, surrogate.output_lags))}; u {inputs}"


def _linear(table: Table, system: _System, surrogate: Any) -> None:
    for row in surrogate.quality:
        if row.use == "test" and row.mode in ("ARX", "plane"):
            table.add(system.name, row.mode, f"{row.rmse:.4f}{system.unit}")


def _largest(system: _System, simulate: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> str:
    """Run long over steps of inputs, and return the largest output relative to that of the training data."""
    u, y = system.arrays("training")
    rng = np.random.default_rng(0)
    picked = np.repeat(rng.integers(len(u), size=LONG), rng.integers(5, 100, size=LONG))[:LONG]
    with np.errstate(all="ignore"):
        reached = np.abs(simulate(u[picked], np.full(LONG, y.mean()))).max() / np.abs(y).max()
    return f"{reached:.3g}" if reached < FAR else "diverges"


def _sysidentpy(table: Table, system: _System) -> None:
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS

    (u, y), (test_u, test_y) = system.arrays("training"), system.arrays("test")
    lags = list(range(1, POLYNOMIAL["longest"] + 1))
    began = time.process_time()
    model = FROLS(
        order_selection=False,
        n_terms=POLYNOMIAL["terms"],
        ylag=lags,
        xlag=[lags] * u.shape[1] if u.shape[1] > 1 else lags,
        basis_function=Polynomial(degree=POLYNOMIAL["degree"]),
    )
    model.fit(X=u[:SAMPLES], y=y[:SAMPLES, None])
    spent = time.process_time() - began
    with np.errstate(all="ignore"):
        free = model.predict(X=test_u, y=test_y[: POLYNOMIAL["longest"], None])[:, 0]
        rmse = float(np.sqrt(np.mean((free - test_y) ** 2)))
    shown = f"{rmse:.4f}{system.unit}" if rmse < FAR * test_y.std() else "diverges"
    reached = _largest(system, lambda u, y: model.predict(X=u, y=y[: POLYNOMIAL["longest"], None])[:, 0])
    table.add(system.name, "SysIdentPy, FROLS", shown, "", seconds(spent), reached, f"y 1-{lags[-1]}; u 1-{lags[-1]}")
