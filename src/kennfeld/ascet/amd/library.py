"""The components of an archive or folder, translated when first needed."""

from collections import defaultdict
from dataclasses import field
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.component_code import ComponentCode, ComponentTranslation
from kennfeld.ascet.amd.components import (
    ENUMERATION,
    AscetComponent,
    ComponentElement,
    MethodSignature,
    read_component,
)
from kennfeld.ascet.amd.data_sets import DataEntry, DataSet, chosen_entries, read_data_sets
from kennfeld.ascet.amd.diagram_code import DiagramReferences
from kennfeld.ascet.amd.element_code import ElementCode
from kennfeld.ascet.amd.files import DATA, IMPLEMENTATION, MAIN, SPECIFICATION, AmdFiles, file_name
from kennfeld.ascet.amd.ranges import read_ranges
from kennfeld.base.errors import Finding, InputError
from kennfeld.base.lazy_dataclass import dataclass

_DEFAULT_PROJECT: Final = ".data.dp.amd"


@dataclass(eq=False)
class ComponentLibrary:
    """The components by their paths without endings, such as `Lib/Filter/DT1`.

    Attributes:
        broken: findings on files that cannot be read, found while all components are searched.
    """

    files: AmdFiles
    broken: list[Finding] = field(default_factory=list)
    _components: dict[str, AscetComponent] = field(default_factory=dict)
    _codes: dict[str, ComponentCode] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.paths = tuple(self.files.components())
        self._by_name: dict[str, list[str]] = defaultdict(list)
        for path in self.paths:
            self._by_name[file_name(path)].append(path)
        self._qualified = {qualified_name(path): path for path in self.paths}
        self._shared: dict[str, tuple[str, ...]] | None = None
        self._labels: dict[str, dict[str, int]] | None = None

    def component(self, path: str) -> AscetComponent:
        """Return what a component declares; raises `InputError` if its file cannot be read."""
        if path not in self._components:
            file = path + MAIN
            self._components[path] = read_component(self.files.root(file), file_name(file))
        return self._components[path]

    def locate(self, reference: str) -> str | None:
        """Return the path of a component by a reference such as `/Lib/Filter/DT1`, or the only one of its name."""
        path = reference.strip("/")
        if path + MAIN in self.files:
            return path
        others = [
            other
            for other in self._by_name.get(file_name(path), ())
            if self._read(other) is not None and self.component(other).kind != "ASCET_Image"
        ]
        return others[0] if len(others) == 1 else None

    def by_qualified_name(self, name: str) -> str | None:
        """Return the path of a component by its name with packages, `Lib.Filter.DT1`."""
        return self._qualified.get(name)

    def _read(self, path: str) -> AscetComponent | None:
        """Return a component; None, with a finding, if its file cannot be read."""
        try:
            return self.component(path)
        except InputError as error:
            self.broken += [finding for finding in error.findings if finding not in self.broken]
            return None

    def all_components(self) -> dict[str, AscetComponent]:
        """Return all components that can be read, by path."""
        read = {path: self._read(path) for path in self.paths}
        return {path: component for path, component in read.items() if component is not None}

    def exporters(self, name: str) -> tuple[str, ...]:
        """Return the paths of the components that export an element."""
        if self._shared is None:
            shared: dict[str, list[str]] = defaultdict(list)
            for path, component in self.all_components().items():
                if component.is_code:
                    for element in component.elements:
                        if element.scope == "exported" and element.is_shared:
                            shared[element.name].append(path)
            self._shared = {key: tuple(paths) for key, paths in shared.items()}
        return self._shared.get(name, ())

    # data

    def data_sets(self, path: str) -> tuple[DataSet, ...]:
        """Return the data sets of a component; none without a file."""
        root = self.files.optional_root(path + DATA)
        return () if root is None else read_data_sets(root)

    def entries(self, path: str) -> dict[str, DataEntry]:
        """Return the values of a component, and those that its default project has for imported elements."""
        root = self.files.optional_root(path + _DEFAULT_PROJECT)
        imported = {} if root is None else chosen_entries(read_data_sets(root))
        return {**imported, **chosen_entries(self.data_sets(path))}

    # code

    def code(self, path: str) -> ComponentCode:
        """Return the tree of a component; raises `InputError` if one of its files cannot be read."""
        if path not in self._codes:
            self._codes[path] = self._translation(path).translate()
        return self._codes[path]

    def _translation(self, path: str) -> ComponentTranslation:
        component = self.component(path)
        main, specification = path + MAIN, path + SPECIFICATION
        elements = ElementCode(
            file_name(main),
            read_ranges(self.files.optional_root(path + IMPLEMENTATION)),
            self._qualified_reference,
            self._data_set_names,
        )
        references = DiagramReferences(self._signature, lambda label: self._label(component, label))
        return ComponentTranslation(
            component,
            qualified_name(path).rpartition(".")[0],
            file_name(specification),
            self.files.optional_root(specification),
            self.data_sets(path),
            self.entries(path),
            elements,
            references,
        )

    def _qualified_reference(self, reference: str) -> str:
        return qualified_name(self.locate(reference) or reference.strip("/"))

    def _data_set_names(self, reference: str) -> list[str]:
        path = self.locate(reference)
        return [] if path is None else [item.name for item in self.data_sets(path) if not item.is_shared]

    def _signature(self, reference: str, method: str) -> MethodSignature | None:
        path = self.locate(reference)
        methods = () if path is None else self.component(path).methods
        return next((item for item in methods if item.name == method), None)

    def _label(self, component: AscetComponent, label: str) -> e.Expression | None:
        """Return the label of an enumeration that the component uses, or the only one of all."""
        used = [self.locate(element.reference) for element in _typed(component) if element.basic_type == "enumeration"]
        # several enumerations may have the label: those that the component uses come first
        for paths in ([path for path in dict.fromkeys(used) if path is not None], self._enumerations()):
            numbers = {path: dict(self.component(path).labels).get(label) for path in paths}
            known = {path: number for path, number in numbers.items() if number is not None}
            if len(set(known.values())) > 1:
                names = " and ".join(sorted(map(file_name, known))[:3])
                return e.Unsupported(f"the label {label} has different numbers in {names}, which is not supported")
            if known:
                return e.Field(e.Name(qualified_name(next(iter(known)))), label)
        return None

    def _enumerations(self) -> list[str]:
        return [path for path, item in self.all_components().items() if item.kind == ENUMERATION]


def _typed(component: AscetComponent) -> list[ComponentElement]:
    """Return the elements of a component, and the arguments and results of its methods."""
    results = [method.result for method in component.methods if method.result is not None]
    arguments = [argument for method in component.methods for argument in method.arguments]
    return [*component.elements, *arguments, *results]


def qualified_name(path: str) -> str:
    """Return the name with packages of a component at a path.

    >>> qualified_name("/Lib/Filter/DT1")
    'Lib.Filter.DT1'
    """
    return ".".join(part.replace(".", "_") for part in path.split("/") if part)
