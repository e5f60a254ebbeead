"""The record of the importer of functions in C."""

from kennfeld.files.functions import C
from kennfeld.models.importer import Importer

IMPORTER = Importer(
    "a C file",
    (C,),
    reads="kennfeld.importers.c.importing:read_function",
    reads_options=True,
    keys=("target", "float32"),
    shared_keys=("target", "float32"),
    named=True,
    lists="kennfeld.importers.c.importing:list_functions",
    is_text=True,
)
