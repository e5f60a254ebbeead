"""Formats of recordings."""

import re
from functools import partial

from kennfeld.files.can_csv_columns import can_csv_separator
from kennfeld.files.file_format import FileFormat, holds, read_recording, reads_as, starts_with
from kennfeld.files.head import FileHead

_HEAD = 4096  # bytes or characters in which a heading stands
_MOTEC_DATE = re.compile(rb"\d{1,2}/\d{1,2}/\d{4}\0")
_ANYWHERE = re.IGNORECASE | re.MULTILINE
ASC_HEADER = re.compile(
    r"^base[ \t]+(?P<base>hex|dec)(?:[ \t]+timestamps[ \t]+(?P<stamps>absolute|relative)|[ \t]*$)", _ANYWHERE
)
_TRC_HEADER = re.compile(r"\A(?:\s*;.*\n)*\s*;\$FILEVERSION=|\A;#{20,}\s*$", _ANYWHERE)
_CANDUMP_FRAME = re.compile(r"\A\s*\(\d+\.\d+\)\s+\S+\s+[\da-f]{3,8}#", _ANYWHERE)


def _is_motec(head: FileHead) -> bool:
    """Return whether a file begins with the marker of MoTeC's loggers, and holds a date as text."""
    return head.raw.startswith(b"\x40\0\0\0") and _MOTEC_DATE.match(head.raw, 94) is not None


def _is_tdm(head: FileHead) -> bool:
    return head.members == ("header.xml",) or head.root == "tdm"


def _is_diadem(head: FileHead) -> bool:
    start = head.words[:_HEAD]
    return start.startswith("diaextended") or "#beginglobalheader" in start or "#beginchannelheader" in start


def _is_can_csv(head: FileHead) -> bool:
    return can_csv_separator(head.text.partition("\n")[0]) != ""


def _is_vbo(head: FileHead) -> bool:
    """Return whether a text has the sections of Racelogic's loggers."""
    start = head.words[:_HEAD]
    header, columns, rows = (section in start for section in ("[header]", "[column names]", "[data]"))
    return (start.startswith("file created on") and (header or columns)) or (columns and (header or rows))


def _is_msl(head: FileHead) -> bool:
    """Return whether quoted lines of information precede tab-separated names that begin with the time."""
    lines = head.words[:_HEAD].split("\n")
    quoted = next((i for i, line in enumerate(lines) if not line.startswith('"') or "\t" in line), 0)
    return 0 < quoted < len(lines) and lines[quoted].replace('"', "").startswith("time\t")


_COLUMN_UNITS = "units from the metadata of the columns"
_TEXT_LOG = "frames of CAN; needs the extra `bus`; see [bus logs](#bus-logs)"
_read_text = partial(read_recording, unpacks=True)
_read_log = partial(read_recording, "can_logs", rasters=True, describes=True, decodes=True)

