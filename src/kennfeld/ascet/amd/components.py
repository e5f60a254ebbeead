"""Declarations of a component: its elements, methods and enumerators, from its `.main.amd` file."""

from collections.abc import Iterator
from typing import Final

from kennfeld.base.errors import InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement

CLASS: Final = "ASCET_Class"
PROJECT: Final = "ASCET_Project"
ENUMERATION: Final = "ASCET_Enumeration"
TABLES: Final = ("oned", "twod")
_SHARED: Final = ("exported", "imported")
_KINDS: Final = ("Component", "Enumeration", "Image", "Record")
_BOUND: Final = 100_000


@dataclass(frozen=True)
class ComponentElement:
    """An element of a component, or an argument or the result of a method.

    Attributes:
        model_type: `scalar`, `array`, `matrix`, `oned`, `twod` or `complex`.
        basic_type: `cont`, `sdisc`, `udisc`, `log`, `enumeration`, `class`, `dt` or another.
        kind: `parameter`, `variable`, `message`, `input`, `output` or a constant.
        scope: `local`, `exported` or `imported`.
        reference: path of its enumeration or class, such as `/Lib/Filter/DT1`.
        sizes: largest sizes of an array or a table.
    """

    name: str
    model_type: str
    basic_type: str
    line: int
    unit: str = ""
    comment: str = ""
    kind: str = ""
    scope: str = "local"
    reference: str = ""
    sizes: tuple[int, ...] = ()
    table_type: str = "normal"
    is_dependent: bool = False
    is_set: bool = False
    is_get: bool = False

    @property
    def is_shared(self) -> bool:
        """True for elements that all components of a project know by their names."""
        return self.scope in _SHARED and self.model_type != "complex"

    @property
    def is_constant(self) -> bool:
        """True for constants and system constants."""
        return "const" in self.kind.lower()


@dataclass(frozen=True)
class MethodSignature:
    """A method or a process."""

    name: str
    line: int
    arguments: tuple[ComponentElement, ...] = ()
    result: ComponentElement | None = None
    is_public: bool = True
    is_process: bool = False


@dataclass(frozen=True)
class AscetComponent:
    """A class, module, project or enumeration; `labels` are the enumerators with their numbers."""

    name: str
    name_space: str
    kind: str
    specification: str = ""
    elements: tuple[ComponentElement, ...] = ()
    methods: tuple[MethodSignature, ...] = ()
    labels: tuple[tuple[str, int], ...] = ()
    line: int = 1

    @property
    def is_code(self) -> bool:
        """True for a class or a module, which has methods."""
        return self.kind not in (PROJECT, ENUMERATION, "ASCET_Image")


def read_component(root: XmlElement, file: str) -> AscetComponent:
    """Read the component that a `.main.amd` file declares; raises `InputError` if it declares none."""
    declared = next((child for child in root.children if child.tag in _KINDS), None)
    if declared is None or not declared.get("name"):
        raise InputError.of(Location(file, root.line), "declares no component", "Use a complete copy of the file.")
    listed = declared.first("Elements")
    signatures = declared.first("MethodSignatures")
    return AscetComponent(
        declared.get("name"),
        declared.get("nameSpace"),
        declared.get("componentType"),
        declared.get("specificationType"),
        () if listed is None else tuple(map(_element, listed.all("Element"))),
        () if signatures is None else tuple(_signature(item) for item in signatures.all("MethodSignature")),
        tuple(_labels(declared)),
        declared.line,
    )


def _element(element: XmlElement) -> ComponentElement:
    attributes = element.first("ElementAttributes")
    comment = element.first("Comment")
    if attributes is None:
        return ComponentElement(element.get("name"), "", "", element.line)
    own = next((item for item in attributes.walk() if "scope" in item.attributes), attributes)
    dimensions = attributes.first("DimensionalType")
    return ComponentElement(
        element.get("name"),
        attributes.get("modelType"),
        attributes.get("basicModelType"),
        element.line,
        attributes.get("unit"),
        " ".join(comment.text.split()) if comment is not None else "",
        own.get("kind"),
        own.get("scope", "local"),
        own.get("enumerationName") or own.get("componentName"),
        () if dimensions is None else tuple(_sizes(dimensions)),
        "normal" if dimensions is None else dimensions.get("type", "normal"),
        own.is_true("dependent"),
        own.is_true("set"),
        own.is_true("get"),
    )


def _sizes(dimensions: XmlElement) -> Iterator[int]:
    for name in ("maxSizeX", "maxSizeY"):
        if (size := whole(dimensions.get(name))) is not None:
            yield size


def whole(text: str) -> int | None:
    """Return the whole number >= 0 that a text states; None for another text."""
    return int(text) if text.isdecimal() and len(text) < 10 else None


def _signature(element: XmlElement) -> MethodSignature:
    listed, result = element.first("Arguments"), element.first("Return")
    return MethodSignature(
        element.get("name"),
        element.line,
        () if listed is None else tuple(map(_element, listed.all("Argument"))),
        None if result is None else _element(result),
        element.get("public", "true") == "true",
        element.is_true("availableForOS"),
    )


def _labels(declared: XmlElement) -> Iterator[tuple[str, int]]:
    for item in declared.all("Enumerator"):
        number = whole(item.get("index"))
        if number is not None and number < _BOUND:
            yield item.get("value"), number
