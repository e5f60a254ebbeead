"""The record of the importer of Simulink models."""

from kennfeld.files.functions import DICTIONARY, ENUMERATION, PROTECTED, SIMULINK
from kennfeld.models.importer import Importer

IMPORTER = Importer(
    "a Simulink model",
    (SIMULINK, PROTECTED),
    imports="kennfeld.importers.simulink.importing:import_requested",
    keys=("subsystem", "parameters", "bind", "folders", "float32"),
    describes=(
        (SIMULINK, "kennfeld.importers.simulink.file_info:describe_simulink"),
        (PROTECTED, "kennfeld.importers.simulink.file_info:describe_simulink"),
        (DICTIONARY, "kennfeld.importers.simulink.file_info:describe_dictionary"),
        (ENUMERATION, "kennfeld.importers.simulink.file_info:describe_enumeration"),
    ),
    updates=((DICTIONARY, "kennfeld.importers.simulink.variables.dictionary_update:update_dictionary"),),
    export="kennfeld.importers.simulink.formula_export:formula_lines",
    heading="kennfeld.importers.simulink.formula_export:heading",
    screen="diagram",
    view="kennfeld.importers.simulink.page:view",
    parts="kennfeld.importers.simulink.page:parts",
)
