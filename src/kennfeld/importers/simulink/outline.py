"""Summary of a Simulink file: interface, blocks by type, solver, and sources of its numbers."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.block_ports import port_number
from kennfeld.importers.simulink.reader.document import read_document
from kennfeld.importers.simulink.reader.library_links import LibraryResolver, ResolvedModel, is_of_simulink
from kennfeld.importers.simulink.reader.model_tree import LibraryLink, ModelBlock, ModelDocument, StoredSolver, System
from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
from kennfeld.importers.simulink.variables.stored_variables import workspace_variables

_CONTROLS = {
    "EnablePort": "enabled",
    "TriggerPort": "triggered",
    "ActionPort": "if action",
    "ResetPort": "resettable",
    "ForIterator": "for",
    "ForEach": "for each",
    "WhileIterator": "while",
}
_OF_SIMULINK, _BUILT_IN, _MISSING = "Simulink", "built in", "not found"


@dataclass(frozen=True)
class Port:
    """A root input or output: name, and unit if the file specifies one."""

    name: str
    unit: str = ""


@dataclass(frozen=True)
class Subsystem:
    """A subsystem: path, kinds ("enabled", "masked", "Chart"), numbers of ports and blocks."""

    path: str
    kind: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    blocks: int


@dataclass(frozen=True)
class ExternalReference:
    """A referenced library block or model: number of uses, and the file it comes from; none if it is built in."""

    source: str
    type: str
    count: int
    found: str


@dataclass(frozen=True)
class DataSource:
    """A source of variables, described in words."""

    kind: str
    name: str
    content: str


@dataclass(frozen=True)
class ModelOutline:
    """Summary of a Simulink file; `problems` come from resolving links and reading dictionaries.

    `blocks` counts blocks by type, most frequent first, including resolved libraries and referenced models.
    """

    file: str
    name: str
    kind: str
    version: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    blocks: Mapping[str, int]
    subsystems: tuple[Subsystem, ...]
    solver: StoredSolver
    charts: tuple[tuple[str, str, int, int], ...]
    functions: tuple[tuple[str, int], ...]
    connections: tuple[ExternalReference, ...]
    sources: tuple[DataSource, ...]
    problems: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the summary as JSON-compatible containers."""
        charts = [dict(zip(("path", "kind", "states", "transitions"), chart, strict=True)) for chart in self.charts]
        functions = [{"path": path, "lines": lines} for path, lines in self.functions]
        texts = {"problems": [*map(str, self.problems)], "remarks": [*map(str, self.warnings)]}
        summary = {key: value for key, value in asdict(self).items() if key != "warnings"}
        return summary | {"charts": charts, "functions": functions} | texts


def summarize_model(path: str | Path, folders: Iterable[str | Path] = ()) -> ModelOutline:
    """Summarize a model without importing it.

    Args:
        path: the `.slx` or `.mdl` file.
        folders: folders to search for libraries in addition to the model's own.

    Raises:
        InputError: if the file itself cannot be read. Errors in referenced files are among the problems.
    """
    document = read_document(path)
    resolved = LibraryResolver(folders).resolve(document)
    dictionaries = [_read_dictionary(document, name) for name in document.dictionaries]
    root, every = resolved.document.root, list(resolved.document.root.every())
    return ModelOutline(
        file=document.path.name,
        name=document.name,
        kind=document.kind,
        version=document.version,
        inputs=_ports(root, "Inport"),
        outputs=_ports(root, "Outport"),
        blocks=dict(Counter(block.type for block in every).most_common()),
        subsystems=tuple(_subsystem(block, block.system) for block in every if block.system is not None),
        solver=document.solver,
        charts=tuple(
            (block.path, block.chart.kind, len(block.chart.states), len(block.chart.transitions))
            for block in every
            if block.chart is not None and not block.script
        ),
        functions=tuple((block.path, len(block.script.splitlines())) for block in every if block.script),
        connections=tuple(_connections(resolved)),
        sources=tuple(_sources(document, [source for source, _ in dictionaries])),
        problems=(*resolved.problems, *(finding for _, findings in dictionaries for finding in findings)),
        warnings=document.warnings,
    )


def _ports(system: System, kind: str) -> tuple[Port, ...]:
    """Return the ports of a system by number, without those for function calls."""
    # a port for function calls carries no values
    signals = [block for block in system.of(kind) if not block.is_set_to("OutputFunctionCall", "on")]
    ports = ((block.name, block.value("Unit") or "") for block in sorted(signals, key=port_number))
    return tuple(Port(name, "" if unit == "inherit" else unit) for name, unit in ports)


