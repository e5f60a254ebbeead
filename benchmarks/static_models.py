"""Static data-driven models beside scikit-learn's Gaussian processes, boosting and forests: errors on held-out data.

Set `ENGINE_STEADY` and `ENGINE_TRANSIENT` to the folders pengines and gengine1 of boschresearch/Bosch-Engine-Datasets
for the outputs of real engines; the generated sets and diabetes come with scikit-learn.
"""

import gzip
import os
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import kennfeld as kf
from benchmarks.measure import installed
from benchmarks.table import Table, seconds

__all__ = ["run"]

STEADY_INPUTS = ("engine_speed", "engine_load", "intake_valve_opening", "air_fuel_ratio")
TRANSIENT_INPUTS = ("speed", "load", "lambda", "ignition", "fuel_cutoff")
TRANSIENT_OUTPUTS = ("PN", "CO", "CO2", "HC", "NOx", "O2", "T_exh_manifold", "T_catalyst")
THINNED = 10  # of 10 Hz
HELD_OUT = 200  # steady points
SEEDS = (0, 1)
MOST_GP = 600  # points of a Gaussian process of scikit-learn
PEERS = ("GP, RBF", "GP, Matern", "boosting", "forest")
NEAR = 1.05  # of the best peer's error


class Problem(NamedTuple):
    """Training and test data; `timed` tells whether they are recordings over time."""

    name: str
    x: np.ndarray
    y: np.ndarray
    x_test: np.ndarray
    y_test: np.ndarray
    timed: bool = False


def run() -> list[Table]:
    """Train a model of each output, and the peers if scikit-learn is installed."""
    columns = ("output", "points", "plane", "Kennfeld", "other seed", "kernel", "in two deviations", "CPU")
    table = Table("static: RMSE on held-out data", (*columns, *PEERS, "to the best peer"))
    if not installed("sklearn"):
        table.notes.append("scikit-learn is not installed.")
        return [table]
    ratios, planes, scatter, spent = [], [], [], []
    for problem in _problems():
        ours = [_ours(problem, seed) for seed in SEEDS]
        peers = [_rmse(_peer(problem, name), problem.y_test) for name in PEERS]
        error, plane = ours[0]["rmse"], ours[0]["plane"]
        ratios.append(error / min(peers))
        planes.append(error / plane)
        scatter.append(abs(np.log(ours[1]["rmse"] / error)))
        spent += [each["seconds"] for each in ours]
        first = (
            f"{plane:.4g}",
            f"{error:.4g}",
            f"{ours[1]['rmse']:.4g}",
            ours[0]["kernel"],
            f"{ours[0]['covered']:.3f}",
        )
        cells = (*first, seconds(ours[0]["seconds"]), *(f"{peer:.4g}" for peer in peers), f"{ratios[-1]:.3f}")
        table.add(problem.name, str(len(problem.y)), *cells)
    near, count = int(np.sum(np.array(ratios) <= NEAR)), len(ratios)
    table.notes += [
        f"Within 5 % of the best peer on {near} of {count} outputs; at most {max(planes):.3f} times the error of the "
        f"plane; two seeds differ by {100 * np.expm1(max(scatter)):.1f} % at most.",
        f"A training takes {min(spent):.1f} to {max(spent):.1f} s of CPU on one thread, both kernels included.",
        f"GP: `GaussianProcessRegressor` with a length scale per input and `WhiteKernel`, on at most {MOST_GP} points; "
        "boosting: `HistGradientBoostingRegressor`; forest: 100 trees; each with its default settings.",
    ]
    return [table]


def _ours(problem: Problem, seed: int) -> dict[str, Any]:
    names = [f"x{d}" for d in range(problem.x.shape[1])]

    def dataset(use: str, x: np.ndarray, y: np.ndarray) -> kf.Dataset:
        stamps = np.arange(len(y)) * float(THINNED) / 10 if problem.timed else None
        channels = dict(zip(names, x.T, strict=True)) | {"y": y}
        return kf.Dataset.of(use, channels, time=stamps, use=use)  # type: ignore[arg-type]

    data = [dataset("training", problem.x, problem.y), dataset("test", problem.x_test, problem.y_test)]
    began = time.process_time()
    model = kf.train_surrogate(data, kf.SurrogateSettings("m", tuple(names), "y", seed=seed))
    spent = time.process_time() - began
    assert isinstance(model, kf.StaticSurrogate)
    rows = {(line.dataset, line.mode): line.rmse for line in model.quality}
    error = np.abs(model(problem.x_test) - problem.y_test)
    return {
        "rmse": rows["test", "static"],
        "plane": rows["test", "plane"],
        "kernel": model.expansion.kernel if model.expansion.size else "plane",
        "covered": float(np.mean(error < 2 * model.deviation(problem.x_test))),
        "seconds": spent,
    }


