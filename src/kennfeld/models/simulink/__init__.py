"""Simulink files (`.slx`, `.mdl`, `.sldd`), read without MATLAB; nothing in a file is ever executed."""

from kennfeld.models.simulink.files.document import read_document, recognises_simulink
from kennfeld.models.simulink.files.libraries import Libraries, Resolved
from kennfeld.models.simulink.files.ports import ports_of
from kennfeld.models.simulink.outline import Outline, outline
from kennfeld.models.simulink.variables.data import Data, Entry
from kennfeld.models.simulink.variables.dictionary import Dictionary, read_dictionary
from kennfeld.models.simulink.variables.workspace import mat_variables, workspace_variables

__all__ = [
    "Data",
    "Dictionary",
    "Entry",
    "Libraries",
    "Outline",
    "Resolved",
    "mat_variables",
    "outline",
    "ports_of",
    "read_dictionary",
    "read_document",
    "recognises_simulink",
    "workspace_variables",
]
