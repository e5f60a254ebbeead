"""A Simulink model beside a recorded run of it: `python -m benchmarks.simulink_recorded MODEL RUN.csv` prints a table.

A run is what another tool made of the same model: simulated, or generated code that was run step by step. Its file has
a row a step and names its columns. Columns that are called like inputs of the model feed it; those that are called like
its outputs, or like any other node of it, are compared. Time is not read: the step is the model's own.

    --subsystem PATH        the subsystem that ran alone
    --parameters FILE ...   what gives values to variables; a .json file is one object of values by name
    --bind PATH=FORMULA     a block whose output is a column of the file, or a formula over columns
    --step SECONDS          the step, where the model leaves it to the data
"""

import argparse
import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.table import Table
from kennfeld.graph.interpreter import evaluate
from kennfeld.graph.node import CLOCK, STEPS, TIME
from kennfeld.importers.simulink.importing import simulink
from kennfeld.models.model import Model

Columns = dict[str, npt.NDArray[np.float64]]


def read(path: Path) -> Columns:
    """The columns of a file, by name."""
    with path.open(newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    values = np.array([[float(cell) for cell in row] for row in rows])
    return {name.strip(): values[:, at] for at, name in enumerate(names)}


def compute_nodes(model: Model, run: Columns, step: float | None) -> Mapping[str, npt.NDArray[np.float64]]:
    """All nodes of the model, driven by the inputs of a run."""
    missing = [name for name in model.graph.inputs if name not in (*run, *CLOCK)]
    if missing:
        raise SystemExit(f"the run has no column for the inputs {', '.join(missing)}")
    dt = model.step or step
    if dt is None:
        raise SystemExit("the model has no step of its own: say --step SECONDS")
    count = next(iter(run.values())).size
    clock = {**dict.fromkeys(STEPS, np.full(count, dt)), TIME: dt * np.arange(count)}
    return evaluate(model.graph, {name: run[name] for name in model.graph.inputs if name in run} | clock, model.values)


def relative_difference(computed_signal: npt.NDArray[np.float64], recorded: npt.NDArray[np.float64]) -> float:
    """The largest difference over the largest magnitude of the recorded signal; NaN at both is no difference."""
    apart = np.abs(computed_signal - recorded)
    apart[np.isnan(computed_signal) & np.isnan(recorded)] = 0.0
    scale = float(np.nanmax(np.abs(recorded), initial=0.0)) or 1.0
    return float("inf") if np.isnan(apart).any() else float(apart.max(initial=0.0)) / scale


def compare(model: Model, run: Columns, step: float | None) -> Table:
    """One row for each signal that both have."""
    nodes = compute_nodes(model, run, step)
    columns = ["signal", "steps", "range", "largest relative difference"]
    comparison = Table(f"{model.name} beside a recorded run", columns)
    for name, column in run.items():
        if name in nodes and name not in model.graph.inputs:
            extent = f"{column.min():.4g} to {column.max():.4g}"
            comparison.add(name, str(column.size), extent, f"{relative_difference(nodes[name].copy(), column):.2g}")
    absent = [name for name in run if name not in nodes and name not in model.graph.inputs]
    if absent:
        comparison.notes.append(f"Not in the model: {', '.join(absent)}.")
    return comparison


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("run", type=Path)
    parser.add_argument("--subsystem")
    parser.add_argument("--parameters", nargs="*", type=Path, default=[])
    parser.add_argument("--bind", nargs="*", default=[])
    parser.add_argument("--step", type=float)
    options = parser.parse_args()
    values: list[Any] = [json.loads(p.read_text("utf-8")) if p.suffix == ".json" else p for p in options.parameters]
    bind = dict(binding.split("=", 1) for binding in options.bind)
    model = simulink(options.model, options.subsystem, values, bind)
    print(compare(model, read(options.run), options.step))


if __name__ == "__main__":
    main()
