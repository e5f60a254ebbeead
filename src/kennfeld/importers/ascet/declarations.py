"""Declarations of ESDL packages: files found by package, names resolved by imports."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field
from itertools import islice
from pathlib import Path
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.lexer import MAX_CHARACTERS
from kennfeld.ascet.parser import scan_esdl
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.lazy_dataclass import dataclass

_MAX_FILES: Final = 3_000  # of a package
_MAX_FOLDERS: Final = 400  # beside the folder of a project
SUFFIX: Final = ".esdl"


@dataclass(frozen=True, eq=False)
class Declared:
    """A declaration with the file it is in."""

    declaration: e.Declaration
    scope: "FileScope"

    @property
    def name(self) -> str:
        """The name without the package."""
        return self.declaration.name

    @property
    def label(self) -> str:
        """The name with the package."""
        package = self.scope.file.package
        return f"{package}.{self.name}" if package else self.name


@dataclass(frozen=True, eq=False)
class FileScope:
    """The names that a file knows: its imports, and all of its package."""

    tree: "SourceTree"
    file: e.EsdlFile
    path: Path

    def find(self, name: str) -> Declared | None:
        """Return what a name, possibly with its package, refers to in this file; None if unknown."""
        if "." in name:
            return self.tree.find(name)
        for imported in self.file.imports:
            package, _, last = imported.rpartition(".")
            if last == name:
                return self.tree.find(imported)
            if last == "*" and (result := self.tree.package(package).get(name)) is not None:
                return result
        return self.tree.package(self.file.package, self.path.parent).get(name)

    def missing_import(self, name: str) -> str:
        """Return the package that an import names for a name and that has no file; empty if there is none."""
        for imported in self.file.imports:
            package, _, last = imported.rpartition(".")
            if (name == imported or last in (name, "*")) and not self.tree.has_package(package):
                return package
        package = name.rpartition(".")[0]
        return package if package and not self.tree.has_package(package) else ""

    def remedy_for(self, name: str) -> str:
        """Return how to make an imported name known; empty if its package is not missing, which is remembered."""
        package = self.missing_import(name)
        if not package:
            return ""
        self.tree.missing.add(package)
        return f"The package {package} is missing: add its files, or name their folder under folders."

    def location(self, place: e.TextPosition, path: str = "") -> Location:
        """Return a location in this file."""
        return Location(place.file or self.path.name, place.line, path, place.column)


@dataclass(eq=False)
class SourceTree:
    """The packages of a project, read when first needed.

    Attributes:
        root: folder that contains the packages of the project.
        folders: folders with the packages of other projects, such as the SystemLib; those beside the root are searched
            as well.
        broken: syntax errors of the files that were read.
        missing: packages that are imported and have no files.
    """

    root: Path
    folders: tuple[Path, ...] = ()
    broken: dict[Path, tuple[Finding, ...]] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)
    _packages: dict[str, Mapping[str, Declared]] = field(default_factory=dict)
    _scopes: dict[Path, FileScope] = field(default_factory=dict)

    def find(self, qualified: str) -> Declared | None:
        """Return the declaration of a name with its package."""
        package, _, name = qualified.rpartition(".")
        return self.package(package).get(name)

    def has_package(self, name: str) -> bool:
        """Return True if a package, or one within it, exists."""
        if any(known == name or known.startswith(f"{name}.") for known, names in self._packages.items() if names):
            return True
        return any(folder.is_dir() for folder in self._folders_of(name))

    def package(self, name: str, own: Path | None = None) -> Mapping[str, Declared]:
        """Return the declarations of a package by name; `own` is the folder of a file of it."""
        if name not in self._packages:
            self._packages[name] = {}  # for files that import their own package
            result: dict[str, Declared] = {}
            # a file outside its package folder, such as one copied alone, still knows the others beside it
            for folder in dict.fromkeys([*([own] if own is not None else []), *self._folders_of(name)]):
                for path in _files_in(folder):
                    scope = self.scope(path)
                    # the folder of a package may hold files of others, which the package clause decides
                    if scope.file.package == name:
                        result |= {
                            declaration.name: Declared(declaration, scope)
                            for declaration in scope.file.declarations
                            # the first folder wins: that of the own project comes before others
                            if declaration.name not in result
                        }
            self._packages[name] = result
        return self._packages[name]

    def scope(self, path: Path) -> FileScope:
        """Return the scope of a file, which is read if it was not yet; a file that cannot be read is empty."""
        if path not in self._scopes:
            try:
                parsed = scan_esdl(read_source(path), path.name)
            except InputError as error:
                self.broken[path] = error.findings
                # kept although it is empty, so that a broken file is read and reported once
                self._scopes[path] = FileScope(self, e.EsdlFile(path.name), path)
                return self._scopes[path]
            if parsed.findings:
                self.broken[path] = parsed.findings
            self._scopes[path] = FileScope(self, parsed.file, path)
        return self._scopes[path]

    def _folders_of(self, package: str) -> Iterator[Path]:
        parts = package.split(".") if package else []
        # libraries such as SystemLib are projects of their own, exported beside the one that uses them
        roots = [self.root, *self.folders, *_subfolders(self.root.parent)]
        for root in dict.fromkeys(roots):
            folder = root.joinpath(*parts)
            if folder.is_dir():
                yield folder


def read_source(path: Path) -> str:
    """Read the text of an ESDL file; raises `InputError` if it cannot be read."""
    with convert_errors(path, "cannot be read"), path.open("rb") as stream:
        raw = stream.read(4 * MAX_CHARACTERS + 1)
    if len(raw) > 4 * MAX_CHARACTERS:
        raise InputError.of(Location(path.name), "the file is too large", "Split the file.")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        # ASCET on Windows writes umlauts of comments in the code page of the system
        return raw.decode("cp1252", errors="replace")


def package_of(path: Path) -> str:
    """Read the package of an ESDL file, empty if it names none; raises `InputError` if it cannot be read."""
    return scan_esdl(read_source(path), path.name).file.package


def root_of(path: Path, package: str) -> Path:
    """Return the folder that contains the package of a file; its own folder if the names do not match."""
    parts = package.split(".") if package else []
    folder = path.parent
    for name in reversed(parts):
        if folder.name != name:
            return path.parent
        folder = folder.parent
    return folder


def _files_in(folder: Path) -> Iterable[Path]:
    """Return the ESDL files of a folder; none of one that cannot be read, or was removed meanwhile."""
    try:
        return sorted(islice((path for path in folder.iterdir() if path.suffix.lower() == SUFFIX), _MAX_FILES))
    except OSError:
        return ()


def _subfolders(folder: Path) -> Iterable[Path]:
    try:
        return sorted(islice((path for path in folder.iterdir() if path.is_dir()), _MAX_FOLDERS))
    except OSError:
        return ()