def _peer(problem: Problem, name: str) -> np.ndarray:
    from sklearn.ensemble import HistGradientBoostingRegressor, RandomForestRegressor
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Matern, WhiteKernel
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    x, y, ones = problem.x, problem.y, np.ones(problem.x.shape[1])
    if name.startswith("GP"):
        part = np.random.default_rng(0).permutation(len(y))[:MOST_GP]
        x, y = x[part], y[part]
        shape = RBF(ones) if name == "GP, RBF" else Matern(ones, nu=2.5)
        kernel = ConstantKernel() * shape + WhiteKernel(0.1)
        process = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0)
        model = make_pipeline(StandardScaler(), process)
    elif name == "boosting":
        model = HistGradientBoostingRegressor(random_state=0)
    else:
        model = RandomForestRegressor(100, random_state=0, n_jobs=1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # lengths at their bounds
        return np.asarray(model.fit(x, y).predict(problem.x_test))


def _rmse(predicted: np.ndarray, target: np.ndarray) -> float:
    return float(np.sqrt(np.mean((predicted - target) ** 2)))


def _problems() -> Iterator[Problem]:
    if "ENGINE_STEADY" in os.environ:
        yield from _steady(Path(os.environ["ENGINE_STEADY"]))
    if "ENGINE_TRANSIENT" in os.environ:
        yield from _transient(Path(os.environ["ENGINE_TRANSIENT"]))
    yield from _shipped()


def _steady(folder: Path) -> Iterator[Problem]:
    from python_calamine import CalamineWorkbook

    rows = CalamineWorkbook.from_path(folder / "engine1_normalized.xlsx").get_sheet_by_name("data").to_python()
    names = [str(name) for name in rows[0]]
    table = np.array([row for row in rows[2:] if isinstance(row[1], float)], dtype=np.float64)
    order = np.random.default_rng(0).permutation(len(table))
    x = table[:, [names.index(name) for name in STEADY_INPUTS]]
    for name in names[5:]:
        y = table[:, names.index(name)]
        test, part = order[:HELD_OUT], order[HELD_OUT:]
        yield Problem(f"engine_steady {name}", x[part], y[part], x[test], y[test])


def _transient(folder: Path) -> Iterator[Problem]:
    training = np.concatenate([_recording(folder, name) for name in ("m10", "m11", "m12", "m30", "m31")])
    test = _recording(folder, "m53")
    x, x_test = (np.column_stack([part[name] for name in TRANSIENT_INPUTS]) for part in (training, test))
    for name in TRANSIENT_OUTPUTS:
        yield Problem(f"engine_transient {name}", x, training[name], x_test, test[name], timed=True)


def _recording(folder: Path, name: str) -> np.ndarray:
    with gzip.open(folder / f"gengine1_{name}.csv.gz", "rt", encoding="utf-8") as file:
        return np.genfromtxt(file, delimiter=",", names=True)[::THINNED]


def _shipped() -> Iterator[Problem]:
    from sklearn.datasets import load_diabetes, make_friedman1, make_friedman2, make_friedman3

    diabetes = load_diabetes()
    order = np.random.default_rng(0).permutation(len(diabetes.target))
    test, part = order[:110], order[110:]
    yield Problem("diabetes", diabetes.data[part], diabetes.target[part], diabetes.data[test], diabetes.target[test])
    for name, make, noise in (
        ("friedman1", make_friedman1, 1.0),
        ("friedman2", make_friedman2, 100.0),
        ("friedman3", make_friedman3, 0.2),
    ):
        x, y = make(1400, noise=noise, random_state=0)
        yield Problem(name, x[:400], y[:400], x[400:], y[400:])
