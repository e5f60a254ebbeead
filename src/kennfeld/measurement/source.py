"""A recording on disk, as readers open it."""

from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, TypeVar

from kennfeld.base.errors import Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.file_format import FileFormat, MeasurementReader, Role
from kennfeld.files.head import FileHead, guarded, open_unpacked, read_head
from kennfeld.files.identification import identify_head, split_address
from kennfeld.measurement.bus_databases import DatabaseFile

_T = TypeVar("_T")  # Python 3.11
_HEAD = 4096  # bytes
_GZIP = "gzip"


@dataclass(frozen=True)
class MeasurementFile:
    """A file on disk, its format, the requested sheet, and the databases that decode it if it is a bus log."""

    path: Path
    format: FileFormat
    packed: bool = False  # by gzip
    sheet: str | None = None
    label: str = ""  # of a file that was unpacked
    packed_size: int | None = None  # of a file that was unpacked: bytes of the compressed file
    databases: tuple[DatabaseFile, ...] = ()

    @property
    def name(self) -> str:
        """The file's name, as messages give it."""
        return self.label or self.path.name

    @property
    def location(self) -> Location:
        """The file as a location of findings."""
        return Location(self.name)

    @property
    def stem(self) -> str:
        """The name without endings: that of the dataset."""
        return Path(self.path.stem).stem if self.packed and self.path.suffix == ".gz" else self.path.stem

    @property
    def reader(self) -> MeasurementReader:
        """The functions that read the file; none for a file that is not a recording."""
        return self.format.recording or MeasurementReader()

    @property
    def size(self) -> int:
        """Bytes of content; for a compressed file, the size in its last four bytes."""
        if not self.packed:
            return self.path.stat().st_size
        with self.path.open("rb") as file:
            file.seek(-4, 2)
            return int.from_bytes(file.read(4), "little")

    def stored_size(self, *companions: Path) -> int:
        """Return the bytes of the file as the user has it, and of files beside it: what memory is measured by."""
        if self.packed_size is not None:
            return self.packed_size
        return sum(path.stat().st_size for path in (self.path, *companions) if path.is_file())

    def open(self) -> BinaryIO:
        """Return the content, unpacked."""
        return open_unpacked(self.path, _GZIP if self.packed else "")

    def start(self, size: int = _HEAD) -> bytes:
        """Return the first bytes of the content."""
        with self.open() as stream:
            return stream.read(size)


def locate(path: str | Path, sheet: str | None = None) -> MeasurementFile:
    """Return the file at `path`; raise `InputError` if there is none.

    A `#` may follow, and the name of a sheet or of a member of an archive.

    >>> locate("missing/bench.csv")
    Traceback (most recent call last):
    kennfeld.InputError: missing/bench.csv: there is no such file. Check the path: the folder does not exist.
    """
    return locate_head(path, sheet)[0]


def locate_head(path: str | Path, sheet: str | None = None) -> tuple[MeasurementFile, FileHead]:
    """Return the file at `path` and its head."""
    file, named = (Path(path), sheet) if sheet is not None else split_address(path)
    head = read_head(file)
    known = identify_head(head, Role.RECORDING).format
    return MeasurementFile(file, known, head.packing == _GZIP, named or None), head


def run_guarded(name: str, work: Callable[[], _T]) -> _T:
    """Run `work` on a file; errors of the system or of decompression become an `InputError`."""
    with guarded(name):
        return work()
