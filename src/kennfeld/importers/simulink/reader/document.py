"""Simulink files of any layout, recognized by content and read to a `ModelDocument`.

A document holds the systems, and the settings of the whole model: solver, callbacks, workspace, dictionaries and block
defaults.
"""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.files.functions import CLASSIC, PART_BEGIN
from kennfeld.importers.simulink.reader.block_reader import BlockReader, read_mask
from kennfeld.importers.simulink.reader.chart_reader import read_charts
from kennfeld.importers.simulink.reader.model_package import (
    ModelPackage,
    is_zip,
    text_package,
    zip_package,
)
from kennfeld.importers.simulink.reader.model_tree import ModelDocument, StoredSolver, StoredWorkspace, System
from kennfeld.importers.simulink.reader.odd_files import EXTENSION_REMEDY, PROTECTED_MODEL, odd_file_error
from kennfeld.importers.simulink.reader.section_tree import (
    FileRejectedError,
    ReadDiagnostics,
    SectionNode,
    brace_sections,
    brace_text,
)

_CALLBACKS = (
    "PreLoadFcn", "PostLoadFcn", "InitFcn", "StartFcn", "PauseFcn", "ContinueFcn", "StopFcn", "PreSaveFcn",
    "PostSaveFcn", "CloseFcn", "SetupFcn", "CleanupFcn",
)  # fmt: skip
_SOLVER = "Simulink.SolverCC"
_DEFAULT_TYPE = "DefaultUnderspecifiedDataType"
_ELSEWHERE = "Simulink.ConfigSetRef"

# parts with the model workspace, and their kinds
_WORKSPACES: tuple[tuple[str, Literal["mxarray", "mat"]], ...] = (
    ("simulink/modelWorkspace.mxarray", "mxarray"), ("simulink/modelworkspace.mxarray", "mxarray"),
    ("simulink/modelWorkspace.mat", "mat"), ("simulink/modelworkspace.mat", "mat"),
)  # fmt: skip

_DIAGRAMS = ("Model", "Library", "Subsystem")
_HEAD = 65536
_ROOT = "simulink/blockdiagram.xml"
_NEW_ROOT = "simulink/blockDiagram.json"  # of R2026b and later, whose systems remain XML
_NEW_DIAGRAM = "BlockDiagram"
_FIRST_CONFIGURATION = "simulink/configSet0.xml"
_RELEASES = ("metadata/mwcoreProperties.xml", "metadata/mwcorePropertiesReleaseInfo.xml")
_MAX_BYTES = 1_000_000_000  # bytes


def setting(model: SectionNode, key: str) -> str:
    """Look up a setting of the model or of one of its groups of settings, "" if there is none."""
    # without systems and objects, in which the same keys belong to blocks and configurations
    groups = (model, *(part for part in model.parts if part.kind not in ("System", "Object", "Array")))
    return next((group.keys[key] for group in groups if key in group.keys), "")


def callbacks_of(model: SectionNode) -> dict[str, str]:
    """Collect the code of non-empty callbacks by name."""
    callbacks = {name: setting(model, name) for name in _CALLBACKS}
    return {name: code for name, code in callbacks.items() if code.strip()}


def read_block_defaults(*holders: SectionNode | None) -> dict[str, dict[str, str]]:
    """Collect the fields that a file specifies for all blocks of a type, by type."""
    defaults: dict[str, dict[str, str]] = {}
    for holder in holders:
        table = holder.first("BlockParameterDefaults") if holder is not None else None
        for block in table.all("Block") if table is not None else ():
            keys = {key: value for key, value in block.keys.items() if key != "BlockType"}
            defaults.setdefault(block.keys.get("BlockType", ""), {}).update(keys)
    return defaults


def active_configuration(model: SectionNode) -> SectionNode | None:
    """Find the active configuration stored in the model's section, else the first."""
    classes = ("Simulink.ConfigSet", _ELSEWHERE)
    sets = [part for part in model.every() if (part.keys.get("ClassName") or part.kind) in classes]
    # the property is the configuration itself, or an empty object with the number of the one meant
    properties = (p for p in (*sets, *model.every()) if p.keys.get("PropName") == "ActiveConfigurationSet")
    named = next(properties, None)
    full = [part for part in sets if part is not named or part.parts]
    number = named.keys.get("ObjectID") if named is not None else None
    active = next((part for part in full if number and part.keys.get("ObjectID") == number), None)
    return active or next(iter(full), None)


