"""Measurement files: one reader per format, selected by content."""

from kennfeld.measurement.reader import describe, read
from kennfeld.measurement.table_conversion import ChannelDescription, Description, TableDescription, TimeDescription

__all__ = ["ChannelDescription", "Description", "TableDescription", "TimeDescription", "describe", "read"]
