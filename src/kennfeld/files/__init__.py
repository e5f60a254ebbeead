"""Recognition of files: one record per format, and the function that finds the record of a file.

`identify` tells the format of a file and what it is for. `FileFormat` is the record; packages add theirs by the entry
point `kennfeld.formats`.
"""

from kennfeld.base.errors import Location
from kennfeld.files.file_format import CalibrationConverter, FileFormat, MeasurementReader, Role
from kennfeld.files.head import FileHead
from kennfeld.files.identification import Identity, identify

__all__ = [
    "CalibrationConverter",
    "FileFormat",
    "FileHead",
    "Identity",
    "Location",
    "MeasurementReader",
    "Role",
    "identify",
]