def read_solver(configuration: SectionNode | None, model: SectionNode) -> StoredSolver:
    """Read the solver of a configuration, or the model's own settings if there is none."""
    if configuration is None:
        return _solver(model.get) if any(key in model.keys for key in ("Solver", "StopTime")) else StoredSolver()
    elsewhere = next(configuration.classed(_ELSEWHERE), None)
    if elsewhere is not None:
        return StoredSolver(reference=elsewhere.get("SourceName") or elsewhere.get("WSVarName"))
    section = next(configuration.classed(_SOLVER), None)
    # the default type is among the settings for optimization
    stated = (part.get(_DEFAULT_TYPE) for part in configuration.every())
    kind = next(filter(None, stated), "") or model.get(_DEFAULT_TYPE)
    return replace(_solver((section if section is not None else model).get), default_type=kind)


def solver_from(entry: SectionNode) -> StoredSolver:
    """Read the solver of a configuration in a data dictionary, whose properties are sections."""
    section = next((part for part in entry.every() if part.keys.get("Class") in (_SOLVER, _ELSEWHERE)), entry)
    properties = {part.keys.get("Name", ""): part.text for part in section.all("P")}
    reference = properties.get("SourceName") or properties.get("WSVarName", "")
    stated = (part.text for part in entry.every() if part.kind == "P" and part.keys.get("Name") == _DEFAULT_TYPE)
    return replace(_solver(lambda key: properties.get(key, "")), reference=reference, default_type=next(stated, ""))


def _solver(get: Callable[[str], str]) -> StoredSolver:
    return StoredSolver(
        name=get("SolverName") or get("Solver"),
        fixed_step=get("FixedStep"),
        start=get("StartTime"),
        stop=get("StopTime"),
        max_step=get("MaxStep"),
        tasks=get("EnableMultiTasking") or get("SolverMode"),
    )


def read_workspace(model: SectionNode, stored: Callable[[], StoredWorkspace]) -> StoredWorkspace:
    """Locate the model workspace: code, another file, or what is `stored` in this one."""
    source = setting(model, "WSDataSource")
    code = setting(model, "WSMATLABCode") or setting(model, "WSMCode")
    if "Code" in source and code.strip():
        return StoredWorkspace("m-code", text=code)
    # "MATLAB Code" contains MAT, too: without code, it names no file
    name = setting(model, "WSSourceFileName") or setting(model, "WSDataSourceFile")
    if "MAT" in source and "Code" not in source and name:
        return StoredWorkspace("file", text=name)
    return stored()


def _workspace_package(package: ModelPackage) -> StoredWorkspace:
    for name, kind in _WORKSPACES:
        if raw := package.raw(name):
            return StoredWorkspace(kind, raw)
    return StoredWorkspace()


def _encoded(model: SectionNode, sections: list[SectionNode], diagnostics: ReadDiagnostics) -> StoredWorkspace:
    """Return the MatData record that the model names; four characters encode three bytes."""
    tag = setting(model, "WSMdlFileData")
    if not tag:
        return StoredWorkspace()
    record = _encoded_record(sections, tag)
    if record is None:
        diagnostics.warn(f"the model workspace is in {tag[:60]}, which the file does not contain")
        return StoredWorkspace()
    return record


def _encoded_record(sections: list[SectionNode], tag: str) -> StoredWorkspace | None:
    """Decode the binary record of a tag in a classic file, None if there is none."""
    records = [part for section in sections if section.kind == "MatData" for part in section.all("DataRecord")]
    record = next((part for part in records if part.keys.get("Tag") == tag), None)
    return StoredWorkspace("mxarray", _workspace_bytes(record.keys.get("Data", ""))) if record is not None else None


