"""Refuses files that claim more values than they can hold, before any memory is asked for."""

from kennfeld.base.errors import InputError
from kennfeld.base.process_limits import memory_bound
from kennfeld.measurement.source import MeasurementFile

_VALUE = 8  # bytes of a double


def check_claimed(source: MeasurementFile, values: int, size: int | None = None) -> None:
    """Refuse more values than a file can hold.

    Args:
        source: the file.
        values: the number of values of all channels that are read.
        size: bytes of the file with those that belong to it; by default its own.
    """
    size = source.stored_size() if size is None else size
    if _VALUE * values > memory_bound(size):
        message = f"the file is damaged: it claims {values} values in {size / 1e6:.3g} MB"
        raise InputError.of(source.location, message, "Copy or export it again.")