def _subsystem(block: ModelBlock, system: System) -> Subsystem:
    words = [block.value("SFBlockType") or "", "masked" if block.mask is not None else ""]
    words += ["model" if block.model else "", "atomic" if block.is_set_to("TreatAsAtomicUnit", "on") else ""]
    words += [_CONTROLS[inner.type] for inner in system.blocks if inner.type in _CONTROLS]
    kind = ", ".join(word for word in words if word not in ("", "NONE"))
    return Subsystem(block.path, kind, _names(system, "Inport"), _names(system, "Outport"), len(system.blocks))


def _names(system: System, kind: str) -> tuple[str, ...]:
    return tuple(port.name for port in _ports(system, kind))


def _connections(resolved: ResolvedModel) -> Iterator[ExternalReference]:
    counts: Counter[tuple[str, str]] = Counter()
    for block in resolved.document.root.every():
        if block.reference is not None:
            counts[block.reference.source, block.reference.type] += 1
        if block.model:
            counts[block.model, "model"] += 1
        if block.elsewhere:
            counts[block.elsewhere, "subsystem"] += 1
    for (source, kind), count in counts.most_common():
        yield ExternalReference(source, kind, count, _file_of(source, kind, resolved))


def _file_of(source: str, kind: str, resolved: ResolvedModel) -> str:
    alone = kind in ("model", "subsystem")
    if not alone and is_of_simulink(source):
        return _OF_SIMULINK
    name = source if alone else source.partition("/")[0]
    if name in resolved.files and source not in resolved.missing:
        return resolved.files[name].name
    return _BUILT_IN if not alone and _is_built_in(LibraryLink(source, kind, {})) else _MISSING


def _is_built_in(link: LibraryLink) -> bool:
    """Return True if the meaning of a block is known although its library is not at hand."""
    from kennfeld.importers.simulink import blocks  # noqa: F401  # all block types
    from kennfeld.importers.simulink.flattening.flatten import linked_type
    from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES, maskable_types

    known = BLOCK_TYPES.get(linked_type(link, maskable_types()))
    return known is not None and not known.refused


def _sources(document: ModelDocument, dictionaries: Iterable[DataSource]) -> Iterator[DataSource]:
    yield from _workspace(document)
    for name, code in document.callbacks.items():
        yield DataSource("callback", name, _first_line(code))
    yield from dictionaries
    masks = sum(len(block.mask.parameters) for block in document.root.every() if block.mask is not None)
    if masks:
        yield DataSource("masks", "", f"{masks} parameters")


def _workspace(document: ModelDocument) -> Iterator[DataSource]:
    workspace = document.workspace
    if workspace.kind == "m-code":
        yield DataSource("model workspace", "MATLAB code", _first_line(workspace.text))
    elif workspace.kind == "file":
        # a path out of the folder is not followed: the model may be a stranger's
        is_there = Path(workspace.text).name == workspace.text and (document.path.parent / workspace.text).is_file()
        place = "next to the model" if is_there else _MISSING
        yield DataSource("model workspace", workspace.text, place)
    elif workspace.kind != "none":
        data = workspace_variables(workspace)
        unread = f", unreadable: {', '.join(data.unreadable)}" if any(data.unreadable) else ""
        unread = unread or (f", {data.unreadable['']}" if data.unreadable else "")
        yield DataSource("model workspace", "in the file", f"{len(data.entries)} variables{unread}")


def _read_dictionary(document: ModelDocument, name: str) -> tuple[DataSource, tuple[Finding, ...]]:
    """Return the summary of a data dictionary, and why it cannot be read."""
    path = document.path.parent / name
    content = _MISSING
    findings: tuple[Finding, ...] = ()
    # as above, nothing outside of the folder is opened
    if Path(name).name == name and path.is_file():
        try:
            data = read_dictionary(path).data
            unread = f", unreadable: {', '.join(data.unreadable)}" if data.unreadable else ""
            content = f"{len(data.entries)} variables{unread}"
        except InputError as error:
            content, findings = "unreadable", error.findings
    return DataSource("data dictionary", name, content), findings


def _first_line(code: str) -> str:
    """Return the first non-empty line of code, and the number of lines."""
    lines = [line.strip() for line in code.splitlines() if line.strip()]
    more = f" ... ({len(lines)} lines)" if len(lines) > 1 else ""
    return (lines[0][:80] if lines else "") + more
