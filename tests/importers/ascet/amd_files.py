"""Writes components of ASCET 6: `.amd` files in their layout, and `.axl` archives of them."""

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n'
VERSION = 'toolVersion="V6.4.3" schemaVersion="6.3.0.0"'
SIGNATURE = (
    '\t<Signature xmlns="http://www.w3.org/2000/09/xmldsig#">\n\t\t<SignedInfo>\n\t\t\t<DigestValue>AAAA</DigestValue>\n'
    "\t\t</SignedInfo>\n\t\t<SignatureValue>BBBB</SignatureValue>\n\t</Signature>\n"
)
_CLASSES = {"complex": "ComplexType", "scalar": "ScalarType"}
_TABLES = {"oned": "CharTable1D", "twod": "CharTable2D", "array": "Array", "complex": "Class"}


@dataclass(frozen=True)
class Item:
    """An element, or an argument or a result of a method.

    A value is a number, a truth value, a label, or a list; (x, values) of a curve, (x, y, values row by y) of a map, or
    the name of a data set of a class.
    """

    name: str
    basic: str = "cont"
    model: str = "scalar"
    kind: str = "variable"
    scope: str = "local"
    value: Any = None
    unit: str = ""
    comment: str = ""
    reference: str = ""
    limits: tuple[float, float] | None = None
    extra: str = ""  # further attributes
    others: dict[str, Any] = field(default_factory=dict)  # values in other data sets


def parameter(name: str, value: Any, **options: Any) -> Item:
    """Return a parameter; a curve or map if its value has breakpoints."""
    model = {2: "oned", 3: "twod"}[len(value)] if isinstance(value, tuple) else "scalar"
    model = "array" if isinstance(value, list) else model
    return Item(name, **{"model": model, "kind": "parameter", "value": value, **options})


def message(name: str, scope: str = "imported", **options: Any) -> Item:
    """Return a message."""
    return Item(name, kind="message", scope=scope, **options)


def instance(name: str, reference: str, data_set: str = "Data", **options: Any) -> Item:
    """Return an instance of a class."""
    return Item(name, basic="class", model="complex", reference=reference, value=data_set, **options)


@dataclass(frozen=True)
class Method:
    """A method: its arguments and result, and its text in ESDL if it is not drawn."""

    name: str
    arguments: Sequence[Item] = ()
    result: Item | None = None
    text: str = ""
    public: bool = True


