"""A model file that has been read, with links resolved and variables collected."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.flattening.active_blocks import active_content
from kennfeld.importers.simulink.flattening.flat_model import FlatModel
from kennfeld.importers.simulink.flattening.flatten import flatten, standalone_system
from kennfeld.importers.simulink.lowering.registry import maskable_types, opaque_mask_types
from kennfeld.importers.simulink.open_signals import with_open_ends, with_ports_of_only_block
from kennfeld.importers.simulink.reader.document import read_document
from kennfeld.importers.simulink.reader.library_links import LibraryResolver
from kennfeld.importers.simulink.reader.model_tree import ModelBlock, ModelDocument, System, join_path, split_path
from kennfeld.importers.simulink.variables.file_search import FileSearch
from kennfeld.importers.simulink.variables.m_files import FunctionFiles
from kennfeld.importers.simulink.variables.mask_scope import Scope, Variable, VariableTable
from kennfeld.importers.simulink.variables.model_variables import (
    ParameterSource,
    collect_variables,
    model_properties,
)
from kennfeld.models.imperative.evaluation_errors import EvaluationError


@dataclass(frozen=True)
class LoadedModel:
    """A model file with its links resolved.

    `models` are the names that referenced models see; `files` are function files next to the model that code may call;
    `search` finds the files of variables.
    """

    path: Path
    document: ModelDocument
    variables: VariableTable
    models: Mapping[str, Scope]
    remarks: tuple[Finding, ...]
    files: FunctionFiles
    search: FileSearch

    @staticmethod
    def of(
        path: str | Path, parameters: Iterable[ParameterSource] = (), folders: Iterable[str | Path] = ()
    ) -> "LoadedModel":
        """Read a file and collect its variables; raise `InputError` if it cannot be read."""
        parameters, folders = tuple(parameters), tuple(folders)
        resolved = LibraryResolver(folders).resolve(read_document(path))
        document, only = with_ports_of_only_block(resolved.document)
        named = tuple(Path(source) for source in parameters if isinstance(source, str | Path))
        search = FileSearch(tuple(map(Path, folders)), named)
        variables = collect_variables(document, parameters, search)
        models = {
            name: Scope(_visible_variables(document, variables, search)) for name, document in resolved.models.items()
        }
        remarks = (*document.warnings, *resolved.problems, *variables.findings, *_alone(only))
        variables.update(model_properties(document, variables))
        files = FunctionFiles([Path(path).parent, *map(Path, folders)], named)
        return LoadedModel(Path(path), document, variables, models, remarks, files, search)

    def cuts(self, bind: Mapping[str, str], prefix: str) -> dict[str, str]:
        """Return the formulas of bound blocks by path within the imported system, whose path is `prefix`."""
        for key, text in bind.items():
            if not key.strip() or not text.strip():
                location, message = Location(self.path.name, path="bind"), f'"{key}" = "{text}" is empty'
                raise InputError.of(location, message, 'Write "path" = "channel or formula".')
        return {key.removeprefix(f"{prefix}/") if prefix else key: text for key, text in bind.items()}

    def system(self, subsystem: str | None) -> tuple[System, Scope, str]:
        """Return the system at a path, its scope and its full path; raise `InputError` if there is none."""
        document, scope = self.document, Scope(self.variables)
        if not subsystem:
            return document.root, scope, ""
        system, names = document.root, split_path(subsystem)
        # the path may begin with the name of the model
        names = names[1:] if names and names[0] == document.name and names[0] not in system.by_name else names
        block: ModelBlock | None = None
        for name in names:
            block = system.by_name.get(name)
            if block is None or block.system is None:
                known = [b.path for b in document.root.every() if b.system is not None]
                remedy = nearest(subsystem, known) or f"Its subsystems: {', '.join(known[:8])}."
                raise InputError.of(Location(document.path.name), f"unknown subsystem {subsystem}", remedy)
            if block.chart is not None:
                return standalone_system(block, block.system), scope, join_path(*names[:-1])
            scope, system = scope.inside(block, self.models), block.system
        assert block is not None
        try:
            return active_content(block, scope), scope, block.path
        except EvaluationError as error:
            raise InputError.of(Location(document.path.name, path=block.path), str(error)) from None

    def flat(
        self,
        system: System,
        scope: Scope,
        cuts: Mapping[str, str] = MappingProxyType({}),
        counts: Mapping[str, int] = MappingProxyType({}),
    ) -> FlatModel:
        """Flatten one of its systems; raise `InputError` if it has too many blocks."""
        try:
            flat = flatten(system, scope, cuts, opaque_mask_types(), self.models, maskable_types(), counts)
        except OverflowError as error:
            raise InputError.of(Location(self.path.name), str(error)) from None
        # the blocks of a library do not belong together
        is_library = system is self.document.root and self.document.kind == "library"
        return flat if is_library else with_open_ends(flat)


def _alone(path: str) -> Iterator[Finding]:
    if path:
        message = "it is the only block and not connected: its ports are the inputs and outputs"
        yield Finding(Location(path=path), message, severity="remark")


def _visible_variables(document: ModelDocument, around: VariableTable, search: FileSearch) -> dict[str, Variable]:
    """Return the names that a referenced model sees: its own before those of the parent model.

    Values of calibration files replace its own unless the parent model has a variable of that name.
    """
    own = collect_variables(document, (around.strangers,), search)
    return {**around, **own, **model_properties(document, own)}
