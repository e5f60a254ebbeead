"""Files of a project that supply what an import lacks: variables without a value, and files that were not found."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from kennfeld.base.errors import Location
from kennfeld.base.formatting import join_names
from kennfeld.base.output_paths import file_name
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.import_report import VariableFile
from kennfeld.importers.simulink.reader.model_tree import split_path
from kennfeld.importers.simulink.reader.project_files import ProjectFiles
from kennfeld.importers.simulink.variables.assigned_names import DATA_ENDINGS, AssignedNames, defines
from kennfeld.importers.simulink.variables.file_search import FileSearch

_MAX_PROPOSALS = 10  # files with values
_MAX_OTHERS = 3  # files that define the same


def propose_files(
    model: Path,
    search: FileSearch,
    undefined: Collection[str],
    failures: Mapping[str, Location],
    missing_files: Mapping[str, str],
) -> tuple[VariableFile, ...]:
    """Return the files that define variables or are missing, those that define most variables first.

    Nothing is run or loaded: scripts are parsed, and of data files the names are read.

    Args:
        model: the model's file.
        search: where the import has searched.
        undefined: the variables without a value; fields of structs as `a.b`.
        failures: by variable, where scripts could not assign it a value.
        missing_files: files that were not found, with what needs them; libraries and models without extension.
    """
    if not undefined and not missing_files:
        return ()
    files = ProjectFiles.around(model, search.folders)
    names = AssignedNames(undefined, search, model.parent)
    needed = [
        replace(proposal, names=_supplied(proposal.path, names, undefined, failures))
        for proposal in _locate(files, missing_files)
    ]
    given = {path.absolute() for path in search.given if path.suffix.casefold() in DATA_ENDINGS}
    # other files do not replace what those in use fail to compute
    settled = {name for path in given for name in _supplied(path, names, undefined, failures)}
    settled |= {name for proposal in needed for name in proposal.names}
    open_names = tuple(name for name in undefined if name not in settled)
    candidates = [path for path in files.ending(*DATA_ENDINGS) if path not in given] if open_names else []
    supplied = {path: _supplied(path, names, open_names, failures) for path in candidates}
    chosen = _in_folders(_smallest_choice(supplied), names.classes)
    return tuple(sorted((*needed, *chosen), key=lambda proposal: -len(proposal.names)))


def missing_links(failed: Iterable[FlatBlock]) -> dict[str, str]:
    """Return the libraries, models and subsystem files that blocks link to in vain, with the paths of the blocks."""
    paths: dict[str, list[str]] = {}
    for flat in failed:
        block = flat.block
        if block.searched:
            link = (split_path(block.reference.source) or ("",))[0] if block.reference is not None else ""
            paths.setdefault(block.elsewhere or block.model or link, []).append(flat.path)
    return {name: join_names(users, 1) for name, users in paths.items()}


def _locate(files: ProjectFiles, missing_files: Mapping[str, str]) -> Iterator[VariableFile]:
    """Yield the missing files that the project has in other folders; what the user passes are these folders."""
    for name, source in missing_files.items():
        plain = file_name(name)
        path = next(iter(files.named([plain] if "." in plain else [f"{plain}.slx", f"{plain}.mdl"])), None)
        if path is not None:
            yield VariableFile(path, "folders", needed_by=source)


def _supplied(
    path: Path, names: AssignedNames, undefined: Collection[str], failures: Mapping[str, Location]
) -> tuple[str, ...]:
    """Return the variables that a file would define; not those that it has been run for in vain."""
    assigned = names.of(path)
    failed = {name for name, place in failures.items() if place.file == path.name}
    return tuple(name for name in undefined if name not in failed and defines(assigned, name))


def _smallest_choice(supplied: Mapping[Path, tuple[str, ...]]) -> Iterator[VariableFile]:
    """Yield the file that defines most variables, then the one that defines most of the others, and so on."""
    left = {path: names for path, names in supplied.items() if names}
    for _ in range(_MAX_PROPOSALS):
        # of several that define the same number, the nearest one
        path = max(left, key=lambda path: len(left[path]), default=None)
        if path is None:
            return
        names = left[path]
        others = tuple(other for other in left if other != path and set(left[other]) >= set(names))
        yield VariableFile(path, "parameters", names, others=others[:_MAX_OTHERS])
        rest = {other: tuple(name for name in left[other] if name not in names) for other in left}
        left = {other: remaining for other, remaining in rest.items() if remaining}


def _in_folders(proposals: Iterable[VariableFile], classes: Collection[Path]) -> Iterator[VariableFile]:
    """Yield proposals with one for all classes of a folder, since a model finds classes by their folder."""
    folders: dict[Path, list[VariableFile]] = {}
    for proposal in proposals:
        if proposal.path in classes:
            folders.setdefault(proposal.path.parent, []).append(proposal)
        else:
            yield proposal
    for several in folders.values():
        yield VariableFile(several[0].path, "folders", tuple(name for each in several for name in each.names))
