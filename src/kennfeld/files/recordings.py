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


_read_text = partial(read_recording, unpacks=True)
_read_log = partial(read_recording, "can_logs", rasters=True, describes=True, decodes=True)

PARQUET = FileFormat("Parquet", (".parquet",), starts_with(b"PAR1"), read_recording("parquet", costly=float("inf")))
FEATHER = FileFormat(
    "Feather",
    (".feather", ".arrow"),
    starts_with(b"ARROW1", b"\xff\xff\xff\xff"),  # the second one is a stream of Arrow
    read_recording("feather", costly=float("inf")),
)
TDMS = FileFormat("TDMS", (".tdms",), starts_with(b"TDSm"), read_recording("tdms", rasters=True))
NETCDF = FileFormat("netCDF", (".nc",), starts_with(b"CDF\x01", b"CDF\x02"), read_recording("netcdf", rasters=True))
MDF = FileFormat(
    "MDF",
    (".mf4", ".mdf", ".dat"),
    starts_with(b"MDF     ", b"UnFinMF"),
    read_recording("mdf", rasters=True, describes=True, decodes=True),
    description="an MDF measurement",
)
MLG = FileFormat("MLG", (".mlg",), starts_with(b"MLVLG"), read_recording("mlg", may_lack_time=True))
BLF = FileFormat("Vector BLF", (".blf",), starts_with(b"LOGG"), _read_log())
FAMOS = FileFormat("FAMOS", (".raw", ".dat"), starts_with(b"|CF,1,", b"|CF,2,"), read_recording("famos", rasters=True))
MOTEC = FileFormat("MoTeC", (".ld",), _is_motec, read_recording("motec", rasters=True))
TDM = FileFormat(
    "TDM",
    (".tdm",),
    _is_tdm,
    read_recording("tdm_header", rasters=True, companions="kennfeld.measurement.tdm_header:companions"),
)
DIADEM = FileFormat(
    "DIAdem",
    (".dat",),
    _is_diadem,
    read_recording("diadem", rasters=True, companions="kennfeld.measurement.diadem:companions"),
)
HPTUNERS = FileFormat(
    "HP Tuners", (".csv",), reads_as("hp tuners csv log file"), _read_text("hptuners", rasters=True, describes=True)
)
LVM = FileFormat("LabVIEW", (".lvm",), reads_as("labview measurement"), _read_text("lvm"))
HALTECH = FileFormat("Haltech", (".csv",), reads_as("%datalog%"), _read_text("haltech"))
ASC = FileFormat("Vector ASC", (".asc",), holds(ASC_HEADER, _HEAD), _read_log(unpacks=True))
TRC = FileFormat("PEAK TRC", (".trc",), holds(_TRC_HEADER, _HEAD), _read_log(unpacks=True))
CANDUMP = FileFormat("candump", (".log",), holds(_CANDUMP_FRAME, _HEAD), _read_log(unpacks=True))
CAN_CSV = FileFormat("CAN CSV", (".csv",), _is_can_csv, _read_log(unpacks=True))
VBO = FileFormat("VBOX", (".vbo",), _is_vbo, _read_text("vbo"))
MSL = FileFormat(
    "MSL",
    (".msl",),
    _is_msl,
    _read_text("text", may_lack_time=True, columns="kennfeld.measurement.text:list_columns"),
)
CSV = FileFormat(
    "CSV",
    (".csv", ".txt", ".tsv"),
    lambda head: not head.is_binary,
    _read_text("text", costly=0.5, columns="kennfeld.measurement.text:list_columns"),
)
