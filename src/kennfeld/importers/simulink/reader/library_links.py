"""Resolution of links to libraries, referenced models and subsystem files: their content is copied into the model."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from pathlib import Path

from kennfeld.base.errors import Finding, InputError, Location, Severity
from kennfeld.base.formatting import nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.document import read_document
from kennfeld.importers.simulink.reader.model_tree import Mask, ModelBlock, ModelDocument, System, split_path

_NAME = re.compile(r"[A-Za-z]\w{0,127}\Z")
_ENDINGS = (".slx", ".mdl")
_MAX_DEPTH = 100  # nested subsystems, links resolved
_MAX_CHAIN = 30  # links to links
_MAX_BLOCKS = 200_000  # in a model with all links resolved
_OWN = "$bdroot"  # the name of a file for itself
_OF_SIMULINK = ("simulink", "simulink3", "simulink_extras", "built-in", "SignalEditorBlockLib")


def is_of_simulink(source: str) -> bool:
    """Return True if a link leads to a library of Simulink itself.

    >>> is_of_simulink("simulink/Discrete/First-Order Hold")
    True
    """
    return (split_path(source) or ("",))[0] in _OF_SIMULINK


@dataclass(frozen=True)
class ResolvedModel:
    """A document with its links resolved.

    `files` are the files used, by library or model name. `missing` are unresolved links with the paths of the blocks
    that use them; those stay references. `models` are the referenced models, which have their own workspaces and
    solvers. `problems` are cycles, damaged files and unknown blocks.
    """

    document: ModelDocument
    files: Mapping[str, Path] = field(default_factory=dict)
    missing: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    models: Mapping[str, ModelDocument] = field(default_factory=dict)
    problems: tuple[Finding, ...] = ()


class LibraryResolver:
    """The libraries and models next to a model and in further folders.

    A file is searched for by name in the folder of the file that uses it, then in `folders`, `.slx` before `.mdl`; each
    is read once. Raises `InputError` if a folder does not exist.
    """

    def __init__(self, folders: Iterable[str | Path] = ()) -> None:
        self.folders = tuple(Path(folder) for folder in folders)
        if missing := [folder for folder in self.folders if not folder.is_dir()]:
            raise InputError(
                Finding(Location.of_file(folder), "folder not found", "Check the path.") for folder in missing
            )
        self._read: dict[Path, ModelDocument | InputError] = {}

    def find(self, name: str, beside: Path) -> Path | None:
        """Find the file of a library or model, None if there is none."""
        stem = re.sub(r"\.(slx|mdl)\Z", "", name)
        if not _NAME.match(stem):  # a path could name any local file
            return None
        # a name with an extension means that file alone
        endings = _ENDINGS if stem == name else (name[len(stem) :],)
        places = (folder / (stem + ending) for folder in (beside, *self.folders) for ending in endings)
        return next((path for path in places if path.is_file()), None)

    def read(self, path: Path) -> ModelDocument:
        """Read a file once; raises `InputError` if it cannot be read, on each call."""
        if path not in self._read:
            try:
                self._read[path] = read_document(path)
            except InputError as error:
                self._read[path] = error
        document = self._read[path]
        if isinstance(document, InputError):
            raise document
        return document

    def resolve(self, document: ModelDocument) -> ResolvedModel:
        """Copy the content of libraries and referenced models into a document; raises nothing.

        A linked block takes type, fields and content of the library block, with its own fields taking precedence; links
        into libraries of Simulink itself stay. A model reference gets the root of the referenced model as its system, a
        subsystem file block the root of its file.
        """
        copier = _LinkCopier(self, document)
        root = copier.system(document.root, _Place(document, ""))
        missing = {source: tuple(paths) for source, paths in copier.missing.items()}
        resolved = replace(document, root=root)
        return ResolvedModel(resolved, copier.files, missing, copier.models, tuple(copier.problems.values()))


@dataclass(frozen=True)
class _Place:
    """The destination of a copied system: source document, paths there and here, and the links followed so far."""

    document: ModelDocument
    here: str
    there: str = ""
    chain: tuple[str, ...] = ()
    depth: int = 0

    def path(self, block: ModelBlock) -> str:
        """Return the path of a block in the resolved model."""
        rest = block.path[len(self.there) + 1 :] if self.there else block.path
        return f"{self.here}/{rest}" if self.here else rest


class _LinkCopier:
    def __init__(self, libraries: LibraryResolver, document: ModelDocument) -> None:
        self.libraries = libraries
        self.file = document.path.name
        self.files: dict[str, Path] = {}
        self.missing: dict[str, list[str]] = {}
        self.models: dict[str, ModelDocument] = {}
        self.problems: dict[str, Finding] = {}
        self.count = 0

    def system(self, system: System, place: _Place) -> System:
        if place.depth > _MAX_DEPTH:
            self._problem(place.here, f"has subsystems more than {_MAX_DEPTH} levels deep after resolving its links")
            return System()
        # counted while copying: a library that uses another one twice, and so on, doubles at each level
        self.count += len(system.blocks)
        if self.count > _MAX_BLOCKS:
            self._problem("", f"has more than {_MAX_BLOCKS} blocks after resolving its links")
            return System()
        # lines need no copy: they name blocks by their SIDs, which copies keep
        return System(tuple(self._block(block, place) for block in system.blocks), system.lines)

    def _block(self, block: ModelBlock, place: _Place) -> ModelBlock:
        path = place.path(block)
        if block.reference is not None and not is_of_simulink(block.reference.source):
            return self._link(block, path, place)
        if block.model:
            return self._model(block, path, place)
        if block.elsewhere:
            return self._subsystem(block, path, place)
        if block.system is not None:
            inner = replace(place, depth=place.depth + 1)
            return replace(block, path=path, system=self.system(block.system, inner))
        return block if path == block.path else replace(block, path=path)

    def _link(self, block: ModelBlock, path: str, place: _Place) -> ModelBlock:
        assert block.reference is not None
        source = block.reference.source
        if source.startswith(f"{_OWN}/"):
            # within a library, $bdroot is the library, not the model that uses it
            source = place.document.name.replace("/", "//") + source.removeprefix(_OWN)
        names = split_path(source)
        alone = replace(block, path=path)
        library = self._document(names[0] if names else "", source, path, place)
        if library is None:
            return replace(alone, searched=self._searched(place))
        if self._is_cyclic(source, path, place):
            return alone
        target = library.root.at(source.partition("/")[2])
        if target is None:
            known = nearest(names[-1], (block.name for block in library.root.every()))
            self._problem(path, f"links to {source[:120]}, which {library.path.name} does not contain", known)
            return alone
        linked = self._instance(block, target, path)
        if target.reference is not None or target.system is not None:
            there = _Place(library, path, target.path, (*place.chain, source), place.depth + 1)
            linked = self._below(linked, target, there)
        return linked

    def _below(self, linked: ModelBlock, target: ModelBlock, there: _Place) -> ModelBlock:
        """Return the content behind a link: that of the library block, or of what that links to in turn."""
        if target.reference is not None and not is_of_simulink(target.reference.source):
            further = self._link(replace(linked, reference=target.reference), linked.path, there)
            # a link behind the link that cannot be resolved leaves the block as the first one made it
            return replace(further, reference=linked.reference) if further.type != "Reference" else linked
        if target.system is not None:
            return replace(linked, system=self.system(target.system, there))
        return linked

    def _instance(self, block: ModelBlock, target: ModelBlock, path: str) -> ModelBlock:
        """Return the library block in place of the link, with the fields of the link."""
        assert block.reference is not None
        fields = block.reference.parameters
        masked = {parameter.name for parameter in target.mask.parameters} if target.mask is not None else set()
        # a field named like a mask parameter is the value in the dialog, see `_set_mask`
        parameters = dict(target.parameters) | {key: fields[key] for key in fields if key not in masked}
        if block.mask is not None and block.mask.parameters and masked:
            message = "has a mask in addition to that of the library; only the library's is read"
            self._problem(path, message, severity="warning")
        return replace(
            target,
            name=block.name,
            sid=block.sid,
            path=path,
            parameters=parameters,
            ports=block.ports or target.ports,
            mask=_set_mask(target.mask, fields) if target.mask is not None else block.mask,
            reference=block.reference,
            signals=block.signals,
        )

    def _model(self, block: ModelBlock, path: str, place: _Place) -> ModelBlock:
        document = self._document(block.model, block.model, path, place)
        if document is None:
            return replace(block, path=path, searched=self._searched(place))
        if self._is_cyclic(block.model, path, place):
            return replace(block, path=path)
        self.models[block.model] = document
        inner = _Place(document, path, "", (*place.chain, block.model), place.depth + 1)
        return replace(block, path=path, system=self.system(document.root, inner))

    def _subsystem(self, block: ModelBlock, path: str, place: _Place) -> ModelBlock:
        """Return a subsystem with the content of its file, whose mask it takes if it has none."""
        name, alone = block.elsewhere, replace(block, path=path)
        document = self._document(name, name, path, place)
        if document is None:
            return replace(alone, searched=self._searched(place))
        if self._is_cyclic(name, path, place):
            return alone
        if document.kind != "subsystem":
            remedy = f"Save its content as the subsystem file {name}.slx."
            self._problem(path, f"has its content in {document.path.name}, which is a {document.kind}", remedy)
            self.missing.setdefault(name, []).append(path)
            return alone
        mask = block.mask or (_set_mask(document.mask, block.parameters) if document.mask is not None else None)
        inner = _Place(document, path, "", (*place.chain, name), place.depth + 1)
        return replace(alone, mask=mask, system=self.system(document.root, inner))

    def _searched(self, place: _Place) -> tuple[str, ...]:
        """Return the folders in which the files of a document's links are searched."""
        folders = (place.document.path.parent, *self.libraries.folders)
        return tuple(dict.fromkeys(Location.of_file(folder).file for folder in folders))

    def _document(self, name: str, source: str, path: str, place: _Place) -> ModelDocument | None:
        # a file may link to itself by its own name
        if name == place.document.name:
            return place.document
        file = self.libraries.find(name, place.document.path.parent)
        if file is None:
            self.missing.setdefault(source, []).append(path)
            return None
        try:
            document = self.libraries.read(file)
        except InputError as error:
            self.missing.setdefault(source, []).append(path)
            self.problems |= {str(finding): finding for finding in error.findings}
            return None
        self.files[name] = file
        return document

    def _is_cyclic(self, source: str, path: str, place: _Place) -> bool:
        """Return True if a link is part of a cycle or of a chain that is too long."""
        if source in place.chain:
            loop = " -> ".join((*place.chain[place.chain.index(source) :], source))
            self._problem(path, f"links to itself: {loop}", "Break the loop in one of these libraries.")
            return True
        if len(place.chain) >= _MAX_CHAIN:
            self._problem(path, f"is a chain of more than {_MAX_CHAIN} links")
            return True
        return False

    def _problem(self, path: str, message: str, remedy: str = "", severity: Severity = "error") -> None:
        if len(self.problems) < 100:
            location = Location(self.file, path=path[:120])
            # by message: the same problem at several links is one
            self.problems.setdefault(message, Finding(location, message, remedy, severity=severity))


def _set_mask(mask: Mask, expressions: Mapping[str, str]) -> Mask:
    parameters = [replace(p, expression=expressions.get(p.name, p.expression)) for p in mask.parameters]
    return replace(mask, parameters=tuple(parameters))
