"""Recognition of logs of CAN frames in CSV by the names of their columns."""

_IDENTIFIERS = {"id", "arbitrationid"}
_LENGTHS = {"dlc", "datalength", "len"}
_DATA = {"databytes", "data", "d0", "d1"}
_PREFIX = "candataframe."


def can_csv_separator(line: str) -> str:
    """Return the separator of a log of CAN frames in CSV with this first line; empty if it is another file.

    >>> can_csv_separator("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"), can_csv_separator("time,ID")
    (',', '')
    """
    for separator in (",", ";", "\t"):
        names = set(column_names(line.split(separator)))
        if names & _IDENTIFIERS and names & _DATA and names & _LENGTHS:
            return separator
    return ""


def column_names(cells: list[str]) -> list[str]:
    """Return names of columns in lower case, without blanks and marks.

    Those of asammdf are without the name of the bus event, if no column but the time is of anything else.

    >>> column_names(["Time Stamp", "Data_Bytes"]), column_names(["timestamps", "CAN_DataFrame.CAN_DataFrame.ID"])
    (['timestamp', 'databytes'], ['timestamps', 'id'])
    """
    names = [cell.strip(' "\r\n').casefold().replace(" ", "").replace("_", "") for cell in cells]
    if len(names) > 1 and all(_PREFIX in name for name in names[1:]):
        return [name.rpartition(".")[2] for name in names]
    return names
