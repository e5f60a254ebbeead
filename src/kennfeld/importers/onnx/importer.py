"""The record of the importer of ONNX networks."""

from kennfeld.files.functions import ONNX
from kennfeld.models.importer import Importer

IMPORTER = Importer(
    "an ONNX network",
    (ONNX,),
    reads="kennfeld.importers.onnx.importing:read_function",
    describes=((ONNX, "kennfeld.importers.onnx.network_info:describe_network"),),
    facts="kennfeld.importers.onnx.network_info:facts",
)
