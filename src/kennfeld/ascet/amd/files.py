"""The `.amd` files of an archive (`.axl`) or of a folder, read when first needed.

A component `/Lib/Filter/DT1` has several files: `Lib/Filter/DT1.main.amd` declares it, `DT1.data.amd` has its values,
`DT1.implementation.amd` its ranges and `DT1.specification.amd` its diagrams. Those of its default project, such as
`DT1.data.dp.amd`, declare what it imports.
"""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import field
from io import BytesIO
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Final

from kennfeld.ascet.amd.xml_document import MAX_BYTES, parse_amd
from kennfeld.base.archives import ZIP_ERRORS, find_oversized
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import reason_of
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement

ARCHIVE: Final = ".axl"
ENDING: Final = ".amd"
MAIN: Final = ".main.amd"
DATA: Final = ".data.amd"
IMPLEMENTATION: Final = ".implementation.amd"
SPECIFICATION: Final = ".specification.amd"
_PARTS: Final = (MAIN, DATA, IMPLEMENTATION, SPECIFICATION)
_MAX_MEMBERS: Final = 20_000
_MAX_TOTAL: Final = 500_000_000  # bytes of an archive, unpacked
_UNPACKING: Final = (*ZIP_ERRORS, OSError)


@dataclass(eq=False)
class AmdFiles:
    """The `.amd` files by their paths within the archive or folder.

    Attributes:
        name: name of the archive or folder in messages.
        paths: the paths, with `/`.
    """

    name: str
    paths: tuple[str, ...]
    _folder: Path | None = None
    _archive: bytes = b""
    _roots: dict[str, XmlElement] = field(default_factory=dict)
    _names: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        self._names = frozenset(self.paths)

    def __contains__(self, path: str) -> bool:
        return path in self._names

    def components(self) -> Iterator[str]:
        """Yield the path of each component without the ending of its files, such as `Lib/Filter/DT1`."""
        return (path.removesuffix(MAIN) for path in self.paths if path.endswith(MAIN))

    def read(self, path: str) -> bytes:
        """Return a file; raises `InputError` if it cannot be read."""
        if self._folder is not None:
            with convert_errors(self._folder / path, "cannot be read"), (self._folder / path).open("rb") as stream:
                return stream.read(MAX_BYTES + 1)
        with (
            _unpacking(self.name, path),
            zipfile.ZipFile(BytesIO(self._archive)) as archive,
            archive.open(path) as file,
        ):
            return file.read(MAX_BYTES + 1)

    def root(self, path: str) -> XmlElement:
        """Return the root of the XML of a file; raises `InputError` if it cannot be read or parsed."""
        if path not in self._roots:
            self._roots[path] = parse_amd(self.read(path), file_name(path))
        return self._roots[path]

    def optional_root(self, path: str) -> XmlElement | None:
        """Return the root of a file; None if there is no such file."""
        return self.root(path) if path in self._names else None


@contextmanager
def _unpacking(name: str, member: str) -> Iterator[None]:
    try:
        yield
    except _UNPACKING as error:
        message = f"cannot be unpacked: {reason_of(error)}"
        raise InputError.of(Location(name, path=member), message, "Use a complete copy of the file.") from None


def file_name(path: str) -> str:
    """Return the last part of a path."""
    return path.rpartition("/")[2]


def open_archive(raw: bytes, name: str) -> AmdFiles:
    """Return the files of an archive; raises `InputError` if it is damaged or expands to far more than its size."""
    try:
        with zipfile.ZipFile(BytesIO(raw)) as archive:
            members = archive.infolist()
            # tested before anything is unpacked
            reason = _oversized(archive, members)
    except _UNPACKING as error:
        remedy = "Use a complete copy of the file."
        raise InputError.of(Location(name), f"is not a readable archive: {reason_of(error)}", remedy) from None
    if reason:
        raise InputError.of(Location(name), f"is refused: {reason}", "Export fewer components.")
    names = [member.filename for member in members if member.filename.lower().endswith(ENDING)]
    return AmdFiles(name, tuple(names), _archive=raw)


def _oversized(archive: zipfile.ZipFile, members: list[zipfile.ZipInfo]) -> str:
    """Return why an archive is too large; empty if it is not."""
    if len(members) > _MAX_MEMBERS:
        return f"it has {len(members)} members; the maximum is {_MAX_MEMBERS}"
    names = {member.filename for member in members}
    if len(names) < len(members):
        return "it has two members of one name"
    total = sum(member.file_size for member in members)
    if total > _MAX_TOTAL:
        return f"its members have {total / 1e6:.0f} MB; the maximum is {_MAX_TOTAL / 1e6:.0f} MB"
    return find_oversized(archive)


def open_folder(path: Path) -> tuple[AmdFiles, str]:
    """Return the files beside an `.amd` file, from the folder that its name space begins in, and its component.

    Raises:
        InputError: the file cannot be read, or has no `.main.amd` beside it.
    """
    stem = component_stem(path.name)
    main = path.with_name(stem + MAIN)
    if not main.is_file():
        message = f"{main.name} is missing, which declares the component"
        raise InputError.of(Location(path.name), message, "Keep all .amd files of a component together.")
    with convert_errors(main, "cannot be read"), main.open("rb") as stream:
        root = parse_amd(stream.read(MAX_BYTES + 1), main.name)
    first = next((child for child in root.children if "nameSpace" in child.attributes), None)
    folder = _root_of(path.parent, first.get("nameSpace") if first is not None else "")
    own = folder == path.parent
    files = path.parent.glob(f"*{ENDING}") if own else folder.rglob(f"*{ENDING}")
    with convert_errors(folder, "cannot be read"):
        names = sorted(item.relative_to(folder).as_posix() for item in islice(files, _MAX_MEMBERS))
    return AmdFiles(folder.name, tuple(names), folder), main.relative_to(folder).as_posix().removesuffix(MAIN)


def _root_of(folder: Path, name_space: str) -> Path:
    """Return the folder that a name space begins in; the folder itself if the names do not match."""
    around = folder
    for name in reversed([part for part in name_space.split("/") if part]):
        if around.name != name:
            return folder
        around = around.parent
    return around


def component_stem(name: str) -> str:
    """Return the name of the component of a file.

    >>> component_stem("DT1.specification.amd"), component_stem("DT1.data.dp.amd"), component_stem("DT1.amd")
    ('DT1', 'DT1', 'DT1')
    """
    stem = PurePosixPath(name).name.removesuffix(ENDING).removesuffix(".dp")
    for part in _PARTS:
        stem = stem.removesuffix(part.removesuffix(ENDING))
    return stem.partition(".project")[0] if ".project" in stem else stem