def _packed_record(package: ModelPackage, reference: str) -> StoredWorkspace | None:
    """Unpack the binary data of a reference such as `bdmxdata:DataTag0`, None if there is none."""
    tag = reference.rpartition(":")[2]
    if raw := package.raw(f"simulink/bdmxdata/{tag}.mxarray"):
        return StoredWorkspace("mxarray", raw)
    # before R2015b, one MAT-file holds all of them, as variables
    raw = package.raw("simulink/bdmxdata.mat")
    return StoredWorkspace("mat", raw, tag) if raw else None


def _workspace_bytes(text: str) -> bytes:
    """Decode 6-bit characters, offset by the blank; the back quote stands for the blank."""
    characters = np.frombuffer(text.encode("latin-1", "replace"), dtype=np.uint8)
    sixes = ((characters - 32) & 63).astype(np.uint32)
    # an incomplete group at the end of a truncated record is dropped
    sixes = sixes[: sixes.size // 4 * 4].reshape(-1, 4)
    # 24 bits of each group, the first character on top
    words = sixes[:, 0] << 18 | sixes[:, 1] << 12 | sixes[:, 2] << 6 | sixes[:, 3]
    return np.stack([words >> 16 & 255, words >> 8 & 255, words & 255], axis=1).astype(np.uint8).tobytes()


def read_document(path: str | Path) -> ModelDocument:
    """Read a `.slx` or `.mdl` file of any version.

    Unusual content is listed in the document's remarks.

    Raises:
        InputError: if the file is damaged, malicious, protected or not a Simulink file, with all findings.
    """
    path = Path(path)
    return document(_bytes(path), path)


def document(raw: bytes, path: Path) -> ModelDocument:
    """Read a model from bytes; `path` is only its name. Raises `InputError` like `read_document`."""
    diagnostics = ReadDiagnostics(path.name)
    packed = is_zip(raw) or PART_BEGIN.encode() in raw
    # latin-1 decodes any bytes; the encoding that the file names follows further down
    if not packed and not CLASSIC.match(raw[:_HEAD].removeprefix(b"\xef\xbb\xbf").decode("latin-1")):
        raise odd_file_error(raw, path)
    read, parse = None, _packed if packed else _classic
    with contextlib.suppress(FileRejectedError):
        read = parse(raw, path, diagnostics)
    diagnostics.raise_if_errors()
    if read is None:
        raise odd_file_error(raw, path)
    return replace(read, warnings=tuple(diagnostics.warnings))


def _bytes(path: Path) -> bytes:
    with convert_errors(path, "cannot be read"):
        if path.stat().st_size > _MAX_BYTES:
            message = f"is larger than {_MAX_BYTES / 1e6:.0f} MB, the limit for a model file"
            raise InputError.of(Location.of_file(path), message, "Check that this is the model file.")
        return path.read_bytes()


def _classic(raw: bytes, path: Path, diagnostics: ReadDiagnostics) -> ModelDocument | None:
    top = brace_sections(brace_text(raw.removeprefix(b"\xef\xbb\xbf")), diagnostics)
    model = next((section for section in top if section.kind in _DIAGRAMS), None)
    if model is None:
        return None
    stateflow = next((section for section in top if section.kind == "Stateflow"), None)
    charts = read_charts(stateflow, _no_part) if stateflow is not None else {}
    builder = BlockReader(diagnostics, _no_part, charts, read_block_defaults(model), partial(_encoded_record, top))
    solver = read_solver(active_configuration(model), model)
    version = model.get("Version")
    name = model.get("Name") or path.stem
    return _document(model, path, version, builder, solver, name, lambda: _encoded(model, top, diagnostics))


def _no_part(_: str) -> SectionNode | None:
    return None


def _packed(raw: bytes, path: Path, diagnostics: ReadDiagnostics) -> ModelDocument | None:
    package = zip_package(raw, diagnostics) if is_zip(raw) else text_package(raw, diagnostics)
    if diagnostics.errors:
        return None
    name = next((name for name in (_ROOT, _NEW_ROOT) if name in package), None)
    if name is None:
        raise _no_diagram(package, diagnostics)
    root = package.section(name)
    if root is None:
        return None
    model = root if root.kind in (*_DIAGRAMS, _NEW_DIAGRAM) else root.first(*_DIAGRAMS)
    if model is None:
        raise diagnostics.refuse(name, f"has no {', '.join(_DIAGRAMS[:-1])} or {_DIAGRAMS[-1]}", EXTENSION_REMEDY)
    return _of_package(package, model, path, diagnostics)


def _no_diagram(package: ModelPackage, diagnostics: ReadDiagnostics) -> FileRejectedError:
    names = list(package.names())
    if any("encrypted" in name.lower() or name.endswith(".slxp") for name in names):
        return diagnostics.refuse("", *PROTECTED_MODEL)
    if any(name.startswith("data/chunk") for name in names):
        return diagnostics.refuse("", "is a data dictionary, not a model", "Give it as parameters.")
    return diagnostics.refuse("", f"is not a Simulink model: part {_ROOT} is missing", EXTENSION_REMEDY)


def _of_package(package: ModelPackage, model: SectionNode, path: Path, diagnostics: ReadDiagnostics) -> ModelDocument:
    # the fields of the diagram take precedence, as they are read last
    defaults = read_block_defaults(package.section("simulink/bddefaults.xml"), model)
    stateflow = package.section("simulink/stateflow/machine.xml") or package.section("simulink/stateflow.xml")
    charts = read_charts(stateflow, partial(_part, package, "stateflow")) if stateflow is not None else {}
    data = partial(_packed_record, package)
    builder = BlockReader(diagnostics, partial(_part, package, "systems"), charts, defaults, data)
    configuration = _configuration(package)
    # a part of its own in newer packages, within the diagram in older ones
    solver = read_solver(configuration if configuration is not None else active_configuration(model), model)
    stored = partial(_workspace_package, package)
    document = _document(model, path, _release(package), builder, solver, path.stem, stored)
    return document if model.kind != _NEW_DIAGRAM else replace(document, kind=_kind_of(package))


def _kind_of(package: ModelPackage) -> Literal["model", "library", "subsystem"]:
    """Return the kind of file that the package specifies if the diagram does not."""
    core = package.section(_RELEASES[0])
    content = core.get("contentType").lower() if core is not None else ""
    return "library" if "library" in content else "subsystem" if "subsystem" in content else "model"


def _part(package: ModelPackage, folder: str, name: str) -> SectionNode | None:
    return package.section(f"simulink/{folder}/{name.removesuffix('.xml')}.xml")


def _configuration(package: ModelPackage) -> SectionNode | None:
    """Return the part of the active configuration, else the first."""
    info = package.section("simulink/configSetInfo.xml") or package.section("simulink/configSetInfo.json")
    named = list(info.all("ConfigSet", "ConfigSetInfo")) if info is not None else []
    active = next((part for part in named if part.keys.get("Active") in ("true", "on")), named[0] if named else None)
    name = active.keys.get("PartName", "").lstrip("/") if active is not None else _FIRST_CONFIGURATION
    return package.section(name)


def _release(package: ModelPackage) -> str:
    for name in _RELEASES:
        section = package.section(name)
        release = (section.get("matlabRelease") or section.get("release")) if section is not None else ""
        if release:
            return release.strip()
    return package.release


def _document(
    model: SectionNode,
    path: Path,
    version: str,
    builder: BlockReader,
    solver: StoredSolver,
    name: str,
    stored: Callable[[], StoredWorkspace],
) -> ModelDocument:
    kinds: dict[str, Literal["model", "library", "subsystem"]] = {"Library": "library", "Subsystem": "subsystem"}
    inner = model.first("System")
    root = builder.system(inner) if inner is not None else System()
    dictionary = setting(model, "DataDictionary")
    return ModelDocument(
        name=name,
        kind=kinds.get(model.kind, "model"),
        version=version,
        path=path,
        root=root,
        solver=solver,
        callbacks=callbacks_of(model),
        workspace=read_workspace(model, stored),
        dictionaries=(dictionary,) if dictionary else (),
        mask=read_mask(model) or (read_mask(inner) if inner is not None else None),
    )
