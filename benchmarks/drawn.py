"""Topic `simulink`: the torque demo as formula text and as blocks, whole processes."""

import sys
import tempfile
from pathlib import Path
from types import ModuleType

from benchmarks.machine import load
from benchmarks.processes import run_command, time_commands
from benchmarks.table import Table

__all__ = ["run"]

REPEATS = 9
AXES = {table: (f"{table}_n", f"{table}_q") for table in ("MapOptTorque", "MapOptIgnition", "MapDragTorque")}


def run() -> list[Table]:
    """`kennfeld calibrate` on the same data, start and settings; the function alone differs."""
    table = Table("simulink: the torque demo as formula and as blocks", ("function", "best", "median", "threads"))
    with tempfile.TemporaryDirectory() as folder:
        projects = {"torque.kf": _demo(Path(folder) / "formula")}
        for layout in ("slx parts", "slx inline", "mdl"):
            project = _demo(Path(folder) / layout.replace(" ", "-"))
            projects[f"torque{_drawn(project, layout)} ({layout})"] = project
        commands = {name: [str(_command()), "calibrate", str(project)] for name, project in projects.items()}
        for name, command in commands.items():
            if problem := run_command(command):
                raise RuntimeError(problem)
            time_commands(table, name, [command] * REPEATS)
    table.notes = [
        "Budget: a drawn function takes at most 1.2 times as long as the same formula. All end at the same values.",
        f"The shortest and the median of {REPEATS} runs from a warm disk, reports included. Load at the end {load()}.",
    ]
    return [table]


def _command() -> Path:
    return Path(sys.executable).with_name("kennfeld" + Path(sys.executable).suffix)


def _demo(folder: Path) -> Path:
    if problem := run_command([str(_command()), "demo", "torque", "--dir", str(folder)]):
        raise RuntimeError(problem)
    return folder / "load-only.toml"


def _drawn(project: Path, layout: str) -> str:
    """Put the drawn function in the place of the formula; the ending of its file."""
    file = _drawing().torque(AXES).write(project.parent, layout)
    (project.parent / "axes.m").write_text(_axes(project.parent / "start.dcm"), encoding="utf-8")
    text = project.read_text(encoding="utf-8")
    project.write_text(text.replace('"torque.kf"', f'"{file.name}"\nparameters = "axes.m"', 1), encoding="utf-8")
    return str(file.suffix)


def _drawing() -> ModuleType:
    """The drawing stands with the tests, which check that it gives the formula's answer."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from tests.importers.simulink import torque_drawing

    return torque_drawing


def _axes(start: Path) -> str:
    """The breakpoints of the start as a script."""
    from kennfeld.calfiles import read

    values, names = read(start), {**AXES, "CurveEtaDeltaSpark": ("d",)}
    return "\n".join(
        f"{name} = {axis.breakpoints.tolist()};"
        for table, axes in names.items()
        for name, axis in zip(axes, values[table].axes, strict=True)
    )
