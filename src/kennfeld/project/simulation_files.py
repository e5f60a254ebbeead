"""Files of a simulation: tables of all datasets, and recordings for the tools that show measurements."""

from pathlib import Path
from typing import TYPE_CHECKING

from kennfeld.base.atomic_files import replace_atomically
from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import join_names

if TYPE_CHECKING:
    from kennfeld.project.simulation import Simulation

TABLES = (".parquet", ".csv")
RECORDINGS = (".mf4", ".mat")
SIMULATIONS = TABLES + RECORDINGS  # extensions
REMEDY = "Name another file with -o."


def require_simulation_format(path: Path) -> None:
    """Raise `InputError` if the extension is not that of a simulation, or the package that writes it is missing."""
    ending = path.suffix.lower()
    if ending not in SIMULATIONS:
        message = f"must have the extension {', '.join(SIMULATIONS[:-1])} or {SIMULATIONS[-1]}, got {ending or 'none'}"
        raise InputError.of(Location(str(path)), message)
    if ending == ".mf4":
        from kennfeld.measurement.mdf_writer import require_library

        require_library(path)


def write_simulation(
    simulation: "Simulation", path: str | Path, *, follow: bool = False, findings: Findings | None = None
) -> Path:
    """Write a simulation in the format of the extension of `path`: .parquet, .csv, .mf4 or .mat.

    Tables have the nodes and targets of all datasets, one after the other. MDF and MATLAB files have one group or
    struct for each recording, with the inputs of the function and the errors, too.

    Args:
        simulation: the nodes and targets.
        path: the file; its folder is created.
        follow: a symbolic link stays one; otherwise it is replaced.
        findings: collects remarks on what the format cannot represent.

    Raises:
        InputError: the extension is unknown, a package is missing, or the file cannot be written.
    """
    target = Path(path)
    require_simulation_format(target)
    with convert_errors(target, "cannot be written", REMEDY):
        target.parent.mkdir(parents=True, exist_ok=True)
        with replace_atomically(target, follow=follow) as beside:
            save(simulation, beside, target, findings)
    return target


def save(simulation: "Simulation", path: Path, target: Path, findings: Findings | None = None) -> None:
    """Write a simulation into a file that becomes the target; errors as for `write_simulation`, and `OSError`."""
    ending = target.suffix.lower()
    if ending in TABLES:
        from kennfeld.project.simulation_table import write_table

        write_table(simulation, path)
        return
    from kennfeld.project.simulated_recordings import simulated_recordings

    complete = simulation.completed()
    if ending == ".mat":
        from kennfeld.measurement.matlab_writer import write_matlab

        write_matlab(simulated_recordings(complete), path, target.name)
        return
    from kennfeld.measurement.mdf_writer import write_mdf

    starts = write_mdf(simulated_recordings(complete), path, f"Simulation of {simulation.name}, written by Kennfeld")
    if findings is not None and len(starts) > 1:
        message = f"the recordings start at different times, and the file states the first: {join_names(starts, 3)}"
        remedy = "The comment of each group has its own; time stamps are unchanged."
        findings.add(Finding(Location(target.name), message, remedy, severity="remark"))
