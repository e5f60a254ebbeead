"""A2L, the description of a control unit (ASAM MCD-2 MC, ASAP2): its labels, and their values in an image."""

from kennfeld.calfiles.a2l.objects import A2l, Described, summarise_labels
from kennfeld.calfiles.a2l.parser import parse_a2l
from kennfeld.calfiles.a2l.reader import read_parameters
from kennfeld.calfiles.a2l.writer import write_values

__all__ = ["A2l", "Described", "parse_a2l", "read_parameters", "summarise_labels", "write_values"]
