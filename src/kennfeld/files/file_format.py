"""The record of a file format: how its files are recognised, and what can be done with them.

A format that another package adds is such a record, too; see `docs/adding-a-format.md`.
"""

import re
from collections.abc import Callable
from enum import Enum
from importlib import import_module
from typing import Any

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.head import HEAD_SIZE, FileHead

# names whose first letter is spoken with a vowel
_SPOKEN = ("A", "E", "I", "O", "FMU", "HDF", "HP", "HTML", "MDF", "MLG", "MSL", "MSQ", "XML")
Recogniser = Callable[[FileHead], bool]
Reference = str | Callable[..., Any]  # `module:function`, loaded when it is first called, or the function


class Role(Enum):
    """The purpose of a file."""

    RECORDING = "recording"
    CALIBRATION = "calibration"
    FUNCTION = "function"
    PROGRAM = "program"  # a part of a function that several files make up
    COMPANION = "companion"  # is read with the function that is beside it
    DATABASE = "database"  # of bus messages
    DESCRIPTION = "description"  # of what a control unit stores
    SURROGATE = "surrogate"
    PROJECT = "project"
    NONE = "none"  # cannot be read


@dataclass(frozen=True)
class MeasurementReader:
    """The functions that read recordings of a format.

    Attributes:
        tables: `read_tables(source, selection)`, which returns the tables of a file. Formats of other packages may
            give `dataset` instead.
        dataset: `read(path)`, which returns a `Dataset`.
        rasters: True if the tables of a file are rasters of one recording.
        descriptions: `describe_tables(source)`, which describes such tables; by default each as it is read.
        columns: `list_columns(source)` of text, which lists columns without reading them.
        companions: `companions(source)`, which returns the files beside the named one that hold its values.
        unpacks: True if the reader unpacks gzip itself, as text is read.
        has_sheets: True if a file has sheets that a `#` and their name select.
        may_lack_time: True if records may lack a time stamp.
        decodes: True if a file may hold frames of a bus, which databases decode.
        costly: time of reading in s that makes a copy in the cache worthwhile.
        label: the name of the format in lists of recordings, by default that of the format.
        notes: versions, contents and limits of such recordings, as a table of the documentation states them.
    """

    tables: Reference = ""
    dataset: Reference = ""
    rasters: bool = False
    descriptions: Reference = ""
    columns: Reference = ""
    companions: Reference = ""
    unpacks: bool = False
    has_sheets: bool = False
    may_lack_time: bool = False
    decodes: bool = False
    costly: float = 0.2
    label: str = ""
    notes: str = ""


@dataclass(frozen=True)
class CalibrationConverter:
    """The functions that read and write calibration files of a format.

    Attributes:
        read: `read(source)`, which returns a `ReadResult`.
        write: `write(parameters, name)`, which returns the text of a file or a `WriteResult`; empty if files are only
            read.
        lacks: aspects of a set that a new file does not store, by the keys of `calfiles.loss_report`.
        endings: the endings of files that can be written, by default those of the format.
        label: the name of the format in lists of calibration formats, by default that of the format.
        copies: True if values are only written into a copy of a file of the format.
        refuses: contents that no new file can hold, by the words of the documentation: "cubes", "missing values" or
            "infinities".
        notes: versions, contents and limits of such files, as a table of the documentation states them.
    """

    read: Reference
    write: Reference = ""
    lacks: tuple[str, ...] = ()
    endings: tuple[str, ...] = ()
    label: str = ""
    copies: bool = False
    refuses: tuple[str, ...] = ()
    notes: str = ""

    @property
    def unstated(self) -> tuple[str, ...]:
        """The aspects that a file of this format does not state, or, as JSON the extrapolation, may leave out."""
        return ("extrapolation", *(self.lacks or ("locks", "free axes")))


