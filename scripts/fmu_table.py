"""Compare simulations of FMUs with those of FMPy: a table of the largest differences, by interface.

python scripts/fmu_table.py FOLDER

Needs FMPy. Each FMU of the folder runs in a process of its own, with inputs that change at every sample and the step of
its default experiment. Model exchange is compared with Euler's method, co-simulation with the same communication steps.
A difference is relative to the largest value of its output.
"""

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import kennfeld as kf
from kennfeld.base.arrays import Float, Int
from kennfeld.base.errors import InputError
from kennfeld.importers.fmu.description import FmuDescription, FmuVariable
from kennfeld.importers.fmu.fmu_archive import read_archive

SAMPLES, STEP, LIMIT = 201, 0.01, 300  # number of samples, s if the FMU states no step, s that an FMU may take
INTERFACES = {"model exchange": "ModelExchange", "co-simulation": "CoSimulation"}
_HEADING = ("FMU", "FMI", "interface", "outputs", "difference")


def main(arguments: Sequence[str]) -> int:
    """Print the table, or compare one FMU; return the exit status."""
    if len(arguments) == 2:
        print(json.dumps(compare(Path(arguments[0]), arguments[1])))
        return 0
    if len(arguments) != 1:
        print(__doc__, file=sys.stderr)
        return 2
    rows = [_HEADING, *_rows(Path(arguments[0]))]
    widths = [max(len(row[i]) for row in rows) for i in range(len(_HEADING) - 1)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        print("  ".join([*cells, row[-1]]))
    return 0


def _rows(folder: Path) -> Iterator[tuple[str, ...]]:
    for path in sorted(folder.rglob("*.fmu")):
        for interface in INTERFACES:
            row = _in_own_process(path, interface)
            yield str(path.relative_to(folder)), row["version"], interface, row["outputs"], row["result"]


def _in_own_process(path: Path, interface: str) -> Mapping[str, str]:
    command = [sys.executable, __file__, str(path), interface]
    empty = {"version": "", "outputs": ""}
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False)
    except subprocess.TimeoutExpired:
        return {**empty, "result": f"takes more than {LIMIT} s"}
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        last = (done.stderr.splitlines() or [""])[-1]
        return {**empty, "result": f"ended with status {done.returncode}: {last}"}
    row: Mapping[str, str] = json.loads(lines[-1])
    return row


def compare(path: Path, interface: str) -> Mapping[str, str]:
    """Return version, number of outputs, and the largest difference or why there is none."""
    row = {"version": "", "outputs": ""}
    try:
        description = read_archive(path)
        row["version"] = description.version
        step = description.step or STEP
        model = kf.fmu(path, step=step, solver="ode1", interface=interface)
        columns = recording(description, step)
        own = kf.simulate(model, {name: columns[name] for name in ("time", *model.graph.inputs)}, {})
    except InputError as error:
        return {**row, "result": "; ".join(finding.message for finding in error.findings)}
    names = [variable.name for variable in description.number_outputs if variable.elements[0] in own]
    judged = simulate_by_fmpy(path, INTERFACES[interface], description, columns, names)
    rows = _rows_at(judged["time"], columns["time"])
    differences = {}
    for variable in (v for v in description.number_outputs if v.name in names):
        values = judged[variable.name].reshape(len(judged), -1)[rows].astype(float)
        values = np.where(rows[:, np.newaxis] >= 0, values, np.nan).T
        differences |= {
            name: difference(own[name].values, other) for name, other in zip(variable.elements, values, strict=True)
        }
    worst = max(differences, key=lambda name: np.nan_to_num(differences[name], nan=np.inf))
    return {**row, "outputs": str(len(differences)), "result": f"{differences[worst]:.1e} {worst}"}


def _rows_at(recorded: Float, time: Float) -> Int:
    """Return the last row at each time, after events; -1 where there is none, as after the end of a simulation."""
    rows = np.searchsorted(recorded, time + 1e-6 * time[1], side="right") - 1
    return np.where(np.abs(recorded[rows] - time) <= 1e-6 * time[1], rows, -1)


def recording(description: FmuDescription, step: float) -> dict[str, Float]:
    """Return time and inputs, by the names of their elements."""
    columns = {"time": np.arange(SAMPLES) * step}
    for variable in description.number_inputs:
        for name in variable.elements:
            columns[name] = _signal(variable, len(columns))
    return columns


def _signal(variable: FmuVariable, number: int) -> Float:
    n = np.arange(SAMPLES)
    if variable.type == "Boolean":
        return (n // 7 % 2).astype(float)
    if not variable.type.startswith(("Real", "Float")):
        return 1.0 + n // 11 % 2
    return np.clip(0.5 + 0.4 * np.sin(0.1 * n * (1 + 0.1 * number)), variable.minimum, variable.maximum)


def simulate_by_fmpy(
    path: Path, interface: str, description: FmuDescription, columns: Mapping[str, Float], names: Sequence[str]
) -> Any:
    """Return the outputs of FMPy as a structured array with a field for each variable."""
    import fmpy

    inputs = description.number_inputs
    fields: list[Any] = [("time", np.float64), *((v.name, _kind(v), v.shape) for v in inputs)]
    signals = np.zeros(SAMPLES, dtype=fields)
    signals["time"] = columns["time"]
    for variable in inputs:
        values = np.array([columns[name] for name in variable.elements]).T
        signals[variable.name] = values.reshape(SAMPLES, *variable.shape)
    return fmpy.simulate_fmu(
        str(path),
        validate=False,
        start_time=0.0,
        stop_time=columns["time"][-1],
        output_interval=columns["time"][1],
        step_size=columns["time"][1],
        solver="Euler",
        input=signals if inputs else None,
        output=names,
        fmi_type=interface,
    )


def _kind(variable: FmuVariable) -> Any:
    if variable.type == "Boolean":
        return np.bool_
    return np.float64 if variable.type.startswith(("Real", "Float")) else np.int64


def difference(own: Float, other: Float) -> float:
    """Return the largest difference over the largest value; infinite if other samples are finite."""
    if own.shape != other.shape or not np.array_equal(np.isfinite(own), np.isfinite(other)):
        return float("inf")
    known = np.isfinite(own)
    scale = max(float(np.max(np.abs(other[known]), initial=0.0)), 1e-300)
    return float(np.max(np.abs(own[known] - other[known]), initial=0.0)) / scale


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
