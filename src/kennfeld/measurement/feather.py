"""Reader of Feather files, which hold Arrow tables as they are in memory, and of Arrow streams."""

from typing import Any, BinaryIO

import numpy as np

from kennfeld.base.errors import InputError
from kennfeld.measurement.arrow_columns import column_of, header_of, is_numeric, text_column
from kennfeld.measurement.damage import damaged
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection, Table

_FILE = b"ARROW1"


def read_tables(source: MeasurementFile, selection: Selection) -> list[Table]:
    """Return the one table of a Feather file or an Arrow stream."""
    import pyarrow as pa

    try:
        with source.path.open("rb") as stream:
            # the schema alone first, so that columns of text are never loaded
            schema = _open(stream, []).schema
            header = header_of(schema)
            asked = selection.wants(header)
            numeric = [i for i in asked if is_numeric(schema.field(i).type)]
            # without numbers, any column tells the number of rows
            read = _open(stream, numeric or [0]).read_all()
            # offsets of a damaged file may lead out of its buffers
            read.validate(full=True)
            count = read.num_rows
            columns = [column_of(read.column(at), header, i) for at, i in enumerate(numeric)]
            texts = [text_column(schema, header, i, count) for i in asked if i not in numeric]
    except (pa.ArrowException, OSError, ValueError, MemoryError, OverflowError, KeyError) as error:
        raise damaged(source, "Feather", error, "Copy or write it again.") from None
    if not count:
        raise InputError.of(source.location, "holds no rows", "Is it the right file?")
    rows = np.arange(1, count + 1)
    return [Table(source.location, (*columns, *texts), rows, row_word="row", names=header.names)]


def _open(stream: BinaryIO, fields: list[int]) -> Any:
    """Return the reader of these fields, of all if there are none."""
    from pyarrow import ipc

    options = ipc.IpcReadOptions(included_fields=fields)
    stream.seek(0)
    is_file = stream.read(len(_FILE)) == _FILE
    stream.seek(0)
    return (ipc.open_file if is_file else ipc.open_stream)(stream, options=options)