class Drawing:
    """A block diagram: methods return the identifiers of output ports."""

    def __init__(self) -> None:
        self.count = 0
        self.parts: list[str] = []
        self.levels: list[list[str]] = []

    def _id(self) -> int:
        self.count += 1
        return self.count

    def _add(self, text: str) -> None:
        self.parts.append(f"<DiagramElement>{text}</DiagramElement>\n")

    def connect(self, source: int | None, port: int) -> None:
        """Connect two ports; nothing for None."""
        if source is not None:
            ends = f'<Start graphicOID="{source}"/><End graphicOID="{port}"/>'
            self._add(f'<Connection connectionPointNumber="2">{ends}</Connection>')

    def _selectors(self, sources: Sequence[int | None], names: Sequence[str], key: str = "index") -> str:
        text = ""
        for at, source in enumerate(sources):
            port = self._id()
            name = f' {key}="{names[at]}"' if names else f' index="{at}"'
            text += f'<SelectorPort graphicOID="{port}"{name}/>'
            self.connect(source, port)
        return text

    def element(self, name: str, kind: str = "Variable", method: str = "") -> int:
        """Return the value of an element; `kind` is that of the block, such as Argument, with its method."""
        port, own = self._id(), f' methodName="{method}"' if method else ""
        self._add(
            f'<SimpleElement graphicOID="{self._id()}" elementName="{name}" type="{kind}"{own}><Interfaces>'
            f'<ReturnPort graphicOID="{port}"/></Interfaces></SimpleElement>'
        )
        return port

    def literal(self, text: str) -> int:
        """Return a literal."""
        port = self._id()
        self._add(
            f'<Literal graphicOID="{self._id()}" value="{escape(text)}"><Interfaces>'
            f'<ReturnPort graphicOID="{port}"/></Interfaces></Literal>'
        )
        return port

    def operator(self, kind: str, *sources: int | None) -> int:
        """Return the result of an operator."""
        port = self._id()
        self._add(
            f'<Operator graphicOID="{self._id()}" type="{escape(kind)}" tempVar="false"><Interfaces>'
            f'<ReturnPort graphicOID="{port}">{self._selectors(sources, ())}</ReturnPort></Interfaces></Operator>'
        )
        return port

    def switch(self, kind: str, conditions: Sequence[int], **values: int) -> int:
        """Return the result of MUX or Case; the names of values may begin with `_`."""
        port, inputs = self._id(), ""
        for at, (name, source) in enumerate(values.items(), len(conditions)):
            own = self._id()
            inputs += f'<InputPort graphicOID="{own}" index="{at}" name="{name.strip("_")}"/>'
            self.connect(source, own)
        self._add(
            f'<Operator graphicOID="{self._id()}" type="{kind}" tempVar="false"><Interfaces>'
            f'<ReturnPort graphicOID="{port}">{self._selectors(conditions, ())}{inputs}</ReturnPort>'
            "</Interfaces></Operator>"
        )
        return port

    def cast(self, source: int) -> int:
        """Return the value behind an implementation cast."""
        port, own = self._id(), self._id()
        self.connect(source, own)
        self._add(
            f'<ImplementationCast graphicOID="{self._id()}" elementName="cast"><Interfaces>'
            f'<ReturnPort graphicOID="{port}"/><SelectorPort graphicOID="{own}"/></Interfaces></ImplementationCast>'
        )
        return port

    def value_of(self, name: str, method: str, model: str = "complex", **arguments: int | None) -> int:
        """Return the result of a method of a table, an array or an instance; arguments by name."""
        port = self._id()
        names, key = [*arguments], "elementName" if model == "complex" else "name"
        selectors = self._selectors([*arguments.values()], names, key)
        flag = "false" if model == "complex" else "true"
        self._add(
            f'<ComplexElement graphicOID="{self._id()}" elementName="{name}" type="{_TABLES[model]}"><Interfaces>'
            f'<ReturnPort graphicOID="{port}" methodName="{method}" defaultPort="{flag}">{selectors}</ReturnPort>'
            "</Interfaces></ComplexElement>"
        )
        return port

    def member(self, name: str, element: str) -> int:
        """Return an element of an instance."""
        port = self._id()
        self._add(
            f'<ComplexElement graphicOID="{self._id()}" elementName="{name}" type="Class"><Interfaces>'
            f'<MemberGetPort graphicOID="{port}" elementName="{element}"/></Interfaces></ComplexElement>'
        )
        return port

    # steps

    def _call(self, when: "tuple[str | int, int]") -> str:
        """Return a sequence call: (method, number) or (output of a control block, number)."""
        run, number = when
        text = f'<SequenceCall graphicOID="{self._id()}" sequenceNumber="{number}" '
        if isinstance(run, str):
            return f'{text}methodName="{run}"/>'
        pin = self._id()
        self.connect(run, pin)
        return f'{text}connectOID="{pin}"/>'

    def write(self, name: str, source: int | None, when: "tuple[str | int, int]", kind: str = "Variable") -> None:
        """Assign a value to an element; `kind` is Return for the result of a method."""
        port = self._id()
        self.connect(source, port)
        own = ' methodName="any"' if kind == "Return" else ""
        self._add(
            f'<SimpleElement graphicOID="{self._id()}" elementName="{name}" type="{kind}"{own}><Interfaces>'
            f'<SelectorPort graphicOID="{port}">{self._call(when)}</SelectorPort></Interfaces></SimpleElement>'
        )

    def run(
        self, name: str, method: str, when: "tuple[str | int, int]", model: str = "complex", **arguments: int
    ) -> None:
        """Call a method without a result."""
        names, key = [*arguments], "elementName" if model == "complex" else "name"
        own = ' methodOID="_1"' if model == "complex" else ' defaultMethod="true"'
        self._add(
            f'<ComplexElement graphicOID="{self._id()}" elementName="{name}" type="{_TABLES[model]}"><Interfaces>'
            f'<MethodPort methodName="{method}"{own}>{self._call(when)}'
            f"{self._selectors([*arguments.values()], names, key)}</MethodPort></Interfaces></ComplexElement>"
        )

    def put(self, name: str, element: str, source: int, when: "tuple[str | int, int]") -> None:
        """Assign a value to an element of an instance."""
        port = self._id()
        self.connect(source, port)
        self._add(
            f'<ComplexElement graphicOID="{self._id()}" elementName="{name}" type="Class"><Interfaces>'
            f'<MemberSetPort graphicOID="{port}" elementName="{element}">{self._call(when)}</MemberSetPort>'
            "</Interfaces></ComplexElement>"
        )

    def control(self, kind: str, condition: int, when: "tuple[str | int, int]") -> list[int]:
        """Return the outputs of a control block."""
        port, outputs = self._id(), [self._id() for _ in range(2 if kind == "IfThenElse" else 1)]
        self.connect(condition, port)
        returns = "".join(f'<ReturnPort graphicOID="{own}" index="{at}"/>' for at, own in enumerate(outputs))
        self._add(
            f'<Control graphicOID="{self._id()}" type="{kind}"><Interfaces><SelectorPort graphicOID="{port}">'
            f"{self._call(when)}</SelectorPort>{returns}</Interfaces></Control>"
        )
        return outputs

    # hierarchies

    def begin(self) -> None:
        """Draw what follows into a hierarchy."""
        self.levels.append(self.parts)
        self.parts = []

    def end(self, **connectors: int) -> dict[str, int]:
        """End a hierarchy; `connectors` are ports inside by name. Return the ports outside."""
        inner = {name: self._id() for name in connectors}
        for name, port in connectors.items():
            self.connect(port, inner[name])
            self._add(f'<HierarchyConnector graphicOID="{inner[name]}" name="{name}"/>')
        contents, self.parts = "".join(self.parts), self.levels.pop()
        outer = {name: self._id() for name in connectors}
        interfaces = "".join(
            f'<BlockInterface name="{name}"><ExternalConnector graphicOID="{port}" flow="out">'
            f'<ConnectionPoint graphicOID="{port}"/></ExternalConnector></BlockInterface>'
            for name, port in outer.items()
        )
        self._add(
            f'<Hierarchy graphicOID="{self._id()}" name="inner"><Interfaces>{interfaces}</Interfaces>'
            f"<Contents>{contents}</Contents></Hierarchy>"
        )
        return outer


