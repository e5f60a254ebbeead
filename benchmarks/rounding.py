"""Topic `rounding`: what 8 bits cost the demos, by nearest and by joint rounding, and the time for 5000 values."""

import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.table import Table
from kennfeld import Map, Options, ParameterSet, Problem, problem
from kennfeld.domain.storage import StorageGrid, StorageRounding
from kennfeld.optimize import run as calibrate
from kennfeld.optimize.limits.linear_limits import linear_limits
from kennfeld.optimize.problem.storage import rounding_of
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.rounding.outcome import RoundingResult
from kennfeld.optimize.rounding.rounded_values import rounded_values
from kennfeld.optimize.sums.compiled import CompiledProblem
from kennfeld.project import Project
from kennfeld.project.demo.writing import write

__all__ = ["run"]

# the range of a byte begins a little below the bounds of each label
STEPS: Mapping[str, Mapping[str, float]] = {
    "torque": {"MapOptTorque": 2.5, "MapOptIgnition": 0.75, "CurveEtaDeltaSpark": 1 / 128, "MapDragTorque": 1.0},
    "exhaust": {"MapSettled": 5.0, "CurveTimeConstant": 0.4},
}
OFFSETS, SIZES = (0.0, 0.2, 0.4, 0.6, 0.8), (1.0, 2.0)
NODE = {"torque": "TorquePredict", "exhaust": "TemperaturePredict"}
SIDE = (100, 50)
SAMPLES = 50_000


def run() -> list[Table]:
    """Round both demos to several storages, and a large map."""
    return [_demos(), _large()]


def _demos() -> Table:
    columns = ("demo", "storages", "use", "loss by nearest", "of it left by joint", "at most", "CPU")
    table = Table("rounding: what 8 bits cost, by nearest and by joint rounding", columns)
    for demo in STEPS:
        with TemporaryDirectory() as folder:
            task = Project.read(write(demo, Path(folder) / demo)).problem()
            fitted = replace(task, parameters=calibrate(task, Options()).parameters)
            for source in ("grid", "A2L"):
                roundings = [*_roundings(demo, source, Path(folder))]
                outcomes = [_rounded(fitted, rounding) for rounding in roundings]
                for use in ("training", "test"):
                    table.add(*_row(demo, source, use, fitted, outcomes))
    table.notes.append(
        "Loss is the RMSE by nearest rounding less that of the fit, in its unit, the median over the storages: "
        f"steps of {' and '.join(f'{size:g}' for size in SIZES)} times those of the guide, {len(OFFSETS)} offsets each."
    )
    table.notes.append("CPU is the longest time of a rounding with all errors before and after it.")
    return table


def _row(
    demo: str, source: str, use: str, fitted: Problem, outcomes: list[tuple[RoundingResult, float]]
) -> Iterator[str]:
    names = [data.name for data in fitted.datasets if data.use == use]
    (key,) = [f"{NODE[demo]}/{name}" for name in names if f"{NODE[demo]}/{name}" in outcomes[0][0].joint]
    losses = [outcome.nearest[key] - outcome.unrounded[key] for outcome, _ in outcomes]
    left = [(each.joint[key] - each.unrounded[key]) / loss for (each, _), loss in zip(outcomes, losses, strict=True)]
    yield from (demo, f"{len(outcomes)} by {source}", use, f"{np.median(losses):.3f}", f"{np.mean(left):.2f}")
    yield from (f"{max(left):.2f}", f"{max(seconds for _, seconds in outcomes):.2f} s")


def _roundings(demo: str, source: str, folder: Path) -> Iterator[StorageRounding]:
    for size in SIZES:
        for offset in OFFSETS:
            steps = {name: size * step for name, step in STEPS[demo].items()}
            grids = {name: StorageGrid(step, -offset * step, 1.0, 0.0, 255.0, 8) for name, step in steps.items()}
            if source == "grid":
                yield StorageRounding("joint", grids)
            else:
                file = folder / "ecu.a2l"
                file.write_text(_a2l(grids), encoding="ascii")
                yield rounding_of("joint", file, {}, 2.0)


def _a2l(grids: Mapping[str, StorageGrid]) -> str:
    """Return a file in which each label is a block of bytes: what follows of it is its step, offset and range."""
    lines = ["ASAP2_VERSION 1 71", '/begin PROJECT P ""', '/begin MODULE M ""']
    lines.append("/begin RECORD_LAYOUT Bytes FNC_VALUES 1 UBYTE ROW_DIR DIRECT /end RECORD_LAYOUT")
    for number, (name, grid) in enumerate(grids.items()):
        conversion = f"COEFFS_LINEAR {grid.factor!r} {grid.shift!r}"
        lines.append(f'/begin COMPU_METHOD C{number} "" LINEAR "%8.3" "" {conversion} /end COMPU_METHOD')
        place = f"0x{0x1000 * (number + 1):X} Bytes 0 C{number} {grid.range[0]!r} {grid.range[1]!r}"
        lines.append(f'/begin CHARACTERISTIC {name} "" VAL_BLK {place} NUMBER 256 /end CHARACTERISTIC')
    return "\n".join([*lines, "/end MODULE", "/end PROJECT"]) + "\n"


def _rounded(fitted: Problem, rounding: StorageRounding) -> tuple[RoundingResult, float]:
    """Return the outcome of rounding a fit, and the processor time in s."""
    task = replace(fitted, rounding=rounding)
    compiled = CompiledProblem(task)
    quality = Scorer(task).scores(task.parameters, task.parameters).quality
    limits, fit = linear_limits(task, compiled.values), compiled.start[: compiled.values.free]
    began = time.process_time()
    outcome = rounded_values(compiled, rounding, limits, fit, quality).outcome
    return outcome, time.process_time() - began


def _large() -> Table:
    random = np.random.default_rng(0)
    x, y = (np.linspace(0.0, 1.0, size) for size in SIDE)
    data = {"u": random.uniform(0, 1, SAMPLES), "v": random.uniform(0, 1, SAMPLES)}
    data["m"] = 100 * np.sin(3 * data["u"]) * data["v"] + random.normal(0, 0.3, SAMPLES)
    start = ParameterSet([Map("M", x, y, np.zeros(SIDE))])
    task = problem("y = M(u, v)", data, start, "m", smoothness=1.0)
    fitted = replace(task, parameters=calibrate(task, Options()).parameters)
    outcome, seconds = _rounded(fitted, StorageRounding("joint", {"M": StorageGrid.of_step(1.0)}))
    table = Table("rounding: one map of 100 x 50 values", ("RMSE unrounded", "nearest", "joint", "CPU"))
    (key,) = outcome.joint
    cells = (f"{outcome.unrounded[key]:.4f}", f"{outcome.nearest[key]:.4f}", f"{outcome.joint[key]:.4f}")
    table.add(*cells, f"{seconds:.2f} s")
    return table
