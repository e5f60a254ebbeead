"""Files that are dropped onto the page: what they are decides what becomes of them in the project."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from kennfeld.app.folders import confined
from kennfeld.app.session.function_source import ImportSource, completed_reference, has_no_functions
from kennfeld.app.session.initial_files import holds_variables
from kennfeld.app.session.project_function import function_reference
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetKeys
from kennfeld.base.errors import ArgumentError, Findings, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.calibrations import IMAGE_ENDINGS
from kennfeld.files.file_format import Role, call
from kennfeld.files.identification import identify
from kennfeld.models.function_files import split_reference
from kennfeld.models.importer import DroppedFiles, Importer
from kennfeld.models.importer_registry import importer_of


@dataclass(frozen=True)
class AddedFiles:
    """Files of the folder."""

    files: Sequence[str]


@dataclass(frozen=True)
class FileKinds:
    """The role of each file in the project."""

    kinds: Mapping[str, str]


def add_files(session: Session, asked: AddedFiles) -> FileKinds:
    """Add files of the folder to the project, as one change: recordings, a function, or initial values.

    Files with variables of a Simulink model go to `[model] parameters`, as their arrays may be axes of its tables.
    CAN databases decode the recordings that come with them; alone, those of all datasets.
    Where several files make up a function, as in ASCET projects, they are moved to where the import searches them; if
    the function is of this kind already, they only add to it.
    """
    folder = session.path.parent
    names = [confined(folder, name).relative_to(folder.resolve()).as_posix() for name in asked.files]
    if not names:
        raise ArgumentError("no file is chosen")
    settings = session.settings
    placed = _place(session, names)
    kinds = kinds_of(folder, [name for moved in placed.values() for name in moved])
    function = _function(folder, kinds)
    variables = _variables(session, kinds, str(function[0][1]) if function else "")
    changes = [*_datasets(settings, kinds), *function, *_parameters(settings, variables)]
    changes += _initial(settings, {name: kind for name, kind in kinds.items() if name not in variables})
    changes += _assembled(session, placed)
    if changes:
        session.do(SetKeys(f"Added {', '.join([*kinds][:3])}", session.path.name, changes))
    if any(placed) or Role.COMPANION.value in kinds.values():
        session.refresh()  # packages or included files that were missing
    return FileKinds(kinds)


def _place(session: Session, names: list[str]) -> dict[Importer | None, list[str]]:
    """Return files by the importer that has moved them, with their new names; None for those that stay."""
    files: dict[Importer | None, list[str]] = {}
    for name in names:
        importer = importer_of(name)
        files.setdefault(importer if importer is not None and importer.dropped else None, []).append(name)
    folder = session.path.parent
    return {
        importer: own if importer is None else call(_dropped(importer).place, folder, _present(session, importer), own)
        for importer, own in sorted(files.items(), key=lambda item: item[0] is None)
    }


def _assembled(session: Session, placed: dict[Importer | None, list[str]]) -> list[tuple[tuple[str | int, ...], Any]]:
    """Return the function that such files make up, if the project has none of this kind."""
    changes: list[tuple[tuple[str | int, ...], Any]] = []
    for importer, names in placed.items():
        if importer is None:
            continue
        present = _present(session, importer)
        if present is None or not present.is_file():
            main = call(_dropped(importer).main, session.path.parent, names)
            changes += [(("model", "file"), main)] if main else []
    return changes


def _dropped(importer: Importer) -> DroppedFiles:
    assert importer.dropped is not None
    return importer.dropped


def _present(session: Session, importer: Importer) -> Path | None:
    """Return the file of the function if this importer reads it."""
    source = ImportSource.of(session.settings, session.path)
    return source.request.path if source is not None and source.importer is importer else None


def kinds_of(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Return what files are for, as `Role` names it; raise `InputError` with all that are for nothing here."""
    kinds, findings = {}, Findings()
    for name in names:
        try:
            identity = identify(folder / name)
        except InputError as error:
            findings.add(*error.findings)
            continue
        role = Role.CALIBRATION if identity.role is Role.SURROGATE else identity.role
        kinds[name] = role.value
        if role in (Role.NONE, Role.PROJECT):
            remedy = identity.format.remedy or (
                "Open it instead." if role is Role.PROJECT else "Export it as MDF or CSV."
            )
            findings.error(Location(name), f"is {identity.format.phrase}, which cannot be added to a project", remedy)
    findings.finish()
    return kinds


def _named(kinds: dict[str, str], kind: str) -> list[str]:
    return [name for name, own in kinds.items() if own == kind]


def _datasets(settings: Any, kinds: dict[str, str]) -> list[tuple[tuple[str | int, ...], Any]]:
    """Return datasets for recordings: the first that a project gets are training data, later ones test data."""
    entries = settings.get("dataset", [])
    entries = entries if isinstance(entries, list) else []
    recordings, databases = _named(kinds, "recording"), _named(kinds, "database")
    decoded = {"dbc": databases} if databases else {}
    if not recordings:
        return [
            (("dataset", number, "dbc"), _with(entry, databases)) for number, entry in enumerate(entries, 1) if decoded
        ]
    return [
        (("dataset", number + 1), {"files": [name], **decoded, "use": "test" if entries else "training"})
        for number, name in enumerate(recordings, len(entries))
    ]


def _with(entry: Any, databases: list[str]) -> list[Any]:
    """Return the databases of a dataset with further ones behind them."""
    own = entry.get("dbc", []) if isinstance(entry, dict) else []
    own = list(own) if isinstance(own, list) else [own]
    return [*own, *(name for name in databases if name not in own)]


def _function(folder: Path, kinds: dict[str, str]) -> list[tuple[tuple[str | int, ...], Any]]:
    names = sorted(_named(kinds, "function"), key=lambda name: has_no_functions(folder / name))
    return [(("model", "file"), completed_reference(folder, name)) for name in names[:1]]


def _variables(session: Session, kinds: dict[str, str], added: str) -> list[str]:
    """Return the files with values of variables, if the function is of a kind that takes them.

    Args:
        session: the project.
        kinds: the roles of the files.
        added: the function among them; empty if the project keeps its own.
    """
    importer = importer_of(split_reference(added or function_reference(session.settings))[0])
    if importer is None or "parameters" not in importer.keys:
        return []
    names = (name for name in _named(kinds, "calibration") if not _is_image(name))
    return [name for name in names if holds_variables(session.path.parent / name)]


def _parameters(settings: Any, variables: list[str]) -> list[tuple[tuple[str | int, ...], Any]]:
    """Return the files that give values to variables of the function, with the new ones behind the others."""
    own = settings.get("model", {}).get("parameters", [])
    own = list(own) if isinstance(own, list) else [own]
    added = [name for name in variables if name not in own]
    return [(("model", "parameters"), [*own, *added])] if added else []


def _initial(settings: Any, kinds: dict[str, str]) -> list[tuple[tuple[str | int, ...], Any]]:
    """Return the initial files with the new ones behind the others; an image comes with its A2L file."""
    names, described = _named(kinds, "calibration"), _named(kinds, "description")
    if not names:
        return []
    files = settings.get("calibration", {}).get("initial", [])
    own = list(files) if isinstance(files, list) else [files]
    images = {name: {"a2l": described[0], "hex": name} for name in names if described and _is_image(name)}
    added = [images.get(name, {"hex": name} if _is_image(name) else name) for name in names]
    return [(("calibration", "initial"), [*own, *added])]


def _is_image(name: str) -> bool:
    return name.lower().endswith(IMAGE_ENDINGS)