@dataclass(frozen=True)
class Component:
    """A class or module with all of its files."""

    name: str
    elements: Sequence[Item] = ()
    methods: Sequence[Method] = ()
    drawing: Drawing | None = None
    folder: str = "Engine"
    kind: str = "ASCET_Module"
    machine: str = ""  # content of a state machine
    code: str = ""  # in C
    labels: Sequence[str] = ()

    def files(self) -> dict[str, bytes]:
        """Return the files by path."""
        parts = {"main": self._main()}
        if not self.labels:
            parts |= {
                "data": self._data(),
                "implementation": self._implementation(),
                "specification": self._specification(),
            }
        return {f"{self.folder}/{self.name}.{key}.amd": text.encode() for key, text in parts.items()}

    def _main(self) -> str:
        own = f'name="{self.name}" nameSpace="/{self.folder}" OID="_1"'
        if self.labels:
            rows = "".join(f'\t\t<Enumerator index="{at}" value="{label}"/>\n' for at, label in enumerate(self.labels))
            body = f'<Enumeration {own} componentType="ASCET_Enumeration">\n{rows}\t</Enumeration>'
        else:
            elements = "".join(map(_element, self.elements))
            methods = "".join(map(_signature, self.methods))
            body = (
                f'<Component {own} componentType="{self.kind}" specificationType="BlockDiagram">\n'
                f"\t\t<Elements>\n{elements}\t\t</Elements>\n"
                f"\t\t<MethodSignatures>\n{methods}\t\t</MethodSignatures>\n\t</Component>"
            )
        return f"{HEAD}<ComponentMain {VERSION}>\n\t{body}\n{SIGNATURE}</ComponentMain>\n"

    def _data(self) -> str:
        shared = [item for item in self.elements if item.value is not None and item.scope == "exported"]
        own = [item for item in self.elements if item.value is not None and item.scope == "local"]
        sets = _data_set(self.name, "false", "true", [(item, item.value) for item in shared])
        sets += _data_set("Data", "true", "false", [(item, item.value) for item in own])
        for name in dict.fromkeys(name for item in own for name in item.others):
            sets += _data_set(name, "false", "false", [(item, item.others.get(name, item.value)) for item in own])
        return f"{HEAD}<ComponentData {VERSION}>\n{sets}{SIGNATURE}</ComponentData>\n"

    def _implementation(self) -> str:
        entries = "".join(
            f'<ImplementationEntry><ImplementationVariant name="default"><ElementImplementation '
            f'elementName="{item.name}"><ScalarImplementation><NumericImplementation limitAssignments="true">'
            f'<PhysicalInterval min="{item.limits[0]}" max="{item.limits[1]}"/></NumericImplementation>'
            "</ScalarImplementation></ElementImplementation></ImplementationVariant></ImplementationEntry>\n"
            for item in self.elements
            if item.limits is not None
        )
        inner = f'<ImplementationSet name="Impl" default="true">\n{entries}</ImplementationSet>\n'
        return f"{HEAD}<ComponentImplementation {VERSION}>\n{inner}</ComponentImplementation>\n"

    def _specification(self) -> str:
        bodies = "".join(
            f'<MethodBody methodName="{item.name}">'
            + (f"<CodeBlock>{escape(item.text)}</CodeBlock>" if item.text else "")
            + "</MethodBody>\n"
            for item in self.methods
        )
        text = f"<ESDLCode><MethodBodies>\n{bodies}</MethodBodies></ESDLCode>\n"
        drawn = "" if self.drawing is None else "".join(self.drawing.parts)
        parts = (
            f"<BlockDiagramSpecification>{text}<DiagramElements>{drawn}</DiagramElements></BlockDiagramSpecification>"
        )
        if self.machine:
            machine = f"<DiagramElements>{self.machine}</DiagramElements>"
            parts = f"<StateMachineSpecification>{machine}</StateMachineSpecification></Specification>\n" + (
                f'<Specification name="Actions" public="private">{parts}'
            )
        if self.code:
            parts = "<CCodeSpecification><CCode/></CCodeSpecification>"
        specification = f'<Specification name="Main" public="public">{parts}</Specification>\n'
        return f"{HEAD}<Specifications {VERSION}>\n{specification}</Specifications>\n"


