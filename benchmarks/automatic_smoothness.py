"""Automatic smoothness beside the best fixed factor: errors of values, their deviations, and CPU time.

Fixed factors are relative to the number of samples; the best one is known only afterwards. Set `ENGINE_TRANSIENT` to
the folder of gengine1 recordings (boschresearch/Bosch-Engine-Datasets) for errors on recordings that are held out.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import kennfeld as kf
from benchmarks.table import Table, seconds

__all__ = ["run"]

SAMPLES, SEEDS, NOISE = (300, 3_000, 30_000, 300_000), 8, 2.0
RELATIVE = 10.0 ** np.arange(-6, 2)  # fixed factors for each sample
POINTS = np.linspace(0, 1, 9)
SURFACE = 100 + 30 * np.sin(3 * POINTS[:, None]) * np.cos(2 * POINTS) + 20 * POINTS[:, None] * POINTS
MAP = kf.ParameterSet([kf.Map("M", POINTS, POINTS, np.zeros((9, 9)))])
SENSOR = "y = PT1(M(speed, load), T(load))"
TARGETS = ("T_exh_manifold", "T_catalyst")
FIXED = 10.0 ** np.arange(-2, 6)


def run() -> list[Table]:
    """Measure a map with known values, few points on large maps and, if they are there, recordings of an engine."""
    folder = os.environ.get("ENGINE_TRANSIENT")
    return [_known(), _few(), *([_recorded(Path(folder))] if folder else [])]


def _timed(*arguments: object, **keywords: object) -> tuple[kf.Result, float]:
    began = time.process_time()
    result = kf.calibrate(*arguments, **keywords)  # type: ignore[arg-type]
    return result, time.process_time() - began


def _points(samples: int, seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 1, (2, samples))
    truth = kf.ParameterSet([kf.Map("M", POINTS, POINTS, SURFACE)])
    clean = kf.simulate("m = M(x, y)", {"x": x, "y": y}, truth)["m"].values
    return {"x": x, "y": y, "wanted": clean + NOISE * rng.normal(size=samples)}


def _known() -> Table:
    columns = (
        "samples",
        "automatic",
        "best fixed",
        "ratio",
        "within two deviations",
        "CPU of a fixed fit",
        "automatic",
    )
    table = Table("Automatic smoothness: RMS error of the 81 values of a map", columns)
    for samples in SAMPLES:
        squares, inside, spent = np.zeros(1 + RELATIVE.size), [], []
        for seed in range(SEEDS):
            data, times = _points(samples, seed), []
            for number, factor in enumerate(("auto", *(samples * RELATIVE))):
                result, own = _timed("m = M(x, y)", data, MAP, target="wanted", smoothness=factor)
                error = result.parameters["M"].values - SURFACE
                squares[number] += np.mean(error**2) / SEEDS
                times.append(own)
                if factor == "auto":
                    inside.append(np.mean(np.abs(error) <= 2 * result.trust.deviation["M"]))
            spent.append((times[0], np.median(times[1:])))
        automatic, *fixed = np.sqrt(squares)
        own, other = np.median(spent, axis=0)
        ratios = f"{automatic:.3f}", f"{min(fixed):.3f}", f"{automatic / min(fixed):.2f}"
        table.add(f"{samples}", *ratios, f"{np.mean(inside):.3f}", seconds(other), f"{own / other:.1f} fits")
    table.notes.append(f"Noise {NOISE:g}; mean over {SEEDS} draws; the best of {RELATIVE.size} factors in the mean.")
    return table


def _few() -> Table:
    table = Table("Automatic smoothness: a map on 10 points", ("values", "CPU of a fixed fit", "automatic"))
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 1, (2, 10))
    data = {"x": x, "y": y, "wanted": 10 * np.sin(3 * x) * y}
    for count in (21, 41, 101):
        points = np.linspace(0, 1, count)
        start = kf.ParameterSet([kf.Map("M", points, points, np.zeros((count, count)))])
        fixed, own = (
            float(np.median([_timed("m = M(x, y)", data, start, target="wanted", smoothness=s)[1] for _ in range(3)]))
            for s in (1.0, "auto")
        )
        table.add(f"{count**2}", seconds(fixed), f"{own / fixed:.1f} fits")
    return table


def _recorded(folder: Path) -> Table:
    columns = ("held out", "target", "automatic", "best fixed", "rank", "CPU of a fixed fit", "automatic")
    table = Table("Automatic smoothness: recordings of an engine, one held out in turn", columns)
    recordings = {path.name.split(".")[0]: kf.read(path) for path in sorted(folder.glob("gengine1_*.csv.gz"))}
    for target in TARGETS:
        errors = []
        for held in recordings:
            outcomes = list(_outcomes(recordings, held, target))
            (_, own), *fixed = outcomes
            errors.append([error for error, _ in outcomes])
            spent = float(np.median([time for _, time in fixed]))
            table.add(held, target, *_rank(errors[-1]), seconds(spent), f"{own / spent:.1f} fits")
        table.add("mean", target, *_rank(np.mean(errors, axis=0)))
        table.add("median", target, *_rank(np.median(errors, axis=0)))
        table.notes.append(f"{target}: {_compare(np.array(errors))}")
    table.notes.append(f"{SENSOR}: RMSE on the recording held out; {FIXED.size} fixed factors of M from 0.01 to 1e5.")
    table.notes.append("The best fixed factor of a recording is known only afterwards, and is another for the next.")
    return table


def _outcomes(recordings: dict[str, kf.Dataset], held: str, target: str) -> Iterator[tuple[float, float]]:
    """Error on the recording held out and CPU time, with automatic smoothness and with each fixed factor."""
    axes = [
        np.linspace(
            min(r[c].values.min() for r in recordings.values()), max(r[c].values.max() for r in recordings.values()), 9
        )
        for c in ("speed", "load")
    ]
    lags = kf.Curve("T", np.linspace(axes[1][0], axes[1][-1], 4), np.full(4, 5.0), lower=0.05, upper=500.0)
    start = kf.ParameterSet([kf.Map("M", *axes, np.zeros((9, 9))), lags])
    fitted = [recording for name, recording in recordings.items() if name != held]
    for factor in ("auto", *FIXED):
        result, own = _timed(SENSOR, fitted, start, target=target, test=recordings[held], smoothness={"M": factor})
        yield result.quality[-1].rmse_after, own


def _compare(errors: np.ndarray) -> str:
    """Compare the automatic choice with the second best fixed factor, pairwise; Float[recordings, 1 + factors]."""
    second = 1 + int(np.argsort(errors[:, 1:].mean(axis=0))[1])
    differences = errors[:, 0] - errors[:, second]
    deviation = differences.std(ddof=1) / len(differences) ** 0.5
    return (
        f"automatic less the second best fixed factor, {FIXED[second - 1]:g}: "
        f"{differences.mean():+.4f}, standard error {deviation:.4f}."
    )


def _rank(errors: np.ndarray | list[float]) -> tuple[str, str, str]:
    automatic, *fixed = errors
    return f"{automatic:.4f}", f"{min(fixed):.4f}", f"{1 + sum(error < automatic for error in fixed)} of {len(fixed)}"
