"""The files around a model: those of its folder, of its project and of further folders."""

import os
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path

from kennfeld.base.file_state import note_opened
from kennfeld.base.lazy_dataclass import dataclass

# folders and files that only the top folder of a project contains
_ROOT_FOLDERS = frozenset({".git", ".svn", ".SimulinkProject"})
_ROOT_FILES = frozenset({"kennfeld.toml"})
_PROJECT_ENDING = ".prj"  # of a MATLAB project
_GENERATED = ("_rtw", "slprj", "codegen", "node_modules")  # ends of the names of folders with generated files
_MAX_LEVELS = 10  # above and below the folder of a model
_MAX_ENTRIES = 20_000  # of folders


@dataclass(frozen=True)
class ProjectFiles:
    """Absolute paths of files around a folder; links, hidden and generated folders are not followed."""

    folder: Path
    paths: tuple[Path, ...] = ()

    @staticmethod
    def around(model: Path, folders: Iterable[Path] = ()) -> "ProjectFiles":
        """List the files of a model's folder, of further folders, and of the project around it, each with subfolders.

        The project is the nearest folder above the model with a repository, a MATLAB project or a project file of
        Kennfeld; without one, nothing above the model's folder is listed.
        """
        budget = iter(range(_MAX_ENTRIES))
        roots = (model.parent, *folders, _project_folder(model.parent.absolute()))
        # folders may contain each other
        paths = dict.fromkeys(path for root in roots for path in _below(root.absolute(), budget))
        return ProjectFiles(model.parent.absolute(), tuple(paths))

    def named(self, names: Iterable[str]) -> list[Path]:
        """Return the files with one of several names, the nearest first."""
        wanted = set(names)
        return self._nearest(path for path in self.paths if path.name in wanted)

    def ending(self, *endings: str) -> list[Path]:
        """Return the files with one of several extensions, the nearest first."""
        return self._nearest(path for path in self.paths if path.suffix.casefold() in endings)

    def _nearest(self, paths: Iterable[Path]) -> list[Path]:
        return sorted(paths, key=lambda path: len(Path(os.path.relpath(path, self.folder)).parts))


def _project_folder(folder: Path) -> Path:
    """Return the top folder of the project that contains an absolute folder, or the folder itself if there is none."""
    home = _home()
    for place in (folder, *folder.parents[:_MAX_LEVELS]):
        if place in (home, place.parent):  # of all projects of a user, or of the machine
            break
        if _is_project(place):
            return place
    return folder


def _home() -> Path | None:
    try:
        return Path.home()
    except RuntimeError:  # unknown
        return None


def _is_project(folder: Path) -> bool:
    entries = _entries(folder)
    names = {entry.name for entry in entries}
    return (
        not names.isdisjoint(_ROOT_FOLDERS | _ROOT_FILES)
        or any(name.endswith(_PROJECT_ENDING) for name in names)
        or (folder / "resources" / "project").is_dir()
    )


def _below(root: Path, budget: Iterator[int]) -> Iterator[Path]:
    """Yield the files of a folder and of those below it, level by level, as long as the budget of entries lasts."""
    note_opened(root)
    waiting = deque([(root, 0)])
    while waiting:
        folder, level = waiting.popleft()
        for entry in _entries(folder):
            if next(budget, None) is None:
                return
            if entry.is_file(follow_symlinks=False):
                yield folder / entry.name
            elif level < _MAX_LEVELS and entry.is_dir(follow_symlinks=False) and _is_source(entry.name):
                waiting.append((folder / entry.name, level + 1))


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    """Return the entries of a folder by name; none if it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            return sorted(entries, key=lambda entry: entry.name)
    except OSError:
        return []


def _is_source(name: str) -> bool:
    return not name.startswith(".") and not name.endswith(_GENERATED)
