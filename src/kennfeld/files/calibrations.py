"""Formats of calibration files; workbooks and MATLAB's data files are among the containers."""

import re
from typing import Any

from kennfeld.files.file_format import (
    CalibrationConverter,
    FileFormat,
    Role,
    has_root,
    holds_line,
    matches,
    reads_as,
)
from kennfeld.files.head import FileHead
from kennfeld.files.rows import is_row

IMAGE_ENDINGS = (".hex", ".s19", ".s37", ".srec", ".mot", ".ihex", ".s28")
SCRIPT_TITLE = "% Kennfeld calibration"

# what formats lack, by the keys of `calfiles.loss_report`; no file of values holds the settings of a calibration
_SETTINGS = ("bounds", "locks", "free axes")
_NOT_FINITE = ("missing values", "infinities")
_PLAIN = ("inputs", "extrapolation", "line breaks", *_SETTINGS)
_DCM = ("kinds", *_PLAIN)
_CVX = ("kinds", "descriptions", "group units", "columns", *_PLAIN)

_DCM_LINE = (
    r"(?:KONSERVIERUNG_FORMAT|(?:FEST|GRUPPEN)?(?:KENNLINIE|KENNFELD)|FESTWERT(?:EBLOCK)?"
    r"|STUETZSTELLENVERTEILUNG|TEXTSTRING|FUNKTIONEN|VARIANTENKODIERUNG|MODULKOPF)(?:\s|$)(?![ \t]*=)"
)
_IMAGE_RECORD = re.compile(r"\s*(?::[0-9A-Fa-f]{10}|S[0-9][0-9A-Fa-f]{6})")
_PAR_TITLE = re.compile(r"\s*CANape PAR V\d")
# possessive, so that a long head of comments is searched only once
_ESDL_PACKAGE = re.compile(r"(?:\s++|//[^\n]*+|/\*.*?\*/)*+package\s+[\w.]+\s*;", re.DOTALL)
_AMD_ROOTS = ("ComponentData", "ComponentMain", "ComponentImplementation", "Specifications", "Project")
_ASSIGNMENT = re.compile(r"[A-Za-z]\w*(?:\.\w+|\(\d+\)|\{\d+\})*[ \t]*=[ \t]*(?:\[|(?!=)[^;\n]*(?:;|\.\.\.))")
_HARMLESS = re.compile(r"(?:clear|clc|close|function|format|clearvars)\b[^:]*")
_BRACKETS = re.compile(r"\[[^\[\]]*+\]")
_SCRIPT_LINES = 400  # in which a script assigns its first value
_COMMAND = 500  # characters of a command other than an assignment


def _is_amd(head: FileHead) -> bool:
    """Return whether a file is an archive of ASCET's components, or one of them."""
    if head.members:
        parts = [member for member in head.members if member.endswith(".amd")]
        # under another ending, an archive has to hold the main file of a component
        return bool(parts) and (head.ending == ".axl" or any(member.endswith(".main.amd") for member in parts))
    return head.root in _AMD_ROOTS


def _is_script(head: FileHead) -> bool:
    """Return whether a text begins like a script that assigns numbers."""
    if head.text.startswith(SCRIPT_TITLE):
        return True
    # a matrix in brackets has rows like those of a table
    if head.ending != ".m" and any(map(is_row, _BRACKETS.sub("", head.text).split("\n"))):
        return False
    for line in map(str.strip, head.text.split("\n", _SCRIPT_LINES)[:_SCRIPT_LINES]):
        if _ASSIGNMENT.match(line):
            return True
        if line and line[0] not in "%#" and not _HARMLESS.fullmatch(line[:_COMMAND]):
            return False
    return False


def _convert_by(read: str, write: str, lacks: tuple[str, ...] = (), **settings: Any) -> CalibrationConverter:
    """Return the converter whose functions are in modules of `kennfeld.calfiles`."""
    return CalibrationConverter(f"kennfeld.calfiles.{read}", f"kennfeld.calfiles.{write}", lacks, **settings)