@dataclass(frozen=True, eq=False)
class FileFormat:
    """A format of files.

    Attributes:
        name: the name in messages, such as "CSV".
        endings: endings of its files, in lower case and with the dot; the first one is the usual one.
        recognises: whether the head of a file is of this format; None if only the ending tells it.
        recording: how its files are read as recordings, if they can hold one.
        calibration: how its files are read and written as calibrations, if they can hold one.
        holds_calibration: of a format that can hold both: whether a file, given by its head, holds a calibration.
        role: what its files are for, if they are neither.
        describe: `describe(file)` of a `DescribedFile`, which returns a `FileInfo`; by default that of its role.
        description: what a file is, as `this is ...` continues; by default the article and the name.
        remedy: what to do instead, if files of this format cannot be read.
        notes: versions, contents and limits of files that are neither recordings nor calibrations, as a table of the
            documentation states them.
    """

    name: str
    endings: tuple[str, ...] = ()
    recognises: Recogniser | None = None
    recording: MeasurementReader | None = None
    calibration: CalibrationConverter | None = None
    holds_calibration: Reference = ""
    role: Role = Role.NONE
    describe: Reference = ""
    description: str = ""
    remedy: str = ""
    notes: str = ""

    @property
    def phrase(self) -> str:
        """A file of this format in words, with the article: `an MDF file`."""
        return self.description or f"{'an' if self.name.startswith(_SPOKEN) else 'a'} {self.name} file"

    @property
    def roles(self) -> frozenset[Role]:
        """The purposes that files of this format may have."""
        roles = {Role.RECORDING} if self.recording is not None else set()
        roles |= {Role.CALIBRATION} if self.calibration is not None else set()
        return frozenset(roles | ({self.role} if self.role is not Role.NONE or not roles else set()))

    def __reduce__(self) -> tuple[Callable[[str], "FileFormat"], tuple[str]]:
        """Let another process find the record by its name: functions cannot be sent."""
        from kennfeld.files.formats import format_named

        return format_named, (self.name,)

    def role_of(self, head: FileHead) -> Role:
        """Return what a file of this format is for."""
        if self.role is not Role.NONE:
            return self.role
        if self.recording is None or self.calibration is None:
            return next(iter(self.roles))
        return Role.CALIBRATION if call(self.holds_calibration, head) else Role.RECORDING


def starts_with(*marks: bytes) -> Recogniser:
    """Return the recogniser of files that begin with one of these bytes."""
    return lambda head: head.raw.startswith(marks)


def reads_as(*words: str) -> Recogniser:
    """Return the recogniser of texts that begin with one of these words, ignoring case and blanks."""
    return lambda head: head.words.startswith(words)


def matches(pattern: re.Pattern[str]) -> Recogniser:
    """Return the recogniser of texts that a pattern matches at their beginning."""
    return lambda head: pattern.match(head.text) is not None


def holds(pattern: re.Pattern[str], size: int = HEAD_SIZE) -> Recogniser:
    """Return the recogniser of texts in whose first `size` characters a pattern is found."""
    return lambda head: pattern.search(head.text[:size]) is not None


def holds_line(pattern: str) -> Recogniser:
    """Return the recogniser of texts in which a line begins, after blanks, as a pattern says.

    A search from line feed to line feed is faster than one for `^`, which asks at each character whether a line begins.
    """
    line = re.compile(rf"\n[ \t]*(?:{pattern})")
    return lambda head: line.search("\n" + head.text) is not None


def has_root(*names: str) -> Recogniser:
    """Return the recogniser of XML documents whose root has one of these names."""
    return lambda head: head.root in names


def read_recording(module: str, *, describes: bool = False, **settings: Any) -> MeasurementReader:
    """Return the reader that a module of `kennfeld.measurement` defines; it `describes` its tables itself or not."""
    name = f"kennfeld.measurement.{module}"
    descriptions = f"{name}:describe_tables" if describes else ""
    return MeasurementReader(f"{name}:read_tables", descriptions=descriptions, **settings)


def call(reference: Reference, *arguments: Any) -> Any:
    """Call the function of a reference."""
    return resolve(reference)(*arguments)


def resolve(reference: Reference) -> Callable[..., Any]:
    """Return the function of a reference; loads its module if it is a text."""
    if not isinstance(reference, str):
        return reference
    module, _, name = reference.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function
