"""Measurement files: one reader a format, found by content."""

from kennfeld.measurement.description import ChannelDescription, Description, TableDescription, TimeDescription
from kennfeld.measurement.reader import describe, read

__all__ = ["ChannelDescription", "Description", "TableDescription", "TimeDescription", "describe", "read"]
