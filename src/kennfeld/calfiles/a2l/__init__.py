"""A2L, the description of a control unit (ASAM MCD-2 MC, ASAP2): its labels, and their values in an image."""

from kennfeld.calfiles.a2l.objects import A2l, Described, described
from kennfeld.calfiles.a2l.parser import parse_a2l
from kennfeld.calfiles.a2l.reader import read_parameters
from kennfeld.calfiles.a2l.writer import stored

__all__ = ["A2l", "Described", "described", "parse_a2l", "read_parameters", "stored"]
