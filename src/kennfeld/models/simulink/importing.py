"""From a Simulink file to a model.

Fields of blocks that somebody names, "Torque/Gain1:Gain": whether there are such blocks and fields.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

from kennfeld.errors import Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.models.model import Model
from kennfeld.models.simulink.flattening.flat_model import FlatModel
from kennfeld.models.simulink.loaded_model import LoadedModel
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.models.simulink.model_import import ImportResult, ModelImport
from kennfeld.models.simulink.reader.model_tree import ModelBlock, System
from kennfeld.models.simulink.variables.model_variables import ParameterSource

__all__ = ["import_simulink", "simulink"]

_SHOWN = 8
_OF_THE_DRAWING = {"Position", "ZOrder", "Ports", "SID", "Name", "FontSize", "ShowName", "BackgroundColor"}


def check_promoted_fields(
    path: Path, names: Collection[str], system: System, flat: FlatModel, prefix: str
) -> list[Finding]:
    """A finding for each field that no block has; `prefix` is the path of the imported system."""
    return list(_misnamed(path, names, _blocks(system, flat, prefix))) if names else []


def _misnamed(path: Path, names: Collection[str], blocks: Mapping[str, ModelBlock]) -> Iterator[Finding]:
    for name in names:
        way, _, field = name.rpartition(":")
        block = blocks.get(way)
        if block is None:
            having = [path for path, one in blocks.items() if field in _fields(one)] or list(blocks)
            remedy = nearest(way, having) or f"Blocks that have one: {', '.join(having[:_SHOWN])}."
            yield Finding(path.name, f"there is no block {way}, whose {field} is named a parameter", remedy)
        elif block.chart is None and field not in (fields := _fields(block)):
            remedy = nearest(field, fields) or f"Its fields are {', '.join(list(fields)[:_SHOWN])}."
            yield Finding(f"{path.name} {way}", f"{block.type} has no field {field}", remedy)


def _blocks(system: System, flat: FlatModel, prefix: str) -> dict[str, ModelBlock]:
    """The blocks by their paths from where the import begins."""
    start = len(prefix) + 1 if prefix else 0
    found = {block.path[start:]: block for block in system.every()}
    return found | {atom.path: atom.block for atom in flat.atoms if not (atom.hidden or atom.made)}


def _fields(block: ModelBlock) -> dict[str, str]:
    """The fields of a block with what is written in them, those of its mask first."""
    masked = {one.name: one.expression for one in block.mask.parameters} if block.mask is not None else {}
    linked = dict(block.reference.parameters) if block.reference is not None else {}
    usual = dict(BLOCK_TYPES[block.type].defaults) if block.type in BLOCK_TYPES else {}
    found = {**masked, **linked, **usual, **block.defaults, **block.parameters}
    return {name: text for name, text in found.items() if name not in _OF_THE_DRAWING}


def simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[ParameterSource] = (),
    bind: Mapping[str, str] | None = None,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> Model:
    """The model in a Simulink file, or in one of its subsystems.

    `parameters` are files (.sldd, .mat, .m, calibration files), parameter sets or mappings that give values to the
    variables of the model; later ones win. `bind` replaces blocks by a channel or a formula over channels, by the path
    of the block, with ":2" for its second output alone. `promote` names fields of blocks whose literals become
    parameters, "Torque/Gain1:Gain"; a value given under such a name goes over the literal. Libraries are looked for
    beside the file and in `folders`. `step` in s takes the place of the model's own step.
    Raises `InputError` with every finding where an output cannot be built.
    """
    found = import_simulink(path, subsystem, parameters, bind, promote, folders, step)
    if found.model is None:
        name = Path(path).name
        raise InputError([Finding(f"{name} {one.place}", one.message, one.remedy) for one in found.report.findings])
    return found.model


def import_simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[ParameterSource] = (),
    bind: Mapping[str, str] | None = None,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> ImportResult:
    """As `simulink`, with a report of what became of every block, also where the model is not whole."""
    opened = LoadedModel.of(path, parameters, folders)
    system, scope, prefix = opened.system(subsystem)
    cuts = opened.cuts(bind or {}, prefix)
    work = ModelImport(opened, system, scope, cuts, frozenset(promote), step)
    if wrong := check_promoted_fields(opened.path, promote, system, work.flat, prefix):
        raise InputError(wrong)
    return work.imported()
