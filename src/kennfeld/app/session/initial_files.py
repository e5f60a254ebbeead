"""Names in the initial files of a project, also if the project cannot be read otherwise."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.project.initial_calibration import read_initial_file
from kennfeld.project.schema import read_partly


@dataclass(frozen=True)
class InitialNames:
    """Names of the parameters that initial files provide, and why others could not be read."""

    names: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


def initial_names(settings: Mapping[str, Any], path: Path) -> InitialNames:
    """Return the parameters of all initial files, images among them.

    Args:
        settings: the tables of the project file.
        path: the project file.
    """
    calibration = read_partly(path, settings).calibration
    names: dict[str, None] = {}
    findings: list[Finding] = []
    for name in calibration.files:
        description = calibration.descriptions.get(name)
        try:
            names |= dict.fromkeys(_names(path.parent / name, path.parent / description if description else None))
        except InputError as error:
            findings += error.findings
    return InitialNames(tuple(names), tuple(findings))


@while_unchanged(16)
def _names(path: Path, a2l: Path | None) -> tuple[str, ...]:
    if a2l is not None:
        note_opened(a2l)
    return tuple(read_initial_file(path, a2l)[0])


def holds_variables(path: Path) -> bool:
    """Return True for a file with arrays and no table that has axes, as scripts and workspaces of MATLAB have.

    Functions whose blocks name variables take them as axes and values of their tables; as initial values, axes would
    be parameters of their own. A file that cannot be read holds none; the project says why.
    """
    try:
        parameters, _ = read_initial_file(path, None)
    except InputError:
        return False
    kinds = {each.kind for each in parameters.parameters}
    return "block" in kinds and kinds <= {"block", "scalar"}
