"""Kinds of files, recognised by their content, never by their name."""

import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import BinaryIO, TypeVar

from kennfeld.errors import InputError, Location
from kennfeld.file_errors import nearest_file
from kennfeld.foreign_content import identify_foreign, identify_package
from kennfeld.lazy_dataclass import dataclass
from kennfeld.measurement.bus_databases import DatabaseFile
from kennfeld.measurement.can_csv_columns import recognises_can_csv

_T = TypeVar("_T")
_HEAD = 4096  # bytes
_PACKAGE = 100_000_000  # bytes of an OLE package that are searched for its directory


class FileKind(Enum):
    """A kind of file; the value is its name in messages."""

    CSV = "CSV"
    EXCEL = "Excel"
    PARQUET = "Parquet"
    FEATHER = "Feather"
    TDMS = "TDMS"
    NETCDF = "netCDF"
    DIADEM = "DIAdem"
    TDM = "TDM"
    MDF = "MDF"
    MLG = "MLG"
    MSL = "MSL"
    HPTUNERS = "HP Tuners"
    LVM = "LabVIEW"
    ASC = "Vector ASC"
    BLF = "Vector BLF"
    TRC = "PEAK TRC"
    CANDUMP = "candump"
    CAN_CSV = "CAN CSV"
    VBO = "VBOX"
    HALTECH = "Haltech"
    MOTEC = "MoTeC"
    FAMOS = "FAMOS"
    MATLAB = "MATLAB data"
    HDF5 = "HDF5"
    MODEL = "Simulink model"
    FMU = "FMU"
    DCM = "DCM calibration"
    CVX = "CVX calibration"
    A2L = "A2L"
    XML = "XML"
    HTML = "HTML"
    JSON = "JSON"
    PDF = "PDF"
    ZIP = "ZIP archive"
    PACKED = "packed"
    OTHER = "binary"


_MAGIC = (
    (b"PAR1", FileKind.PARQUET),
    (b"ARROW1", FileKind.FEATHER),
    (b"\xff\xff\xff\xff", FileKind.FEATHER),  # a stream of Arrow
    (b"TDSm", FileKind.TDMS),
    (b"CDF\x01", FileKind.NETCDF),
    (b"CDF\x02", FileKind.NETCDF),
    (b"MDF     ", FileKind.MDF),
    (b"UnFinMF", FileKind.MDF),
    (b"MLVLG", FileKind.MLG),
    (b"LOGG", FileKind.BLF),
    (b"|CF,1,", FileKind.FAMOS),
    (b"|CF,2,", FileKind.FAMOS),
    (b"MATLAB 5.0 MAT-file", FileKind.MATLAB),
    (b"MATLAB 7.", FileKind.MATLAB),
    (b"\x89HDF\r\n", FileKind.HDF5),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", FileKind.EXCEL),
    (b"%PDF", FileKind.PDF),
    (b"\x28\xb5\x2f\xfd", FileKind.PACKED),
    (b"BZh", FileKind.PACKED),
    (b"\xfd7zXZ", FileKind.PACKED),
    (b"7z\xbc\xaf", FileKind.PACKED),
    (b"\xff\xfe", FileKind.CSV),  # UTF-16
    (b"\xfe\xff", FileKind.CSV),
)
_WORDS = (
    (b"<?xml", FileKind.XML),
    (b"<!doctype html", FileKind.HTML),
    (b"<html", FileKind.HTML),
    (b"calibration values v", FileKind.CVX),
    (b"asap2_version", FileKind.A2L),
    (b"konservierung_format", FileKind.DCM),
    (b"hp tuners csv log file", FileKind.HPTUNERS),
    (b"labview measurement", FileKind.LVM),
    (b"%datalog%", FileKind.HALTECH),
    (b"{", FileKind.JSON),
)
_WITHOUT_SIGNATURE = {FileKind.CSV, FileKind.XML, FileKind.OTHER}

