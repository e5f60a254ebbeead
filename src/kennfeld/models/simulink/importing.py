"""From a Simulink file to a model."""

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from kennfeld.errors import Finding, InputError
from kennfeld.models.model import Model
from kennfeld.models.simulink.opening import Opened
from kennfeld.models.simulink.promoting import misnamed
from kennfeld.models.simulink.variables.variables import Given
from kennfeld.models.simulink.work import Imported, Work

__all__ = ["Imported", "import_simulink", "simulink"]


def simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[Given] = (),
    bind: Mapping[str, str] | None = None,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> Model:
    """The model in a Simulink file, or in one of its subsystems.

    `parameters` are files (.sldd, .mat, .m, calibration files), parameter sets or mappings that give values to the
    variables of the model; later ones win. `bind` replaces blocks by a channel or a formula over channels, by the path
    of the block, with ":2" for its second output alone. `promote` names fields of blocks whose literals become
    parameters, "Torque/Gain1:Gain"; a value given under such a name goes over the literal. Libraries are looked for
    beside the file and in `folders`. `step` in s takes the place of the model's own step.
    Raises `InputError` with every finding where an output cannot be built.
    """
    found = import_simulink(path, subsystem, parameters, bind, promote, folders, step)
    if found.model is None:
        name = Path(path).name
        raise InputError([Finding(f"{name} {one.place}", one.what, one.mend) for one in found.report.findings])
    return found.model


def import_simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[Given] = (),
    bind: Mapping[str, str] | None = None,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> Imported:
    """As `simulink`, with a report of what became of every block, also where the model is not whole."""
    opened = Opened.of(path, parameters, folders)
    system, scope, prefix = opened.system(subsystem)
    cuts = opened.cuts(bind or {}, prefix)
    work = Work(opened, system, scope, cuts, frozenset(promote), step)
    if wrong := misnamed(opened.path, promote, system, work.flat, prefix):
        raise InputError(wrong)
    return work.imported()
