"""The record of the importer of ASCET projects."""

from kennfeld.files.calibrations import AMD, ESDL
from kennfeld.files.functions import APPLICATION
from kennfeld.models.importer import DroppedFiles, Importer

IMPORTER = Importer(
    "an ASCET project",
    (ESDL, APPLICATION, AMD),
    imports="kennfeld.importers.ascet.importing:import_requested",
    keys=("class_name", "methods", "startup", "task", "folders", "limit_assignments"),
    shared_keys=("folders",),
    describes=(
        (ESDL, "kennfeld.importers.ascet.file_info:describe_esdl"),
        (APPLICATION, "kennfeld.importers.ascet.file_info:describe_esdl"),
        (AMD, "kennfeld.importers.ascet.file_info:describe_components"),
    ),
    heading="kennfeld.importers.ascet.importing:heading",
    screen="program",
    view="kennfeld.importers.ascet.page:view",
    dropped=DroppedFiles(
        "kennfeld.importers.ascet.dropped_files:place_by_package",
        "kennfeld.importers.ascet.dropped_files:main_program",
        "kennfeld.importers.ascet.dropped_files:program_files",
    ),
)