def _element(item: Item, tag: str = "Element") -> str:
    if item.model == "complex":
        attributes = f'<ComplexType><ComplexAttributes scope="local" componentName="{item.reference}"/></ComplexType>'
    elif item.model == "scalar":
        name = "EnumerationAttributes" if item.basic == "enumeration" else "ScalarAttributes"
        reference = f' enumerationName="{item.reference}"' if item.reference else ""
        attributes = (
            f'<ScalarType><{name} kind="{item.kind}" scope="{item.scope}"{reference} {item.extra}/></ScalarType>'
        )
    else:
        sizes = "".join(
            f' maxSize{axis}="{len(points)}"'
            for axis, points in zip("XY", item.value if isinstance(item.value, tuple) else [item.value], strict=False)
        )
        attributes = (
            f'<DimensionalType{sizes} type="normal"><DimensionalAttributes kind="{item.kind}" scope="{item.scope}" '
            f"{item.extra}/></DimensionalType>"
        )
    return (
        f'\t\t\t<{tag} name="{item.name}"><Comment>{escape(item.comment)}</Comment><ElementAttributes '
        f'modelType="{item.model}" basicModelType="{item.basic}" unit="{item.unit}">{attributes}</ElementAttributes>'
        f"</{tag}>\n"
    )


def _signature(method: Method) -> str:
    arguments = "".join(_element(item, "Argument") for item in method.arguments)
    result = "" if method.result is None else _element(method.result, "Return")
    public = "true" if method.public else "false"
    inner = f"<Arguments>{arguments}</Arguments>{result}"
    return f'\t\t\t<MethodSignature name="{method.name}" public="{public}">{inner}</MethodSignature>\n'