JSON = FileFormat(
    "JSON",
    (".json",),
    reads_as("{"),
    calibration=_convert_by(
        "json_file:read_json",
        "json_file:write_json",
        ("infinities", *_SETTINGS),
        notes="the format of `parameters.json`, which every run writes; see [below](#json)",
    ),
)
CVX = FileFormat(
    "CVX",
    (".csv",),
    reads_as("calibration values v"),
    description="a CVX calibration file",
    calibration=_convert_by(
        "cvx.reader:read_cvx",
        "cvx.writer:write_cvx",
        _CVX,
        label="CVX (INCA's CSV)",
        refuses=("cubes", *_NOT_FINITE),
        notes="INCA's calibration values as CSV, with functions, variants and display identifiers; cuboids are skipped",
    ),
)
CDFX = FileFormat(
    "CDFX",
    (".cdfx",),
    has_root("MSRSW"),
    calibration=_convert_by(
        "cdfx.reader:read_cdfx",
        "cdfx.writer:write_cdfx",
        _PLAIN,
        refuses=_NOT_FINITE,
        notes="ASAM CDF 2.0: scalars, blocks, curves, maps, cubes, common axes, texts, functions, display names, "
        "variants; see [below](#cdfx)",
    ),
)
DCM = FileFormat(
    "DCM",
    (".dcm",),
    holds_line(_DCM_LINE),
    description="a DCM calibration file",
    calibration=_convert_by(
        "dcm.reader:read_dcm",
        "dcm.update:write_dcm",
        _DCM,
        refuses=("cubes", *_NOT_FINITE),
        notes="versions 1 and 2: scalars, blocks, curves, maps, fixed and group axes, texts; see [below](#dcm)",
    ),
)
IMAGE = FileFormat(
    "Intel HEX or S-records",
    IMAGE_ENDINGS,
    matches(_IMAGE_RECORD),
    calibration=_convert_by(
        "a2l.image_files:read_flash",
        "a2l.image_files:write_flash",
        label="Intel HEX or S-records with an A2L file",
        copies=True,
        notes="a memory image, described by an A2L file; see [below](#a2l-and-images)",
    ),
)
MSQ = FileFormat(
    "MSQ",
    (".msq",),
    has_root("msq"),
    calibration=_convert_by(
        "msq.reader:read_msq",
        "msq.update:write_msq",
        label="MSQ (TunerStudio)",
        copies=True,
        notes="tunes of MegaSquirt, Speeduino, rusEFI; see [below](#msq)",
    ),
)
PAR = FileFormat(
    "PAR",
    (".par",),
    matches(_PAR_TITLE),
    description="a parameter file of CANape",
    calibration=_convert_by(
        "par.reader:read_par",
        "par.update:write_par",
        label="PAR (CANape)",
        copies=True,
        notes="parameter files of CANape, versions 3.1 and 3.2; see [below](#par)",
    ),
)
ESDL = FileFormat(
    "ESDL",
    (".esdl",),
    matches(_ESDL_PACKAGE),
    calibration=_convert_by(
        "esdl.reader:read_esdl",
        "esdl.update:write_esdl",
        label="ESDL (ASCET)",
        copies=True,
        notes="characteristics of ASCET classes; see [below](#esdl)",
    ),
    role=Role.PROGRAM,
    notes="classes and data interfaces of ASCET-DEVELOPER 7",
)
AMD = FileFormat(
    "ASCET component",
    (".axl", ".amd"),
    _is_amd,
    calibration=_convert_by(
        "amd.reader:read_amd",
        "amd.update:write_amd",
        label="AXL and AMD (ASCET 6)",
        copies=True,
        notes="parameters of components of ASCET 5 and 6 (`.axl`, `.data.amd`); see [below](#axl-and-amd)",
    ),
    role=Role.PROGRAM,
    notes="components of ASCET 5 and 6, and archives of them",
)
SCRIPT = FileFormat(
    "MATLAB script",
    (".m",),
    _is_script,
    calibration=_convert_by(
        "matlab_reader:read_script",
        "matlab_writer:write_script",
        ("extrapolation", *_SETTINGS),
        notes="scripts of assignments; see [below](#matlab-1)",
    ),
)
