"""Block diagrams as nets: blocks with ports, and which output each input is connected to.

A connection joins two ports. The connectors of a hierarchy join a port outside with one inside by their name. All ports
that are joined form a net, which has one output.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import Final

from kennfeld.ascet.amd.components import whole
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement

_OUTPUTS: Final = ("ReturnPort", "MemberGetPort")
_BLOCKS: Final = ("SimpleElement", "ComplexElement", "Operator", "Literal", "Control", "ImplementationCast")
_DRAWN: Final = ("Comment", "Connection", "Hierarchy", "HierarchyConnector", "State", "Transition")
_ID: Final = "graphicOID"
_NO_ID: Final = "-1"


@dataclass(frozen=True, eq=False)
class BlockPort:
    """A port of a block; its inputs are those in the order of the file."""

    block: XmlElement
    element: XmlElement

    @property
    def name(self) -> str:
        """The name of the argument or element that the port stands for."""
        return self.element.get("elementName") or self.element.get("name")

    @property
    def index(self) -> int | None:
        """Its position, of a port of an operator."""
        return whole(self.element.get("index"))


@dataclass(frozen=True, eq=False)
class SequenceStep:
    """A block that acts in a sequence: `port` is its input, method or member; `order` its sequence number."""

    block: XmlElement
    port: XmlElement
    order: int
    line: int


Branch = tuple[str, int]  # identifier of a control block, and index of its output


@dataclass(eq=False)
class BlockDiagram:
    """A block diagram.

    Attributes:
        blocks: all blocks, also those within hierarchies.
        steps: steps of each method by its name.
        branches: steps below each output of a control block.
        unscheduled: steps whose input is connected although no method runs them.
        strange: elements that are not known.
    """

    blocks: list[XmlElement] = field(default_factory=list)
    steps: dict[str, list[SequenceStep]] = field(default_factory=lambda: defaultdict(list))
    branches: dict[Branch, list[SequenceStep]] = field(default_factory=lambda: defaultdict(list))
    unscheduled: list[SequenceStep] = field(default_factory=list)
    strange: list[XmlElement] = field(default_factory=list)
    _nets: dict[str, str] = field(default_factory=dict)
    _outputs: dict[str, list[BlockPort]] = field(default_factory=lambda: defaultdict(list))

    def sources(self, port: XmlElement) -> Sequence[BlockPort]:
        """Return the outputs that an input is connected to; there should be one."""
        return self.sources_of(port.get(_ID))

    def sources_of(self, identifier: str) -> Sequence[BlockPort]:
        """Return the outputs that are connected to a port by its identifier."""
        return self._outputs.get(self._net(identifier), ()) if identifier else ()

    def _net(self, identifier: str) -> str:
        # union-find: each port leads to another one of its net, the root to itself
        nets = self._nets
        root = identifier
        while nets.get(root, root) != root:
            root = nets[root]
        while nets.get(identifier, identifier) != root:  # shorten the way for the next time
            nets[identifier], identifier = root, nets[identifier]
        return root

    def _join(self, first: str, second: str) -> None:
        if first and second and _NO_ID not in (first, second):
            self._nets.setdefault(first, first)
            self._nets.setdefault(second, second)
            self._nets[self._net(second)] = self._net(first)


def read_diagram(specification: XmlElement) -> BlockDiagram:
    """Read the diagram of a `BlockDiagramSpecification`."""
    diagram = BlockDiagram()
    waiting = list(specification.all("DiagramElements"))
    while waiting:
        for drawn in waiting.pop().all("DiagramElement"):
            for item in drawn.children:
                if item.tag == "Connection":
                    _connect(diagram, item)
                elif item.tag == "Hierarchy":
                    waiting += _enter(diagram, item)
                elif item.tag in _BLOCKS:
                    diagram.blocks.append(item)
                elif item.tag not in _DRAWN:
                    diagram.strange.append(item)
    # the order of the file, which the stack of hierarchies has changed
    diagram.blocks.sort(key=lambda block: block.begin)
    # after all connections: a join may give a net another root
    for block in diagram.blocks:
        for port in _ports(block):
            if port.tag in _OUTPUTS:
                diagram._outputs[diagram._net(port.get(_ID))].append(BlockPort(block, port))
    for block in diagram.blocks:
        _schedule(diagram, block)
    for steps in (*diagram.steps.values(), *diagram.branches.values()):
        steps.sort(key=lambda step: step.order)
    return diagram


def _connect(diagram: BlockDiagram, connection: XmlElement) -> None:
    ends = [end.get(_ID) for end in connection.all("Start", "End")]
    if len(ends) == 2:
        diagram._join(ends[0], ends[1])


def _enter(diagram: BlockDiagram, hierarchy: XmlElement) -> Iterator[XmlElement]:
    """Join the connectors of a hierarchy with the ports inside, and yield its contents."""
    inside: dict[str, str] = {}
    for content in hierarchy.all("Contents"):
        for drawn in content.all("DiagramElement"):
            inside |= {item.get("name"): item.get(_ID) for item in drawn.all("HierarchyConnector")}
        yield content
    for interface in hierarchy.all("Interfaces"):
        for item in interface.all("BlockInterface"):
            for outer in item.walk():
                if outer.tag in ("ExternalConnector", "ConnectionPoint"):
                    diagram._join(outer.get(_ID), inside.get(item.get("name"), ""))


def _ports(block: XmlElement) -> Iterator[XmlElement]:
    interfaces = block.first("Interfaces")
    return iter(()) if interfaces is None else (item for item in interfaces.walk() if _ID in item.attributes)


def interface_ports(block: XmlElement) -> list[XmlElement]:
    """Return the ports of a block that are not within another port."""
    interfaces = block.first("Interfaces")
    return [] if interfaces is None else interfaces.children


def _schedule(diagram: BlockDiagram, block: XmlElement) -> None:
    """Add the steps of a block to the methods or branches that run them."""
    for port in interface_ports(block):
        call = port.first("SequenceCall")
        if call is None:
            continue
        step = SequenceStep(block, port, whole(call.get("sequenceNumber")) or 0, block.line)
        if method := call.get("methodName"):
            diagram.steps[method].append(step)
            continue
        controls = [out for out in diagram.sources_of(call.get("connectOID")) if out.block.tag == "Control"]
        if controls:
            for out in controls:
                diagram.branches[out.block.get(_ID), out.index or 0].append(step)
        elif any(diagram.sources(own) for own in (port, *port.all("SelectorPort")) if own.tag != "MethodPort"):
            diagram.unscheduled.append(step)
