"""Databases of a bus as AUTOSAR (.arxml), Kayak (.kcd) and PEAK (.sym) write them, converted to DBC by canmatrix."""

import io

from kennfeld.base.errors import InputError, Location
from kennfeld.base.formatting import reason_of
from kennfeld.base.optional_packages import optional_package
from kennfeld.base.quiet_loggers import quiet_loggers
from kennfeld.measurement.peak_symbols import with_whole_signals


def to_dbc(file: str, content: bytes, kind: str) -> tuple[list[str], list[str]]:
    """Return a database for each bus of a file, as the text of a DBC file, and what the library could not read.

    Args:
        file: its name in messages.
        content: its bytes.
        kind: `arxml`, `kcd` or `sym`.

    Raises:
        InputError: it is damaged, or the package that reads it is missing.
    """
    location = Location(file)
    with optional_package(location, "bus"):
        import canmatrix.formats
    try:
        content, problems = with_whole_signals(content) if kind == "sym" else (content, [])
        with quiet_loggers("canmatrix"):
            buses = canmatrix.formats.loads(content, import_type=kind, encoding="utf-8")
            problems += [reason_of(error) for matrix in buses.values() for error in matrix.load_errors]
            return [_written(matrix) for matrix in buses.values() if len(matrix.frames)], problems
    except Exception as error:  # of many kinds: the library trusts what it reads
        message = f"the database ({kind}) cannot be read ({reason_of(error)})"
        raise InputError.of(location, message, "Export it again, or convert it to DBC.") from None


def _written(matrix: object) -> str:
    import canmatrix.formats

    stream = io.BytesIO()
    canmatrix.formats.dump(matrix, stream, "dbc", dbcExportEncoding="utf-8")
    return stream.getvalue().decode("utf-8", "replace")
