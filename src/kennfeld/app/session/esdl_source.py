"""The ASCET model of a project as its files describe it, also if the project cannot be read otherwise."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.app.session.simulink_source import texts
from kennfeld.base.errors import InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.project.schema import is_esdl_file

if TYPE_CHECKING:  # for ASCET models only
    from kennfeld.importers.ascet.import_report import EsdlImport
    from kennfeld.importers.ascet.outline import ProgramOutline


@dataclass(frozen=True)
class EsdlSource:
    """A class or an application, and what the project says of its import. Values of other kinds are skipped.

    Attributes:
        folder: the folder of the project, to which the other paths are relative.
        file: the `.esdl` or `.app` file.
        class_name: the class, empty for the only one; likewise `methods` and `startup`.
        tasks: the tasks, empty for the only one.
        folders: folders with further packages.
        step: the step in s, None for that of the tasks.
    """

    folder: Path
    file: str
    class_name: str = ""
    methods: tuple[str, ...] = ()
    startup: tuple[str, ...] = ()
    tasks: tuple[str, ...] = ()
    folders: tuple[str, ...] = ()
    step: float | None = None

    @staticmethod
    def of(settings: Mapping[str, Any], folder: Path) -> "EsdlSource | None":
        """Return the model of these settings; None if the function is not an ASCET model."""
        model = settings.get("model")
        if not isinstance(model, dict) or not is_esdl_file(str(model.get("file", ""))):
            return None
        step = model.get("step")
        return EsdlSource(
            folder,
            str(model["file"]),
            str(model.get("class", "")),
            texts(model.get("methods")),
            texts(model.get("startup")),
            texts(model.get("task")),
            texts(model.get("folders")),
            float(step) if isinstance(step, int | float) and step > 0 else None,
        )

    @property
    def path(self) -> Path:
        """The path of the file."""
        return self.folder / self.file

    @property
    def root(self) -> Path:
        """The folder that contains the packages; that of the project if the file cannot be read."""
        from kennfeld.importers.ascet.method_choice import source_root

        try:
            return source_root(self.path)
        except InputError:
            return self.folder

    def outline(self) -> "ProgramOutline":
        """Return what can be chosen. Raises `InputError` if the file cannot be read."""
        from kennfeld.importers.ascet.outline import read_outline

        return read_outline(self.path)

    def imported(self, initial: ParameterSet) -> "EsdlImport":
        """Import the model; raises `InputError` if it cannot be read.

        Args:
            initial: values of characteristics, whose names the model takes over.
        """
        from kennfeld.importers.ascet.importing import import_esdl

        return import_esdl(
            self.path,
            self.class_name,
            self.methods,
            startup=self.startup or None,
            task=self.tasks,
            parameters=initial,
            folders=[self.folder / name for name in self.folders],
            step=self.step,
        )

    def labels(self, sources: Iterable[Path]) -> dict[Path, str]:
        """Return the names of files as the page shows them: relative to the folder of the project."""
        root = self.folder.resolve()
        names = {}
        for path in sources:
            full = path.resolve()
            inside = full.is_relative_to(root)
            names[path] = full.relative_to(root).as_posix() if inside else full.as_posix()
        return names
