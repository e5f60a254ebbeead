"""The Simulink model of a project as its file describes it, also if the project cannot be read otherwise."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.project.schema import is_simulink_file

if TYPE_CHECKING:  # half a second, for Simulink models only
    from kennfeld.importers.simulink.diagram import Diagram
    from kennfeld.importers.simulink.import_report import ImportableSubsystem


@dataclass(frozen=True)
class SimulinkSource:
    """A model file, and what the project says of its import. Values that are not of the expected kind are skipped.

    Attributes:
        folder: the folder of the project, to which the other paths are relative.
        file: the model file.
        subsystem: the part that is imported, empty for all.
        parameters: files with values of variables, those of `[calibration] initial` last.
        folders: folders of libraries.
        bind: block paths with the formulas in their place.
        scalars: values of the project by name; a name with a colon promotes the field of a block.
        step: the step in s, None for that of the model.
    """

    folder: Path
    file: str
    subsystem: str = ""
    parameters: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    bind: tuple[tuple[str, str], ...] = ()
    scalars: tuple[tuple[str, float | None], ...] = ()
    step: float | None = None

    @staticmethod
    def of(settings: Mapping[str, Any], folder: Path) -> "SimulinkSource | None":
        """Return the model of these settings; None if the function is not a Simulink model."""
        model = settings.get("model")
        if not isinstance(model, dict) or not is_simulink_file(str(model.get("file", ""))):
            return None
        calibration, step = settings.get("calibration"), model.get("step")
        initial = texts(calibration.get("initial")) if isinstance(calibration, dict) else ()
        return SimulinkSource(
            folder,
            str(model["file"]),
            str(model.get("subsystem", "")),
            (*texts(model.get("parameters")), *initial),
            texts(model.get("folders")),
            tuple((str(path), str(text)) for path, text in _table(model, "bind").items()),
            tuple(_scalars(_table(settings, "parameters"))),
            float(step) if isinstance(step, int | float) else None,
        )

    def diagram(self) -> "Diagram":
        """Import the model. Raises `InputError` if it cannot be read; files that have not changed are read once."""
        return _diagram(self)

    def parts(self) -> "Sequence[ImportableSubsystem]":
        """Return the subsystems that can be imported by themselves. Raises `InputError` if it cannot be read."""
        return _parts(self)

    def note_opened(self) -> None:
        """Let what is imported depend on all files of the folders in which libraries and variables are searched."""
        for folder in (self.folder, *(self.folder / name for name in self.folders)):
            note_opened(folder)


def texts(value: Any) -> tuple[str, ...]:
    """Return a text, or the texts of a list, as a tuple.

    >>> texts("init.m"), texts(["a.m", {"hex": "ecu.hex"}]), texts(None)
    (('init.m',), ('a.m',), ())
    """
    values = value if isinstance(value, list) else [value]
    return tuple(each for each in values if isinstance(each, str))


def _table(settings: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    table = settings.get(name)
    return table if isinstance(table, dict) else {}


def _scalars(sections: Mapping[str, Any]) -> Iterator[tuple[str, float | None]]:
    for name, section in sections.items():
        value = section.get("initial") if isinstance(section, dict) else None
        number = float(value) if isinstance(value, int | float) and not any(axis in section for axis in "xyz") else None
        if number is not None or ":" in name:
            yield name, number


@while_unchanged(4)
def _diagram(source: SimulinkSource) -> "Diagram":
    from kennfeld.importers.simulink.diagram import read_diagram

    source.note_opened()
    scalars = {name: value for name, value in source.scalars if value is not None}
    return read_diagram(
        source.folder / source.file,
        source.subsystem or None,
        [*(source.folder / name for name in source.parameters), scalars],
        dict(source.bind),
        [name for name, _ in source.scalars if ":" in name],
        [source.folder / name for name in source.folders],
        source.step,
    )


@while_unchanged(4)
def _parts(source: SimulinkSource) -> "Sequence[ImportableSubsystem]":
    from kennfeld.importers.simulink.importable_subsystems import find_subsystems

    source.note_opened()
    files = [source.folder / name for name in source.parameters]
    return find_subsystems(source.folder / source.file, files, [source.folder / name for name in source.folders])
