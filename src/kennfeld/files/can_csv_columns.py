"""Recognition of logs of CAN frames in CSV by the names of their columns.

Programs and scripts call the same columns differently. A log that is not recognised would be read as a measurement, its
hexadecimal digits as decimal numbers.
"""

import re
from collections import Counter

_IDENTIFIERS = {"id", "arbitrationid"}
_LENGTHS = {"dlc", "datalength", "len"}
_DATA = {"databytes", "data", "d0", "d1"}
_TIMES = {"time", "timestamp", "timestamps", "timestampepoch"}
_PREFIX = "candataframe."
_SUFFIX = re.compile(r"[\[(](?:hex|dec|s|sec)[a-z.]*[\])]$")  # the base of the numbers, or seconds
# names that are those of CAN alone, so that they need no length beside them
_OWN = {"canid", "canidentifier", "messageid", "msgid", "frameid"}
_OTHER_NAMES = {"identifier": "id", "payload": "data", "rawdata": "data", "length": "len", "datalengthcode": "dlc"}
_FULL = 8  # bytes of a classical frame
_BYTE = re.compile(r"(data|databyte|byte|db|b)\[?(\d{1,2})\]?")


def can_csv_separator(line: str) -> str:
    """Return the separator of a log of CAN frames in CSV with this first line; empty if it is another file.

    >>> can_csv_separator("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"), can_csv_separator("time,ID")
    (',', '')
    >>> can_csv_separator("Time;CAN ID (hex);Payload"), can_csv_separator("Vehicle ID,Length,Payload")
    (';', '')
    """
    for separator in (",", ";", "\t"):
        cells = line.split(separator)
        names, usual = set(column_names(cells)), set(map(_plain, cells))
        if not (names & _IDENTIFIERS and names & _DATA):
            continue
        # names that other tables may have as well need the time beside them
        is_usual = bool(usual & _IDENTIFIERS and usual & _DATA)
        is_sized = bool(names & _LENGTHS) and (is_usual or bool(names & _TIMES))
        is_own = bool(usual & {*_OWN, "arbitrationid"}) or sum(map(_is_byte, names)) >= _FULL
        if is_sized or (is_own and names & _TIMES):
            return separator
    return ""


def column_names(cells: list[str]) -> list[str]:
    """Return names of columns in lower case, without blanks and marks, by their usual names.

    Those of asammdf are without the name of the bus event, if no column but the time is of anything else.

    >>> column_names(["Time Stamp", "Data_Bytes"]), column_names(["timestamps", "CAN_DataFrame.CAN_DataFrame.ID"])
    (['timestamp', 'databytes'], ['timestamps', 'id'])
    >>> column_names(["CAN ID (hex)", "Length", "Byte 0", "Byte 1"])
    ['id', 'len', 'd0', 'd1']
    """
    names = list(map(_plain, cells))
    if len(names) > 1 and all(_PREFIX in name for name in names[1:]):
        return [name.rpartition(".")[2] for name in names]
    return _usual_names(names)


def _plain(cell: str) -> str:
    name = re.sub(r"[ _-]", "", cell.strip(' "\r\n\ufeff').casefold())
    return _SUFFIX.sub("", name)


def _is_byte(name: str) -> bool:
    return name[:1] == "d" and name[1:].isdecimal()


def _usual_names(names: list[str]) -> list[str]:
    """Return the usual names of columns; of bytes only if there are several."""
    bytes_of = [_BYTE.fullmatch(name) for name in names]
    several = {word for word, count in Counter(match[1] for match in bytes_of if match).items() if count > 1}
    usual = [
        f"d{int(match[2])}" if match and match[1] in several else "id" if name in _OWN else _OTHER_NAMES.get(name, name)
        for name, match in zip(names, bytes_of, strict=True)
    ]
    # a name that is already that of another column stays
    counts = Counter(usual)
    return [new if counts[new] == 1 else name for new, name in zip(usual, names, strict=True)]