_UNPACK = "Unpack it first; gzip, bzip2, xz and ZIP can be read."
_RECORDING = "Name the recording of the decoded signals instead, as MDF or CSV."
_ANYWHERE = re.IGNORECASE | re.MULTILINE
_EXPORT = "Export the measurement as MDF, CSV or MATLAB."
_DATABASE = "a database of bus messages: it describes signals and holds no samples of them"
ASC_HEADER = re.compile(
    rb"^base[ \t]+(?P<base>hex|dec)(?:[ \t]+timestamps[ \t]+(?P<stamps>absolute|relative)|[ \t]*$)", _ANYWHERE
)
# text logs of bus messages: a pattern within their first bytes
_BUS_LOGS = (
    (ASC_HEADER, FileKind.ASC),
    (re.compile(rb"\A(?:\s*;.*\n)*\s*;\$FILEVERSION=|\A;#{20,}\s*$", _ANYWHERE), FileKind.TRC),
    (re.compile(rb"\A\s*\(\d+\.\d+\)\s+\S+\s+[\da-f]{3,8}#", _ANYWHERE), FileKind.CANDUMP),
)
# related files that are not measurements: a pattern within their first bytes, what they are, and the remedy
_FOREIGN = (
    (
        rb"\A\s*VERSION\s+\"|^[ \t]*(?:NS_\s*:|BU_\s*:|BO_\s+\d+\s)",
        f"a CAN database (DBC), {_DATABASE}",
        "Name a bus log and the database that decodes it: `kennfeld info drive.mf4 --dbc engine.dbc`.",
    ),
    (rb"\A\s*(?:/\*.*?\*/\s*)?LIN_description_file\s*;", f"a LIN database (LDF), {_DATABASE}", _RECORDING),
    (
        rb"\A(?:<\?xml[^>]*>)?\s*(?:<!--.*?-->\s*)?<AUTOSAR",
        f"an AUTOSAR description (ARXML), {_DATABASE}",
        _RECORDING,
    ),
    (
        rb"\A(?:\s|/\*(?:[^*]|\*(?!/))*\*/)*/begin\s+[A-Z]",
        "a fragment of an A2L description, which says where the control unit keeps values and holds no samples of them",
        _RECORDING,
    ),
    (rb"\ACANape PAR\s", "a parameter file of CANape", "Name the recording instead, as MDF or CSV."),
    (rb"\ATDSh(?s:.)\0", "an index of a TDMS file, which holds no samples", "Name the .tdms file beside it."),
    (
        rb"\A<h(?s:[A-Z]{3}.{6})>",
        "a log of AiM (.xrk)",
        "Export it as CSV from RaceStudio, or convert it to Parquet by the Python package libxrk.",
    ),
    (rb"\ACDF\x05", "a netCDF file of 64-bit data (CDF-5)", "Convert it: nccopy -k netCDF-4 old.nc new.nc."),
    (rb"\A\x0e\x03\x13\x01", "an HDF4 file", "Convert it to HDF5: h4toh5 old.hdf new.h5."),
    (rb"\AFEA1[^\t\r\n -~]", "a Feather file of version 1", "Write it again, as version 2 or as Parquet."),
    (rb"\A(?:Rar!\x1a|\x04\x22\x4d\x18|\x1f\x9d)|\A(?s:.{257})ustar", "a compressed file or archive", _UNPACK),
)


@dataclass(frozen=True)
class MeasurementFile:
    """A file on disk, its kind, the requested sheet, and the databases that decode it if it is a bus log."""

    path: Path
    kind: FileKind
    packed: bool = False  # gzip
    sheet: str | None = None
    label: str = ""  # of a file that was unpacked
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
    def size(self) -> int:
        """Bytes of content; for a compressed file, the size in its last four bytes."""
        if not self.packed:
            return self.path.stat().st_size
        with self.path.open("rb") as file:
            file.seek(-4, 2)
            return int.from_bytes(file.read(4), "little")

    def open(self) -> BinaryIO:
        """Return the content, unpacked."""
        if self.packed:
            import gzip

            return gzip.open(self.path, "rb")  # type: ignore[return-value]
        return self.path.open("rb")

    def start(self, size: int = _HEAD) -> bytes:
        """Return the first bytes of the content."""
        with self.open() as stream:
            return stream.read(size)


def locate(path: str | Path, sheet: str | None = None) -> MeasurementFile:
    """Return the file at `path`; raise `InputError` if there is none.

    A `#` may follow, and the name of a sheet or of a member of an archive.

    >>> locate("missing/bench.csv")
    Traceback (most recent call last):
    kennfeld.errors.InputError: missing/bench.csv: there is no such file. Check the path: the folder does not exist.
    """
    file = Path(path)
    if sheet is None and "#" in str(path) and not file.exists():
        whole, _, sheet = str(path).rpartition("#")
        file = Path(whole)
    if not file.exists():
        remedy = "Check the path: the folder does not exist."
        if file.parent.is_dir():
            remedy = nearest_file(file) or "Check the path."
        raise InputError.of(Location.of_file(file), "there is no such file", remedy)
    if file.is_dir():
        raise InputError.of(Location.of_file(file), "this is a folder", "Name a file in it.")
    kind, packed = detect_kind(file)
    return MeasurementFile(file, kind, packed, sheet or None)


def run_guarded(name: str, work: Callable[[], _T]) -> _T:  # Python 3.11
    """Run `work` on a file; errors of the system or of decompression become an `InputError`."""
    try:
        return work()
    except (EOFError, zlib.error):
        pass
    except OSError as error:
        if type(error).__name__ != "BadGzipFile":  # of a module that most runs do not need
            message = f"cannot be read ({error.strerror or error})"
            raise InputError.of(Location(name), message, "Check the file.") from None
    message = "the compressed file is damaged or cut off"
    raise InputError.of(Location(name), message, "Copy it again from its source.")


def refuse_foreign(source: MeasurementFile) -> None:
    """Raise `InputError` if a file is of a known kind that cannot be read, such as a picture or a Git LFS pointer."""
    head = run_guarded(source.name, source.start)
    content = identify_foreign(head)
    if content is None and source.kind is FileKind.EXCEL:
        content = identify_package(run_guarded(source.name, lambda: source.start(_PACKAGE)))
    if content is not None:
        raise InputError.of(source.location, f"this is {content.description}", content.remedy)
    if source.kind not in _WITHOUT_SIGNATURE:
        return
    start = head.removeprefix(b"\xef\xbb\xbf")
    for pattern, description, remedy in _FOREIGN:
        if re.search(pattern, start, _ANYWHERE):
            raise InputError.of(source.location, f"this is {description}", remedy)


