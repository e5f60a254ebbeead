"""Public entry of the Simulink import."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import nearest
from kennfeld.base.garbage_collection import no_collection
from kennfeld.importers.simulink.flattening.flat_model import FlatModel
from kennfeld.importers.simulink.loaded_model import LoadedModel
from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.importers.simulink.model_import import ModelImport, SimulinkImport
from kennfeld.importers.simulink.reader.model_tree import ModelBlock, System
from kennfeld.importers.simulink.variables.model_variables import ParameterSource
from kennfeld.models.importer import ImportRequest
from kennfeld.models.model import Model

_MAX_LISTED = 8
_DRAWING_FIELDS = {"Position", "ZOrder", "Ports", "SID", "Name", "FontSize", "ShowName", "BackgroundColor"}


def simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[ParameterSource] = (),
    bind: Mapping[str, str] | None = None,
    *,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
    float32: bool = False,
) -> Model:
    """Import a Simulink model or one of its subsystems.

    Args:
        path: the `.slx` or `.mdl` file.
        subsystem: path of the subsystem to import; None for the whole model.
        parameters: files (`.sldd`, `.mat`, `.m`, calibration files), parameter sets or mappings that give values to the
            variables of the model; later ones take precedence.
        bind: channels or formulas that replace blocks, by block path; append ":2" for the second output alone.
        promote: block fields such as "Torque/Gain1:Gain" whose literals become parameters. A value of that name in
            `parameters` replaces the literal.
        folders: folders to search for libraries, dictionaries and classes in addition to the model's own.
        step: time step in s that replaces the one of the model.
        float32: round signals of type single to single precision, as generated code does.

    Returns:
        The model.

    Raises:
        InputError: if an output is not supported, with all findings.

    >>> model = simulink("engine.slx", parameters=[{"Slope": 2.0}])
    >>> model.graph.inputs, model.graph.outputs, model.values["Slope"].value
    (('n',), ('y',), 2.0)
    """
    imported = import_simulink(
        path, subsystem, parameters, bind, promote=promote, folders=folders, step=step, float32=float32
    )
    return imported.require_model()


@no_collection()  # a large model is millions of objects, of which few are given back before the end
def import_simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[ParameterSource] = (),
    bind: Mapping[str, str] | None = None,
    *,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
    float32: bool = False,
) -> SimulinkImport:
    """Import a Simulink model and report on every block; the model is None if an output is not supported.

    The arguments are those of `simulink`.

    Returns:
        The model, or None, and a report.

    Raises:
        InputError: if the file cannot be read, or `subsystem`, `bind` or `promote` names something unknown.

    >>> result = import_simulink("engine.slx", parameters=[{"Slope": 2.0}])
    >>> result.model is not None, result.report.total
    (True, 4)
    """
    loaded = LoadedModel.of(path, parameters, folders)
    system, scope, prefix = loaded.system(subsystem)
    cuts = loaded.cuts(bind or {}, prefix)
    model_import = ModelImport(loaded, system, scope, cuts, frozenset(promote), step, float32)
    blocks = _blocks(system, model_import.flat, prefix) if promote else {}
    if misnamed := list(_find_misnamed(loaded.path, promote, blocks)):
        raise InputError(misnamed)
    return model_import.run()


Arguments = tuple[
    Path, str | None, list[ParameterSource], dict[str, str], list[str], tuple[Path, ...], float | None, bool
]  # of `simulink`


def import_requested(request: ImportRequest) -> SimulinkImport:
    """Import what a project or a command names."""
    path, part, parameters, bind, promote, folders, step, float32 = arguments_of(request)
    return import_simulink(path, part, parameters, bind, promote=promote, folders=folders, step=step, float32=float32)


def arguments_of(request: ImportRequest) -> Arguments:
    """Return the arguments of `simulink`; values of the project override those of the files of variables.

    Literals of blocks that the project names, such as `Torque/Gain1:Gain`, become parameters.
    """
    options, initial = request.options, [] if request.initial is None else [request.initial]
    own = {name: np.asarray(value) for name, value in request.values if value is not None}
    sources: list[ParameterSource] = [*options.parameters, *initial, own]
    promoted = [name for name, _ in request.values if ":" in name]
    part, bound = options.subsystem or None, dict(options.bind)
    return request.path, part, sources, bound, promoted, options.folders, options.step, options.float32


def _find_misnamed(path: Path, names: Collection[str], blocks: Mapping[str, ModelBlock]) -> Iterator[Finding]:
    """Yield a finding for each promoted field that no block has."""
    for name in names:
        field_path, _, field = name.rpartition(":")
        block = blocks.get(field_path)
        if block is None:
            candidates = [path for path, block in blocks.items() if field in _fields(block)] or list(blocks)
            listed = f"Blocks with this field: {', '.join(candidates[:_MAX_LISTED])}."
            message = f"unknown block {field_path} (field {field} to promote to a parameter)"
            yield Finding(Location(path.name), message, nearest(field_path, candidates) or listed)
        elif block.chart is None and field not in (fields := _fields(block)):
            remedy = nearest(field, fields) or f"Its fields: {', '.join(list(fields)[:_MAX_LISTED])}."
            yield Finding(Location(path.name, path=field_path), f"{block.type} has no field {field}", remedy)


def _blocks(system: System, flat: FlatModel, prefix: str) -> dict[str, ModelBlock]:
    """Return the blocks by path from the imported system."""
    start = len(prefix) + 1 if prefix else 0
    blocks = {block.path[start:]: block for block in system.every()}
    return blocks | {b.path: b.block for b in flat.blocks if not (b.hidden or b.synthetic)}


def _fields(block: ModelBlock) -> dict[str, str]:
    """Return the fields of a block as written, those of its mask first."""
    masked = {p.name: p.expression for p in block.mask.parameters} if block.mask is not None else {}
    linked = dict(block.reference.parameters) if block.reference is not None else {}
    usual = dict(BLOCK_TYPES[block.type].defaults) if block.type in BLOCK_TYPES else {}
    fields = {**masked, **linked, **usual, **block.defaults, **block.parameters}
    return {name: text for name, text in fields.items() if name not in _DRAWING_FIELDS}
