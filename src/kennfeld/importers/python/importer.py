"""The record of the importer of functions in Python."""

from kennfeld.files.functions import PYTHON
from kennfeld.models.importer import Importer

IMPORTER = Importer(
    "a Python file",
    (PYTHON,),
    reads="kennfeld.importers.python.importing:read_function",
    wraps="kennfeld.importers.python.importing:python_function",
    named=True,
    runs=True,
    translated=True,
    lists="kennfeld.importers.python.importing:list_functions",
    digest="kennfeld.importers.python.loaded_files:digest_of_loaded",
    companions="kennfeld.importers.python.loaded_files:files_loaded_by",
    is_text=True,
)
