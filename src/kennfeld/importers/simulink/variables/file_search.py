"""Search for the files of a model's variables: dictionaries, enumerations, scripts and data files that these load."""

import re
from collections.abc import Callable
from dataclasses import field
from pathlib import Path

from kennfeld.base.file_errors import convert_errors
from kennfeld.base.file_state import note_opened
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import file_name
from kennfeld.importers.simulink.variables.data_dictionary import Dictionary, read_dictionary
from kennfeld.importers.simulink.variables.enumerations import enumeration_files
from kennfeld.importers.simulink.variables.mask_scope import Variable

_PART = re.compile(r"[\w. -]{1,128}\Z")  # of the path of a file


@dataclass(frozen=True)
class FileSearch:
    """Searches the files of a model in its own folder and in `folders`; `given` are files of the user.

    Each dictionary and each folder is read once, since referenced models share them.
    """

    folders: tuple[Path, ...] = ()
    given: tuple[Path, ...] = ()
    _dictionaries: dict[Path, Dictionary] = field(default_factory=dict, repr=False)
    _enumerations: dict[Path, dict[str, Variable]] = field(default_factory=dict, repr=False)

    @property
    def given_names(self) -> frozenset[str]:
        """Names of the user's files, which need not be found elsewhere."""
        return frozenset(path.name for path in self.given)

    def dictionary(self, path: Path) -> Dictionary:
        """Read a data dictionary with those it refers to, once."""
        return read_dictionary(
            path, folders=self.folders, given=self.given_names - {path.name}, known=self._dictionaries
        )

    def enumerations(self, folder: Path) -> dict[str, Variable]:
        """Read the enumerations whose class files are given, in a folder or in the further ones, in this order."""
        enumerations = enumeration_files((), [path for path in self.given if path.suffix == ".m"])
        for place in (folder, *self.folders):
            if place not in self._enumerations:
                self._enumerations[place] = enumeration_files([place])
            # earlier places take precedence
            enumerations = {**self._enumerations[place], **enumerations}
        return enumerations

    def loader(self, *folders: Path) -> Callable[[str], bytes | None]:
        """Return the function that loads files for scripts in the first of some folders, None for what is not found."""

        def load(name: str) -> bytes | None:
            path = self.find(name, *folders)
            return None if path is None else read_file(path)

        return load

    def find(self, name: str, *folders: Path) -> Path | None:
        """Find a file that a script loads or runs.

        As written, it is searched in `folders` and in the further ones. Without the folders in its name, which may be
        those of another machine, it is searched among the files of the user and in the further folders.
        """
        plain = file_name(name)
        paths = [folder.joinpath(*parts) for folder in (*folders, *self.folders) if (parts := _parts(name))]
        paths += [path for path in self.given if path.name == plain]
        paths += [folder / plain for folder in self.folders if _parts(plain)]
        for path in paths:
            note_opened(path)
        return next((path for path in paths if path.is_file()), None)


def _parts(name: str) -> list[str]:
    """Return the parts of a path below a folder; empty if it leads out of the folder, to any file of the machine."""
    parts = name.replace("\\", "/").removeprefix("./").split("/")
    return parts if all(_PART.match(part) and part.strip(".") for part in parts) else []


def read_file(path: Path) -> bytes:
    """Read the content of a file; raise `InputError` if it cannot be read."""
    with convert_errors(path, "the file cannot be read", missing="file not found", advice="Check the path."):
        return path.read_bytes()