def detect_kind(file: Path) -> tuple[FileKind, bool]:
    """Return the kind of a file and whether it is compressed by gzip. Raises `InputError` if it cannot be read."""

    def detect() -> tuple[FileKind, bool]:
        start = MeasurementFile(file, FileKind.OTHER).start()
        if start.startswith(b"\x1f\x8b"):
            return _kind_by_start(MeasurementFile(file, FileKind.OTHER, packed=True).start()), True
        return (_kind_of_zip(file) if start.startswith(b"PK\x03\x04") else _kind_by_start(start)), False

    return run_guarded(file.name, detect)


def _kind_by_start(start: bytes) -> FileKind:
    if start.startswith((b"\xff\xfe", b"\xfe\xff")) and _is_diadem(_narrow(start)):
        return FileKind.DIADEM
    if start.startswith(b"@\0\0\0"):
        from kennfeld.measurement.motec import recognises_motec  # which needs this module

        if recognises_motec(start):
            return FileKind.MOTEC
    for magic, kind in _MAGIC:
        if start.startswith(magic):
            return kind
    if b"\0" in start:
        return FileKind.MATLAB if _is_matlab_4(start) else FileKind.OTHER
    words = start.removeprefix(b"\xef\xbb\xbf").lstrip().lower()
    if re.match(rb"(?:<\?xml[^>]*>)?\s*(?:<!--.*?-->\s*)?<(?:\w+:)?tdm[\s>]", words, re.DOTALL):
        return FileKind.TDM
    for word, kind in _WORDS:
        if words.startswith(word):
            return kind
    if _is_diadem(words):
        return FileKind.DIADEM
    if b"\nkonservierung_format" in words.replace(b"\r", b"\n"):
        return FileKind.DCM
    log = next((kind for pattern, kind in _BUS_LOGS if pattern.search(start.removeprefix(b"\xef\xbb\xbf"))), None)
    if log is not None:
        return log
    if recognises_can_csv(start):
        return FileKind.CAN_CSV
    if _is_vbo(words):
        return FileKind.VBO
    return FileKind.MSL if _is_tunerstudio_log(words) else FileKind.CSV


def _narrow(start: bytes) -> bytes:
    """Return text of two bytes a character, the mark of that left out, in UTF-8 and lower case."""
    return start[: len(start) // 2 * 2].decode("utf-16", "ignore").lower().encode()


def _is_diadem(words: bytes) -> bool:
    return words.startswith(b"diaextended") or b"#beginglobalheader" in words or b"#beginchannelheader" in words


def _is_matlab_4(start: bytes) -> bool:
    """Return whether an array of MATLAB's version 4 begins here: that version has no signature."""
    for order in ("<", ">"):
        kind, rows, columns, imaginary, length = struct.unpack(f"{order}5i", start[:20].ljust(20, b"\0"))
        name = start[20 : 20 + max(length, 1)]
        sizes = rows >= 0 and columns >= 0 and imaginary in (0, 1) and 2 <= length <= 64
        if kind // 1000 == (order == ">") and kind % 1000 // 10 in range(6) and kind % 10 < 3 and sizes:
            return name.endswith(b"\0") and name[:-1].decode("latin-1").isidentifier()
    return False


def _is_tunerstudio_log(words: bytes) -> bool:
    """Return whether quoted lines of information precede tab-separated names that begin with the time."""
    lines = words.splitlines()
    quoted = next((i for i, line in enumerate(lines) if not line.startswith(b'"') or b"\t" in line), 0)
    return 0 < quoted < len(lines) and lines[quoted].replace(b'"', b"").startswith(b"time\t")


def _is_vbo(words: bytes) -> bool:
    """Return whether a text has the sections of Racelogic's loggers."""
    header, columns, rows = (section in words for section in (b"[header]", b"[column names]", b"[data]"))
    return (words.startswith(b"file created on") and (header or columns)) or (columns and (header or rows))


def _kind_of_zip(file: Path) -> FileKind:
    try:
        with zipfile.ZipFile(file) as archive:
            members = set(archive.namelist())
            mime = archive.read("mimetype")[:80] if "mimetype" in members else b""
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, EOFError, ValueError):
        message = "this ZIP archive (an Excel file, perhaps) is damaged or cut off"
        raise InputError.of(Location(file.name), message, "Copy it again from its source.") from None
    if b"opendocument.spreadsheet" in mime or any(member.startswith("xl/workbook") for member in members):
        return FileKind.EXCEL
    if "simulink/blockdiagram.xml" in members or "simulink/blockDiagram.json" in members:
        return FileKind.MODEL
    if members == {"header.xml"}:
        return FileKind.TDM  # as DIAdem saves it
    return FileKind.FMU if "modelDescription.xml" in members else FileKind.ZIP