PARQUET = FileFormat(
    "Parquet", (".parquet",), starts_with(b"PAR1"), read_recording("parquet", costly=float("inf"), notes=_COLUMN_UNITS)
)
FEATHER = FileFormat(
    "Feather",
    (".feather", ".arrow"),
    starts_with(b"ARROW1", b"\xff\xff\xff\xff"),  # the second one is a stream of Arrow
    read_recording("feather", costly=float("inf"), notes=f"version 2, and Arrow streams; {_COLUMN_UNITS}"),
)
TDMS = FileFormat(
    "TDMS",
    (".tdms",),
    starts_with(b"TDSm"),
    read_recording("tdms", rasters=True, notes="needs the extra `tdms`; see [below](#tdms-and-diadem)"),
)
NETCDF = FileFormat(
    "netCDF",
    (".nc",),
    starts_with(b"CDF\x01", b"CDF\x02"),
    read_recording(
        "netcdf",
        rasters=True,
        label="netCDF 3",
        notes="version 3; files of version 4 are HDF5; see [below](#hdf5-and-netcdf)",
    ),
)
MDF = FileFormat(
    "MDF",
    (".mf4", ".mdf", ".dat"),
    starts_with(b"MDF     ", b"UnFinMF"),
    read_recording(
        "mdf",
        rasters=True,
        describes=True,
        decodes=True,
        label="MDF 2 to 4",
        notes="versions 2 to 4, compressed and unfinalized files; groups of several rasters; in version 4 frames of "
        "CAN and LIN, see [bus logs](#bus-logs)",
    ),
    description="an MDF measurement",
)
MLG = FileFormat(
    "MLG",
    (".mlg",),
    starts_with(b"MLVLG"),
    read_recording(
        "mlg",
        may_lack_time=True,
        label="MLG (TunerStudio)",
        notes="binary logs of TunerStudio, MegaLogViewer and Speeduino, versions 1 and 2",
    ),
)
BLF = FileFormat(
    "Vector BLF",
    (".blf",),
    starts_with(b"LOGG"),
    _read_log(notes="binary logs of frames of CAN; see [bus logs](#bus-logs)"),
)
FAMOS = FileFormat(
    "FAMOS",
    (".raw", ".dat"),
    starts_with(b"|CF,1,", b"|CF,2,"),
    read_recording(
        "famos",
        rasters=True,
        label="FAMOS (imc)",
        notes="version 2 of imc: even and uneven times, bits of digital channels, triggers. Of 88 channels in the "
        "sample files of IMCtermite, 84 have its values; three are digital channels that it leaves unscaled. Four of "
        "its files are damaged and refused. Not supported and reported: channels of several events, complex values, "
        "texts; not tried: the byte order of Motorola",
    ),
)
MOTEC = FileFormat(
    "MoTeC",
    (".ld",),
    _is_motec,
    read_recording(
        "motec",
        rasters=True,
        notes="logs of MoTeC; a raster for each rate. The layout is that of the public reader ldparser; compared with "
        "it on files of our own, not tried on files of a logger. Channels of unknown types are skipped and reported",
    ),
)
TDM = FileFormat(
    "TDM",
    (".tdm",),
    _is_tdm,
    read_recording(
        "tdm_header",
        rasters=True,
        companions="kennfeld.measurement.tdm_header:companions",
        label="TDM (DIAdem)",
        notes="headers of DIAdem with the `.tdx` beside them, also as packed by DIAdem; see [below](#tdms-and-diadem)",
    ),
)
DIADEM = FileFormat(
    "DIAdem",
    (".dat",),
    _is_diadem,
    read_recording(
        "diadem",
        rasters=True,
        companions="kennfeld.measurement.diadem:companions",
        notes="headers with the files of values beside them; see [below](#tdms-and-diadem)",
    ),
)
HPTUNERS = FileFormat(
    "HP Tuners",
    (".csv",),
    reads_as("hp tuners csv log file"),
    _read_text(
        "hptuners",
        rasters=True,
        describes=True,
        notes="CSV logs of the VCM Scanner; see [below](#logs-of-tuning-tools)",
    ),
)
LVM = FileFormat(
    "LabVIEW",
    (".lvm",),
    reads_as("labview measurement"),
    _read_text("lvm", notes="segments; one time column for all channels, one for each, or none"),
)
HALTECH = FileFormat(
    "Haltech",
    (".csv",),
    reads_as("%datalog%"),
    _read_text("haltech", notes="CSV logs of NSP and ESP; see [below](#logs-of-tuning-tools)"),
)
ASC = FileFormat("Vector ASC", (".asc",), holds(ASC_HEADER, _HEAD), _read_log(unpacks=True, notes=_TEXT_LOG))
TRC = FileFormat("PEAK TRC", (".trc",), holds(_TRC_HEADER, _HEAD), _read_log(unpacks=True, notes=_TEXT_LOG))
CANDUMP = FileFormat("candump", (".log",), holds(_CANDUMP_FRAME, _HEAD), _read_log(unpacks=True, notes=_TEXT_LOG))
CAN_CSV = FileFormat(
    "CAN CSV",
    (".csv",),
    _is_can_csv,
    _read_log(
        unpacks=True,
        notes="frames of CAN, as CSS Electronics, SavvyCAN, python-can, Kvaser and asammdf write them; see [bus "
        "logs](#bus-logs)",
    ),
)
VBO = FileFormat(
    "VBOX", (".vbo",), _is_vbo, _read_text("vbo", notes="logs of Racelogic's VBOX; see [below](#logs-of-tuning-tools)")
)
MSL = FileFormat(
    "MSL",
    (".msl",),
    _is_msl,
    _read_text(
        "text",
        may_lack_time=True,
        columns="kennfeld.measurement.text:list_columns",
        label="MSL (TunerStudio)",
        notes="text logs of TunerStudio and MegaTune",
    ),
)
CSV = FileFormat(
    "CSV",
    (".csv", ".txt", ".tsv"),
    lambda head: not head.is_binary,
    _read_text(
        "text",
        costly=0.5,
        columns="kennfeld.measurement.text:list_columns",
        label="CSV in any dialect (INCA, MDA, CANape, DIAdem, AiM, MoTeC, VCDS, Torque)",
        notes="separated by commas, semicolons, tabs, vertical bars or spaces; decimal point or comma; UTF-8, UTF-16, "
        "Windows encoding, GB18030 (GBK) or Shift JIS; rows of units, types and descriptions; comments, lines and "
        "blocks of numbers before the header; gzip. All of this is detected automatically, also in exports of AiM, "
        "MoTeC, VCDS (VAG-COM), Torque and VBOX",
    ),
)
