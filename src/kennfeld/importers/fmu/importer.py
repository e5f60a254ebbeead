"""The record of the importer of FMUs."""

from kennfeld.files.functions import FMU
from kennfeld.models.importer import Importer

IMPORTER = Importer(
    "an FMU",
    (FMU,),
    reads="kennfeld.importers.fmu.importing:read_fmu",
    imports="kennfeld.importers.fmu.importing:import_fmu",
    keys=("outputs",),
    choices=("co-simulation", "model-exchange"),
    runs=True,
    describes=((FMU, "kennfeld.importers.fmu.fmu_info:describe_fmu"),),
    facts="kennfeld.importers.fmu.fmu_info:facts",
)
