"""Formats that hold recordings as well as calibrations: workbooks and the data files of MATLAB."""

import struct

from kennfeld.files.file_format import CalibrationConverter, FileFormat, read_recording, starts_with
from kennfeld.files.foreign import OLE
from kennfeld.files.head import ZIP, FileHead

_SPREADSHEET = b"opendocument.spreadsheet"
_RICH = ("extrapolation", "bounds", "locks", "free axes")
_MAT_VERSIONS = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.")


def _is_excel(head: FileHead) -> bool:
    if head.raw.startswith(OLE):
        return True
    if head.members:
        # some tools of Windows separate folders by backslashes
        workbook = any(member.replace("\\", "/").startswith("xl/workbook") for member in head.members)
        return workbook or _SPREADSHEET in head.first_bytes("mimetype", 80)
    # the directory stands at the end of an archive: if it is cut off, only the parts at its beginning tell what it is
    is_damaged = head.raw.startswith(ZIP) and head.member == head.packing == ""
    # the name of the first member follows its header of 30 bytes
    return is_damaged and (b"xl/" in head.raw or head.raw[30:49] == b"[Content_Types].xml")


def _is_matlab(head: FileHead) -> bool:
    return head.raw.startswith(_MAT_VERSIONS) or (head.is_binary and _is_matlab_4(head.raw))


def _is_matlab_4(start: bytes) -> bool:
    """Return whether an array of MATLAB's version 4 begins here: that version has no signature."""
    for order in ("<", ">"):
        kind, rows, columns, imaginary, length = struct.unpack(f"{order}5i", start[:20].ljust(20, b"\0"))
        name = start[20 : 20 + max(length, 1)]
        sizes = rows >= 0 and columns >= 0 and imaginary in (0, 1) and 2 <= length <= 64
        # the type is MOPT in decimal: M byte order, O zero, P precision, T whether full, text or sparse
        if kind // 1000 == (order == ">") and kind % 1000 // 10 in range(6) and kind % 10 < 3 and sizes:
            return name.endswith(b"\0") and name[:-1].decode("latin-1").isidentifier()
    return False


EXCEL = FileFormat(
    "Excel",
    (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"),
    _is_excel,
    read_recording("excel", has_sheets=True, notes="`book.xlsx#Sheet` selects a sheet; see [below](#workbooks)"),
    CalibrationConverter(
        "kennfeld.calfiles.excel.reader:read_excel",
        "kennfeld.calfiles.excel.writer:write_excel",
        _RICH,
        endings=(".xlsx",),
        refuses=("missing values", "infinities"),
        notes="a workbook with one sheet per table; see [below](#excel)",
    ),
    holds_calibration="kennfeld.calfiles.excel.layout:holds_calibration",
)
_MAT_CONVERTER = CalibrationConverter(
    "kennfeld.calfiles.matlab_reader:read_mat",
    "kennfeld.calfiles.matlab_writer:write_mat",
    _RICH,
    notes="data files, versions 4 to 7.3; see [below](#matlab-1)",
)
MATLAB = FileFormat(
    "MATLAB data",
    (".mat",),
    _is_matlab,
    read_recording(
        "matlab",
        rasters=True,
        describes=True,
        label="MATLAB",
        notes="versions 4 to 7.3: vectors, matrices, structs, tables, timetables; see [below](#matlab)",
    ),
    _MAT_CONVERTER,
    holds_calibration="kennfeld.calfiles.matlab_reader:holds_calibration",
)
HDF5 = FileFormat(
    "HDF5",
    (".h5", ".hdf5", ".nc"),
    starts_with(b"\x89HDF\r\n"),
    read_recording(
        "hdf5",
        rasters=True,
        describes=True,
        label="HDF5 and netCDF 4",
        notes="also netCDF of version 4, and DataFrames of pandas; see [below](#hdf5-and-netcdf)",
    ),
    CalibrationConverter("kennfeld.calfiles.matlab_reader:read_mat"),
    holds_calibration="kennfeld.calfiles.matlab_reader:holds_calibration",
)
