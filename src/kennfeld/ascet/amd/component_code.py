"""A component as the syntax tree of an ESDL file: a class with its elements and methods, and its shared elements."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field
from typing import Final

from kennfeld.ascet import syntax as e
from kennfeld.ascet.amd.components import ENUMERATION, AscetComponent, ComponentElement, MethodSignature
from kennfeld.ascet.amd.data_sets import DataEntry, DataSet
from kennfeld.ascet.amd.diagram import BlockDiagram, read_diagram
from kennfeld.ascet.amd.diagram_code import RESULT, DiagramCode, DiagramReferences
from kennfeld.ascet.amd.element_code import ElementCode
from kennfeld.ascet.amd.state_machine import MACHINE, state_machine
from kennfeld.ascet.parser import scan_esdl
from kennfeld.base.errors import Finding, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement

_CASTS: Final = ("cast", "implementationCast")
_HEAD: Final = "class C { void m() {"


@dataclass(frozen=True)
class ComponentCode:
    """The tree of a component, and findings on what is not read."""

    file: e.EsdlFile
    findings: tuple[Finding, ...] = ()


@dataclass(eq=False)
class ComponentTranslation:
    """Translates a component.

    Attributes:
        component: what it declares.
        package: name of its package.
        file: name of its `.specification.amd` file, for messages.
        specification: the root of that file, None if it has none.
        data_sets: its data sets; `entries` the values of its elements, by name.
        elements: declares elements.
        references: those of its diagrams.
    """

    component: AscetComponent
    package: str
    file: str
    specification: XmlElement | None
    data_sets: Sequence[DataSet]
    entries: Mapping[str, DataEntry]
    elements: ElementCode
    references: DiagramReferences
    findings: list[Finding] = field(default_factory=list)

    def translate(self) -> ComponentCode:
        """Return the tree of the component."""
        component = self.component
        if component.kind == ENUMERATION:
            labels = tuple((label, e.Number(float(number), False)) for label, number in component.labels)
            declared = e.TypeDeclaration(component.name, e.EnumType(labels), place=self._place(component.line))
            return ComponentCode(e.EsdlFile(self.file, self.package, (), (declared,)))
        is_machine = component.specification == "StateMachine"
        listed = [
            element
            for element in component.elements
            if element.basic_type not in _CASTS and not (is_machine and _is_state(element))
        ]
        own = [element for element in listed if not element.is_shared or element.basic_type == "dt"]
        shared = [element for element in listed if element.is_shared and element.basic_type != "dt"]
        machine, methods, variables = self._methods()
        declared_class = e.ClassDeclaration(
            component.name,
            (*(self.elements.element(element, self.entries.get(element.name)) for element in own), *variables),
            methods,
            (machine,) if machine is not None else (),
            tuple(self._initializers({element.name for element in own})),
            place=self._place(component.line),
        )
        constants = [
            e.Constant(self.elements.element(element, self.entries.get(element.name)),
                       place=self._place(element.line))
            for element in shared
        ]  # fmt: skip
        file = e.EsdlFile(self.file, self.package, (), (declared_class, *constants))
        return ComponentCode(file, tuple(self.findings))

    def _place(self, line: int) -> e.TextPosition:
        return e.TextPosition(line, 0, file=self.elements.file)

    def _initializers(self, names: set[str]) -> Iterator[e.Initializer]:
        """Yield the values of each data set of instances as an initializer of its name."""
        declared = {element.name: element for element in self.component.elements}
        for data_set in self.data_sets:
            if not data_set.is_shared:
                statements: list[e.Statement] = []
                for entry in data_set.entries:
                    if entry.element in names:
                        value = self.elements.element(declared[entry.element], entry).value
                        if value is not None:
                            statements.append(e.Assign(e.Name(entry.element), value))
                yield e.Initializer(data_set.name, tuple(statements))

    # methods

    def _methods(self) -> tuple[e.StateMachine | None, tuple[e.Method, ...], list[e.Element]]:
        """Return the state machine, the methods, and the variables that hold what tables search."""
        parts = _read_parts(self.specification)
        for diagram in parts.diagrams:
            self._add_findings(diagram)
        self._add_remarks(parts)
        codes = [DiagramCode(self.component, diagram, self.references) for diagram in parts.diagrams]
        methods = tuple(self._method(method, *self._body(method, parts, codes)) for method in self.component.methods)
        searched = {name for code in codes for names in code.searched.values() for name in names}
        variables = [e.Element(name, e.TypeName("real"), place=self._place(1)) for name in sorted(searched)]
        machine = parts.machine if isinstance(parts.machine, e.StateMachine) else None
        return machine, methods, variables

    def _body(
        self, method: MethodSignature, parts: "_SpecificationParts", codes: Sequence[DiagramCode]
    ) -> tuple[e.Statements | None, str]:
        """Return the statements of a method, None if it is written in C, and the state machine that it triggers."""
        if method.name in parts.triggers and parts.machine is not None:
            if isinstance(parts.machine, e.StateMachine):
                return (), MACHINE
            return (e.Evaluate(parts.machine),), ""
        if parts.is_code:
            return None, ""
        if method.name in parts.texts:
            return self._parsed(parts.texts[method.name]), ""
        return self._drawn(method, codes), ""

    def _method(self, method: MethodSignature, body: e.Statements | None, triggers: str) -> e.Method:
        result = None if method.result is None else self.elements.type(method.result, method.name)
        arguments = tuple(
            e.Argument(item.name, self.elements.type(item, method.name), place=self._place(item.line))
            for item in method.arguments
        )
        return e.Method(
            method.name, result, arguments, body, triggers,
            frozenset({"public" if method.is_public else "private"}),
            # a process is called by a task, which the annotation says in ESDL
            (e.Annotation("thread"),) if method.is_process else (),
            place=self._place(method.line),
        )  # fmt: skip

    def _drawn(self, method: MethodSignature, codes: Sequence[DiagramCode]) -> e.Statements:
        """Return the statements of a method that is drawn as blocks."""
        own = [code for code in codes if method.name in code.diagram.steps]
        place = self._place(method.line)
        if len(own) > 1:
            return (e.Evaluate(e.Unsupported("a method in several diagrams is not supported", place=place)),)
        body = own[0].body(method) if own else ()
        if method.result is None:
            return body
        kind = self.elements.type(method.result, method.name)
        declared = e.Declare(e.Element(RESULT, kind, place=place), place=place)
        return (declared, *body, e.Return(e.Name(RESULT, place=place), place=place))

    def _parsed(self, text: XmlElement) -> e.Statements:
        """Return the statements of a method that is written in ESDL."""
        block = next((item for item in text.walk() if item.tag == "CodeBlock"), text)
        # as many lines before it as in the file, so that messages name its lines
        parsed = scan_esdl("\n" * max(block.line - 1, 0) + _HEAD + _text_of(text) + "\n} }", self.file)
        if parsed.findings:
            return tuple(
                e.Evaluate(e.Unsupported(item.message, item.remedy, place=e.TextPosition(item.location.line, 0)))
                for item in parsed.findings
            )
        declared = parsed.file.declarations[0] if parsed.file.declarations else None
        if len(parsed.file.declarations) != 1 or not isinstance(declared, e.ClassDeclaration) or not declared.methods:
            place = e.TextPosition(block.line, 0)
            return (e.Evaluate(e.Unsupported("the text is not that of one method", place=place)),)
        return declared.methods[0].body or ()

    def _add_remarks(self, parts: "_SpecificationParts") -> None:
        """Add remarks on what a diagram leaves open."""
        texts = []
        if len(parts.priorities) > 1:
            texts.append("transitions of a state are tested in the order of their priorities, 1 first")
        if parts.has_temporaries:
            texts.append("outputs with a temporary variable are calculated at each use")
        location = Location(self.file, path=self.component.name)
        self.findings += [Finding(location, text, severity="remark") for text in texts]

    def _add_findings(self, diagram: BlockDiagram) -> None:
        for element in diagram.strange:
            message = f"the element {element.tag} of a diagram is not known and is ignored"
            location = Location(self.file, element.line, self.component.name)
            self.findings.append(Finding(location, message, severity="warning"))
        for step in diagram.unscheduled:
            name = step.block.get("elementName") or step.block.get("type")
            message = f"{name} has a connected input, but no method runs it"
            self.findings.append(
                Finding(Location(self.file, step.line, self.component.name), message, severity="remark")
            )


@dataclass(frozen=True)
class _SpecificationParts:
    """Parts of a `.specification.amd` file: diagrams, a state machine, texts of methods, or code in C.

    `triggers` are the methods that run the state machine, `priorities` those of its transitions, and `has_temporaries`
    says whether outputs are marked as temporary variables.
    """

    diagrams: tuple[BlockDiagram, ...] = ()
    machine: e.StateMachine | e.Unsupported | None = None
    triggers: frozenset[str] = frozenset()
    texts: Mapping[str, XmlElement] = field(default_factory=dict)
    is_code: bool = True
    priorities: frozenset[str] = frozenset()
    has_temporaries: bool = False


def _read_parts(root: XmlElement | None) -> _SpecificationParts:
    if root is None:
        return _SpecificationParts()
    items = list(root.walk())
    machines = [item for item in items if item.tag == "StateMachineSpecification"]
    of_machine = [item for machine in machines for item in machine.walk()]
    names = ((item.tag, item.get("triggerName") or item.get("methodName")) for item in of_machine)
    return _SpecificationParts(
        tuple(read_diagram(item) for item in items if item.tag == "BlockDiagramSpecification"),
        state_machine(machines[0]) if machines else None,
        frozenset(name for tag, name in names if tag in ("Transition", "MethodBody")),
        {item.get("methodName"): item for item in items if item.tag == "MethodBody" and _text_of(item)},
        any(item.tag == "CCodeSpecification" for item in items),
        frozenset(item.get("priority") for item in items if item.tag == "Transition"),
        any(item.is_true("tempVar") for item in items),
    )


def _is_state(element: ComponentElement) -> bool:
    """Return True for the element that holds the state of a state machine, whose labels are not in a file."""
    return element.basic_type == "enumeration" and not element.reference


def _text_of(body: XmlElement) -> str:
    """Return the text of a method; empty if it is drawn."""
    return next((item.text for item in body.walk() if item.text.strip()), "")
