"""Related files that cannot be read as measurements, such as bus logs, with the remedy for each."""

import re
from dataclasses import dataclass

from kennfeld.errors import InputError

_DECODE = "Decode it with its CAN or LIN database, in CANalyzer or with asammdf, and export the signals as MDF or CSV."
_RECORDING = "Name the recording of the decoded signals instead, as MDF or CSV."
_EXPORT = "Export the measurement as MDF, CSV or MATLAB."

_BUS_LOG = "a log of bus messages: it holds their bytes, not the values of signals"
_DATABASE = "a database of bus messages: it describes signals and holds no samples of them"


@dataclass(frozen=True)
class _Foreign:
    """A kind of file by how it begins; `text` is sought within its first bytes, whatever the case of letters."""

    message: str
    remedy: str
    text: bytes

    def begins(self, start: bytes) -> bool:
        """Return whether a file that begins with these bytes is of this kind."""
        return re.search(self.text, start, re.IGNORECASE | re.MULTILINE) is not None


_FOREIGN = (
    _Foreign(f"a Vector ASC file, {_BUS_LOG}", _DECODE, rb"^base\s+(?:hex|dec)\s+timestamps\s+(?:absolute|relative)"),
    _Foreign(f"a Vector BLF file, {_BUS_LOG}", _DECODE, rb"\ALOGG"),
    _Foreign(f"a PEAK TRC file, {_BUS_LOG}", _DECODE, rb"\A(?:\s*;.*\n)*\s*;\$FILEVERSION="),
    _Foreign(
        f"a CAN database (DBC), {_DATABASE}", _RECORDING, rb"\A\s*VERSION\s+\"|^[ \t]*(?:NS_\s*:|BU_\s*:|BO_\s+\d+\s)"
    ),
    _Foreign(f"a LIN database (LDF), {_DATABASE}", _RECORDING, rb"\A\s*(?:/\*.*?\*/\s*)?LIN_description_file\s*;"),
    _Foreign(
        f"an AUTOSAR description (ARXML), {_DATABASE}", _RECORDING, rb"\A(?:<\?xml[^>]*>)?\s*(?:<!--.*?-->\s*)?<AUTOSAR"
    ),
    _Foreign(
        "a DIAdem header file, which describes channels whose values lie in other files",
        f"{_EXPORT[:-1]} in DIAdem.",
        rb"\A\s*DIAEXTENDED|^#BEGINGLOBALHEADER",
    ),
    _Foreign(
        "a fragment of an A2L description, which says where the control unit keeps values and holds no samples of them",
        _RECORDING,
        rb"\A(?:\s|/\*(?:[^*]|\*(?!/))*\*/)*/begin\s+[A-Z]",
    ),
    _Foreign("a parameter file of CANape", "Name the recording instead, as MDF or CSV.", rb"\ACANape PAR\s"),
    _Foreign("a TDMS file of National Instruments", _EXPORT, rb"\ATDSm"),
    _Foreign("a TDM file of National Instruments", _EXPORT, rb"\A(?:<\?xml[^>]*>)?\s*<(?:usi:)?tdm[\s>]"),
)


def refuse_foreign(place: str, start: bytes) -> None:
    """Raise `InputError` if a file that begins with these bytes is of a known kind that cannot be read."""
    text = start.removeprefix(b"\xef\xbb\xbf")
    for one in _FOREIGN:
        if one.begins(text):
            raise InputError.of(place, f"this is {one.message}", one.remedy)
