"""The error for a file that a library cannot read; libraries trust what they read, and fail in many ways."""

from kennfeld.base.errors import InputError
from kennfeld.base.formatting import reason_of
from kennfeld.measurement.source import MeasurementFile


def damaged(
    source: MeasurementFile, kind: str, error: Exception, remedy: str = "Copy or export it again."
) -> InputError:
    """Return the error for a damaged file of a kind, with what a library says of it."""
    return InputError.of(source.location, f"the {kind} file is damaged or cut off ({reason_of(error)})", remedy)
