"""All formats of files, in the order in which they are tried."""

from collections.abc import Iterator
from functools import cache

from kennfeld.files import calibrations, containers, descriptions, foreign, functions, recordings
from kennfeld.files.file_format import FileFormat, MeasurementReader, Role
from kennfeld.files.head import ZIP
from kennfeld.files.plugins import formats_of_plugins

# by a signature, a title or the root of a document
_SIGNED = (
    recordings.PARQUET,
    recordings.FEATHER,
    recordings.TDMS,
    recordings.NETCDF,
    recordings.MDF,
    recordings.MLG,
    recordings.BLF,
    recordings.FAMOS,
    recordings.MOTEC,
    containers.MATLAB,
    containers.HDF5,
    containers.EXCEL,
    functions.SIMULINK,
    functions.FMU,
    functions.DICTIONARY,
    calibrations.AMD,
    recordings.TDM,
    *foreign.OF_OTHER_TOOLS,
    calibrations.CDFX,
    calibrations.MSQ,
    descriptions.ARXML,
    descriptions.KCD,
    descriptions.SYM,
    calibrations.CVX,
    calibrations.PAR,
    descriptions.A2L_FRAGMENT,
    descriptions.A2L,
    calibrations.IMAGE,
    calibrations.ESDL,
    recordings.HPTUNERS,
    recordings.LVM,
    recordings.HALTECH,
    recordings.DIADEM,
    recordings.ASC,
    recordings.TRC,
    recordings.CANDUMP,
    recordings.CAN_CSV,
    recordings.VBO,
    recordings.MSL,
    functions.SURROGATE,
    functions.ENUMERATION,
    calibrations.DCM,
)
# by their ending alone: languages, and what is damaged
_NAMED = (
    functions.FORMULA,
    functions.SIMULINK,
    functions.PROTECTED,
    functions.FMU,
    functions.ONNX,
    functions.C,
    functions.HEADER,
    functions.PYTHON,
    functions.APPLICATION,
    functions.DICTIONARY,
    functions.PROJECT,
    calibrations.ESDL,
    calibrations.AMD,
    descriptions.A2L,
    descriptions.DBC,
    descriptions.ARXML,
    descriptions.KCD,
    descriptions.SYM,
)
ZIP_ARCHIVE = FileFormat(
    "ZIP archive",
    (".zip",),
    lambda head: head.raw.startswith(ZIP) and not head.member,
    MeasurementReader(),  # of the file in it
    description="a ZIP archive, such as .xlsx, .slx or .fmu",
)
XML = FileFormat("XML", (".xml",), lambda head: head.words.startswith("<?xml") or head.root != "")
BINARY = FileFormat("binary")
# content that others are made of
_GENERAL = (
    descriptions.DBC,
    calibrations.JSON,
    functions.PROJECT_TEXT,
    *foreign.BY_ENDING,
    ZIP_ARCHIVE,
    XML,
)
_GUESSED = (calibrations.SCRIPT, functions.FORMULA_TEXT, recordings.CSV)


def certain_formats() -> Iterator[FileFormat]:
    """Yield the formats that content tells beyond doubt; those of plugins are the last ones."""
    yield from _SIGNED
    yield from formats_of_plugins()


def uncertain_formats() -> Iterator[tuple[FileFormat, bool]]:
    """Yield the formats that are tried after those, and whether they are no more than a guess."""
    yield from ((known, False) for known in _GENERAL)
    yield from ((known, True) for known in _GUESSED)


def _all() -> Iterator[FileFormat]:
    yield from certain_formats()
    yield from _NAMED
    yield from (known for known, _ in uncertain_formats())


def format_named(name: str) -> FileFormat:
    """Return the format of a name."""
    return next(known for known in _all() if known.name == name)


def named_format(ending: str) -> FileFormat | None:
    """Return the format that an ending alone tells; None for other endings."""
    return next((known for known in _named() if ending in known.endings), None)


def _named() -> Iterator[FileFormat]:
    yield from _NAMED
    yield from (known for known in formats_of_plugins() if known.recognises is None)


def usual_format(ending: str) -> FileFormat | None:
    """Return the format that an empty file of an ending is to become; None for recordings, which are never empty."""
    known = next((known for known in (*_NAMED, *calibration_formats()) if ending in known.endings), None)
    return None if ending in endings_of(Role.RECORDING) else known


def calibration_formats() -> tuple[FileFormat, ...]:
    """Return the formats that files of values can have, in the order of messages."""
    own = (
        *(calibrations.JSON, calibrations.CVX, calibrations.CDFX, calibrations.DCM, calibrations.IMAGE),
        *(calibrations.MSQ, calibrations.PAR, calibrations.ESDL, calibrations.AMD, containers.EXCEL),
        *(containers.MATLAB, calibrations.SCRIPT),
    )
    return (*own, *(known for known in formats_of_plugins() if known.calibration is not None))


def recording_formats() -> tuple[FileFormat, ...]:
    """Return the formats of recordings, the most usual ones first."""
    usual = (
        recordings.MDF,
        recordings.CSV,
        containers.EXCEL,
        containers.MATLAB,
        recordings.PARQUET,
        recordings.FEATHER,
    )
    others = (known for known in _all() if known.recording is not None and known is not ZIP_ARCHIVE)
    return tuple(dict.fromkeys((*usual, *others)))


def formats_of(*roles: Role) -> tuple[FileFormat, ...]:
    """Return the formats whose files may have one of these roles, in the order in which they are tried."""
    return tuple(dict.fromkeys(known for known in _all() if not known.roles.isdisjoint(roles)))


@cache
def endings_of(role: Role) -> tuple[str, ...]:
    """Return the endings that files of a role usually have."""
    return tuple(dict.fromkeys(ending for known in formats_of(role) for ending in known.endings))