def _data_set(name: str, default: str, shared: str, entries: Sequence[tuple[Item, Any]]) -> str:
    rows = "".join(
        f'\t\t<DataEntry elementName="{item.name}">\n\t\t\t<DataVariant name="default">{_content(item, value)}'
        "</DataVariant>\n\t\t</DataEntry>\n"
        for item, value in entries
    )
    return f'\t<DataSet name="{name}" OID="_{name}" default="{default}" classConfig="{shared}">\n{rows}\t</DataSet>\n'


def _content(item: Item, value: Any) -> str:
    if item.model == "complex":
        return f'<ComplexType dataName="{value}"/>'
    if item.model == "scalar":
        return f"<ScalarType>{_number(value)}</ScalarType>"
    if item.model == "array":
        return f"<DimensionalType><Array>{_values(value)}</Array></DimensionalType>"
    head = 'type="normal" interpolation="Linear" extrapolation="Constant"'
    axes = "".join(f"<{tag}Axis>{_values(points)}</{tag}Axis>" for tag, points in zip("XY", value[:-1], strict=False))
    if item.model == "oned":
        return f"<DimensionalType><OneD {head}>{axes}<Values>{_values(value[-1])}</Values></OneD></DimensionalType>"
    rows = "".join(f"<Row>{_values(row)}</Row>" for row in value[-1])
    return f"<DimensionalType><TwoD {head}>{axes}<Values>{rows}</Values></TwoD></DimensionalType>"


def _values(values: Sequence[Any]) -> str:
    return "".join(f"<Value>{_number(value)}</Value>" for value in values)


def _number(value: Any) -> str:
    if isinstance(value, bool):
        return f'<Logic value="{str(value).lower()}"/>'
    return f'<Enumeration value="{value}"/>' if isinstance(value, str) else f'<Numeric value="{value}"/>'


def archive(*components: Component) -> bytes:
    """Return an `.axl` archive."""
    result = BytesIO()
    with zipfile.ZipFile(result, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("Engine/", b"")
        for component in components:
            for path, content in component.files().items():
                file.writestr(path, content)
        file.writestr("Engine/Icons/Plant.bmp", b"BM\x00\x01")
    return result.getvalue()


def write_archive(folder: Path, *components: Component) -> Path:
    """Write an archive into a folder."""
    path = folder / "Engine.axl"
    path.write_bytes(archive(*components))
    return path


def write_folder(folder: Path, *components: Component) -> Path:
    """Write the files of components; return the main file of the first one."""
    for component in components:
        for path, content in component.files().items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
    return folder / f"{components[0].folder}/{components[0].name}.main.amd"


def operators_module(kind: str, count: int, basic: str = "cont", result: str = "cont") -> Component:
    """Return a module that applies an operator to its messages a, b, ... and sends y."""
    drawing = Drawing()
    names = "abcdefg"[:count]
    drawing.write("y", drawing.operator(kind, *(drawing.element(name) for name in names)), ("calc", 1))
    items = [message(name, basic=basic) for name in names]
    return Component("Plant", [*items, message("y", "exported", basic=result)], [Method("calc")], drawing)
