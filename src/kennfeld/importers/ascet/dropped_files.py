"""Files of an ASCET project that are dropped onto the page: stored by package, and which of them is the function."""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.files import ARCHIVE
from kennfeld.ascet.parser import scan_esdl
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import plain_name, within
from kennfeld.files.calibrations import AMD
from kennfeld.importers.ascet.declarations import read_source
from kennfeld.importers.ascet.importer import IMPORTER
from kennfeld.importers.ascet.method_choice import APPLICATION, source_root

_COPY = re.compile(r"-\d+$")  # behind the name of a file whose name was taken
_CLASS = re.compile(r"^[^\S\n]*(?:(?:public|singleton|static|stateless)\s+)*class\s+\w", re.MULTILINE)
_MAX_DEPTH = 8  # of folders that are searched
_MAX_FILES = 20_000  # that are looked at
_WORD = re.compile(r"[A-Za-z_]\w*")


@dataclass(frozen=True)
class _DroppedFile:
    """A file with its package, the names that it declares, its classes, and the words of its text."""

    name: str
    package: str = ""
    declared: tuple[str, ...] = ()
    classes: tuple[str, ...] = ()
    words: frozenset[str] = frozenset()

    @staticmethod
    def read(folder: Path, name: str) -> "_DroppedFile":
        """Read a file; one that cannot be read has no package, nor has one of ASCET 6."""
        if name.lower().endswith(AMD.endings):
            return _DroppedFile(name)
        try:
            text = read_source(folder / name)
        except InputError:
            return _DroppedFile(name)
        # cheaper than resolving names, and enough to tell which class no other one uses
        words = frozenset(_WORD.findall(text))
        if name.lower().endswith(APPLICATION):
            return _DroppedFile(name, words=words)
        file = scan_esdl(text, name).file
        declared = tuple(item.name for item in file.declarations)
        classes = tuple(item.name for item in file.declarations if isinstance(item, e.ClassDeclaration))
        return _DroppedFile(name, file.package, declared, classes, words)

    @property
    def own_name(self) -> str:
        """The name of the file without the number that was added because the name was taken."""
        path = Path(self.name)
        # `Plant-2.esdl` may be its own name, unless the file declares `Plant`
        stem = _COPY.sub("", path.stem)
        return f"{stem}{path.suffix}" if stem in self.declared else path.name


def program_files(folder: Path) -> Iterator[str]:
    """Yield the applications, archives and files with classes within a folder; hidden folders are skipped."""
    seen = 0
    for place, folders, names in os.walk(folder):
        depth = len(Path(place).relative_to(folder).parts)
        folders[:] = sorted(name for name in folders if not name.startswith(".")) if depth < _MAX_DEPTH else []
        for name in sorted(names):
            seen += 1
            if seen > _MAX_FILES:
                return
            path = Path(place) / name
            if name.lower().endswith(IMPORTER.endings) and (
                name.lower().endswith((APPLICATION, ARCHIVE)) or _has_class(path)
            ):
                yield path.relative_to(folder).as_posix()


def _has_class(path: Path) -> bool:
    try:
        return _CLASS.search(read_source(path)) is not None
    except InputError:
        return False


def place_by_package(folder: Path, present: Path | None, names: Iterable[str]) -> list[str]:
    """Move dropped files into the folders of their packages; return their new names.

    Args:
        folder: the folder of the project, in which they are.
        present: the file of the present function, whose packages they add to; None if it is something else.
        names: names of the files.

    Raises:
        InputError: a file of the same name and another content exists in its package.
    """
    root = folder if present is None else _package_root(present, folder)
    base = folder / root.resolve().relative_to(folder.resolve()) if _is_inside(root, folder) else folder
    findings: list[Finding] = []
    result = []
    for name in names:
        file = _DroppedFile.read(folder, name)
        parts = [plain_name(part) for part in file.package.split(".")] if file.package else []
        place = base.joinpath(*parts, plain_name(file.own_name)) if parts else folder / name
        with convert_errors(
            place.name, "cannot be written", "Name a file in the folder of the project, without links."
        ):
            target = within(folder, place.relative_to(folder))
        label = target.resolve().relative_to(folder.resolve()).as_posix()
        # the file of another project, or an older copy: none is overwritten
        if target != folder / name and not _moved(folder / name, target):
            message = "exists with another content, which was kept"
            findings.append(Finding(Location(label), message, "Remove it first, or begin a new project."))
        result.append(label)
    if findings:
        raise InputError(findings)
    return result


def _package_root(present: Path, folder: Path) -> Path:
    """Return the folder that contains the packages; that of the project if the file cannot be read."""
    try:
        return source_root(present)
    except InputError:
        return folder


def _is_inside(root: Path, folder: Path) -> bool:
    return root.resolve().is_relative_to(folder.resolve())


def _moved(path: Path, target: Path) -> bool:
    """Move a file unless its target has another content; a file that is there already is removed."""
    if target.exists():
        same = target.read_bytes() == path.read_bytes()
        path.unlink()
        return same
    target.parent.mkdir(parents=True, exist_ok=True)
    path.replace(target)
    return True


def main_program(folder: Path, names: Sequence[str]) -> str:
    """Return which file is the function: an application or archive, else the class that no other file uses, or none."""
    files = [_DroppedFile.read(folder, name) for name in names]
    if applications := [file.name for file in files if file.name.lower().endswith((APPLICATION, ARCHIVE))]:
        return applications[0]
    candidates = [file for file in files if file.classes]
    unused = [
        file
        for file in candidates
        if not any(set(file.classes) & other.words for other in candidates if other is not file)
    ]
    return next((file.name for file in (*unused, *candidates)), "")
