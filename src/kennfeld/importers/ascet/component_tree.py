"""Components of ASCET 5 and 6 as declarations that classes, types and messages are found in."""

from dataclasses import field
from pathlib import Path
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.components import AscetComponent
from kennfeld.ascet.amd.files import ARCHIVE, SPECIFICATION, file_name, open_archive, open_folder
from kennfeld.ascet.amd.library import ComponentLibrary
from kennfeld.ascet.amd.xml_document import MAX_BYTES
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.calibrations import AMD
from kennfeld.files.head import ZIP
from kennfeld.files.identification import identify
from kennfeld.importers.ascet.declarations import Declared, FileScope, SourceTree

_MODULE: Final = "ASCET_Module"


@dataclass(frozen=True, eq=False)
class SharedElement(Declared):
    """An element that all components of a project know by its name."""

    @property
    def label(self) -> str:
        """The name, which has no package."""
        return self.name


@dataclass(frozen=True, eq=False)
class ComponentScope(FileScope):
    """The names that a component knows: its shared elements, those of others, and all components.

    `findings` are those on its files.
    """

    component: AscetComponent = field(default_factory=lambda: AscetComponent("", "", ""))
    findings: tuple[Finding, ...] = ()

    def find(self, name: str) -> Declared | None:
        """Return the shared element or the component of a name; None if unknown."""
        assert isinstance(self.tree, ComponentTree)
        # order: an element that the component exports, one that others export, a component, an imported element without
        # exporter, which has its own value
        own = next((item for item in self.component.elements if item.name == name and item.is_shared), None)
        if own is not None and own.scope == "exported":
            return self.shared(name)
        if own is not None or "." not in name:
            others = self.tree.library.exporters(name)
            if others:
                self.tree.note_exporters(name, others)
                return self.tree.component_scope(others[0]).shared(name)
        return self.tree.find(name) if own is None else self.shared(name)

    def shared(self, name: str) -> Declared | None:
        """Return the declaration of a shared element in this component."""
        declared = (item for item in self.file.declarations if isinstance(item, e.Constant) and item.name == name)
        return next((SharedElement(item, self) for item in declared), None)


@dataclass(eq=False)
class ComponentTree(SourceTree):
    """The components of an archive or folder, which is the root, as declarations.

    Attributes:
        library: the components.
        main: path of the component that an `.amd` file belongs to; empty for an archive.
        findings: warnings on elements that several components export.
    """

    library: ComponentLibrary = field(kw_only=True)
    main: str = field(default="", kw_only=True)
    findings: dict[Finding, None] = field(default_factory=dict, kw_only=True)
    _component_scopes: dict[str, ComponentScope] = field(default_factory=dict)

    def find(self, qualified: str) -> Declared | None:
        """Return the class or the enumeration of a component by its name with packages."""
        path = self.library.by_qualified_name(qualified)
        return None if path is None else self.declared(path)

    def declared(self, path: str) -> Declared | None:
        """Return the class or the enumeration at a path."""
        scope = self.component_scope(path)
        return next((Declared(item, scope) for item in scope.file.declarations), None)

    def component_scope(self, path: str) -> ComponentScope:
        """Return the scope of the component at a path; raises `InputError` if a file of it cannot be read."""
        if path not in self._component_scopes:
            code = self.library.code(path)
            file = self.root / (path + SPECIFICATION)
            self._component_scopes[path] = ComponentScope(
                self, code.file, file, self.library.component(path), code.findings
            )
        return self._component_scopes[path]

    def note_exporters(self, name: str, paths: tuple[str, ...]) -> None:
        """Add a warning if several components export an element."""
        if len(paths) > 1:
            message = f"{name} is exported by {join_names(list(paths), 4)}; the first one is used"
            self.findings[Finding(Location(self.library.files.name), message, severity="warning")] = None

    def has_package(self, name: str) -> bool:
        """Return False: names of components are always complete."""
        return False

    def package(self, name: str, own: Path | None = None) -> dict[str, Declared]:
        """Return nothing: names of components are always complete."""
        return {}


def holds_components(path: Path) -> bool:
    """Return whether a file is an archive of ASCET's components, or one of them."""
    return identify(path).format is AMD


def is_archive(path: Path) -> bool:
    """Return whether a file of components is an archive of several, perhaps a damaged one."""
    head = identify(path).head
    return head.raw.startswith(ZIP) or head.ending == ARCHIVE


def open_components(path: Path) -> ComponentTree:
    """Return the components of an archive (`.axl`), or those beside a file of one of them (`.amd`).

    Raises:
        InputError: the file cannot be read.
    """
    if not is_archive(path):
        files, main = open_folder(path)
        root = path.parents[main.count("/")]
        # the folder that the name spaces begin in, from which references such as /Lib/Filter/DT1 count
        return ComponentTree(root, library=ComponentLibrary(files), main=main)
    with convert_errors(path, "cannot be read"), path.open("rb") as stream:
        raw = stream.read(4 * MAX_BYTES + 1)
    if len(raw) > 4 * MAX_BYTES:
        raise InputError.of(Location(path.name), f"the archive has more than {4 * MAX_BYTES} bytes")
    return ComponentTree(path, library=ComponentLibrary(open_archive(raw, path.name)))


def code_components(tree: ComponentTree) -> dict[str, AscetComponent]:
    """Return the classes and modules by path."""
    return {path: item for path, item in tree.library.all_components().items() if item.is_code}


def choose_component(tree: ComponentTree, file: str, name: str) -> Declared:
    """Return a class or module.

    Args:
        tree: the components.
        file: name of the file in messages.
        name: its name, which may have its folders, `Lib/Filter/DT1` or `Lib.Filter.DT1`; empty for that of an `.amd`
            file, the only module of an archive, or its only component.

    Raises:
        InputError: it is unknown or ambiguous, or cannot be read.
    """
    components = code_components(tree)
    # classes alone do nothing in a project; modules have the processes that tasks call
    path = tree.main if not name else _named(components, file, name)
    if not path:
        modules = [key for key, item in components.items() if item.kind == _MODULE] or list(components)
        if len(modules) != 1:
            message = "the archive has several components" if components else "the archive has no component"
            remedy = f"Name one of them as class: {join_names(modules, 8)}." if components else ""
            raise InputError.of(Location(file), message, remedy)
        path = modules[0]
    declared = tree.declared(path)
    if declared is None or not isinstance(declared.declaration, e.ClassDeclaration):
        raise InputError.of(Location(file), f"{path} is not a class or module", "Name one of its classes.")
    return declared


def _named(components: dict[str, AscetComponent], file: str, name: str) -> str:
    # the end of a path is enough, if it is unique
    wanted = name.replace(".", "/").strip("/")
    paths = [path for path in components if f"/{path}".endswith(f"/{wanted}")]
    exact = [path for path in paths if path == wanted]
    if len(exact or paths) == 1:
        return (exact or paths)[0]
    location = Location(file)
    if paths:
        message = f"{len(paths)} components are named {name}"
        raise InputError.of(location, message, f"Name it with its folders: {join_names(paths, 8)}.")
    names = [file_name(path) for path in components]
    raise InputError.of(location, f"unknown class {name}", nearest(name, names) or f"It has {join_names(names, 8)}.")
