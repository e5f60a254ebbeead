"""Sections to systems, blocks, ports, lines and masks.

A mask is a `<Mask>` element (since R2016), an object of class Simulink.Mask (since R2013), or one string each for all
variables, values and so on (before).
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import field, replace

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.model_tree import (
    Endpoint,
    LibraryLink,
    Mask,
    MaskParameter,
    ModelBlock,
    Ports,
    SignalLine,
    StoredChart,
    StoredWorkspace,
    System,
    join_path,
    normalize_path,
    split_arguments,
)
from kennfeld.importers.simulink.reader.section_tree import COMPLETE_COPY, ReadDiagnostics, SectionNode, normalize_name

_BAR = re.compile(r"(?<!\\)\|")  # separator of values unless escaped by a backslash
_VARIABLE = re.compile(r"\s*(\w+)\s*=\s*([@&])(\d+)\s*\Z")

_MAX_DEPTH = 60  # nested subsystems
_NAMING = frozenset({"BlockType", "Name", "SID", "Ports", "ClassName", "PropName", "ObjectID"})
# fields of a link itself, not of the block that it leads to
_LINKING = frozenset({
    "AncestorBlock", "ContentPreviewEnabled", "LibraryVersion", "LinkData", "Position", "SourceBlock",
    "SourceProductBaseCode", "SourceProductName", "SourceType", "ZOrder",
})  # fmt: skip
# fields of the drawing, which each link has for itself
_LOOKS = re.compile(
    r"(Font|Show|Name(Placement|Location)|(Fore|Back)groundColor|DropShadow|Block(Mirror|Rotation)|Mask)"
)
_ADDRESS = re.compile(r"(.*)#([A-Za-z]+)(?::(\d{1,9}))?\s*\Z", re.DOTALL)
_PORT = re.compile(r"\s*(?:([A-Za-z]+):?)?(\d{0,9})\s*\Z")
_NUMBER = re.compile(r"\d{1,6}")
_MODEL_KEYS = ("ModelNameDialog", "ModelFile", "ModelName")
# other words for the same ports, by layout
_SPECIAL = {"stateport": "state", "action": "ifaction"}
_MAX_PORTS = 10_000  # of a block
_RECORDING = "SigBuilderData"


def read_mask(block: SectionNode) -> Mask | None:
    """Read the mask in a block's section, None if it has none."""
    instance = block.first("InstanceData")
    # a link keeps its mask within InstanceData
    element = block.first("Mask") or (instance.first("Mask") if instance is not None else None)
    if element is not None:
        return _mask(element, element.all("MaskParameter"))
    section = next((p for p in block.parts if p.keys.get("PropName") == "MaskObject"), None)
    if section is not None:
        return _mask(section, _parameter_objects(section))
    return _flat(block) if block.keys.get("MaskVariables") or block.keys.get("MaskType") else None


def _mask(section: SectionNode, parameters: Iterable[SectionNode]) -> Mask:
    return Mask(section.get("Type"), tuple(map(_parameter, parameters)), section.get("Initialization"))


def _parameter_objects(mask: SectionNode) -> list[SectionNode]:
    """Return the parameter objects of a mask: a single one, or an array."""
    objects: list[SectionNode] = []
    for part in mask.parts:
        if part.keys.get("PropName") == "Parameters":
            objects += [inner for inner in part.parts if "Name" in inner.keys] if part.kind == "Array" else [part]
    return objects


def _parameter(section: SectionNode) -> MaskParameter:
    return MaskParameter(
        section.get("Name"),
        section.get("Value"),
        section.get("Type", "edit"),
        section.get("Evaluate", "on") != "off",
        _options(section),
    )


def _options(section: SectionNode) -> tuple[str, ...]:
    """Return the choices of a popup: a list, or an array."""
    arrays = (part for part in section.all("Array") if part.keys.get("PropName") == "TypeOptions")
    node = section.first("TypeOptions") or next(arrays, None)
    return tuple(part.text.strip() for part in node.parts) if node is not None else ()


def _flat(block: SectionNode) -> Mask:
    keys = block.keys
    values = dict(enumerate(_split(keys.get("MaskValueString", "")), 1))
    styles = dict(enumerate(map(_style, split_arguments(keys.get("MaskStyleString", ""))), 1))
    parameters = []
    # `gain=@1;note=&2;`: an expression (@) or a text (&), and the number of its value in MaskValueString
    for match in filter(None, map(_VARIABLE.match, keys.get("MaskVariables", "").split(";"))):
        at = int(match[3][:6])
        style, choices = styles.get(at, ("", ()))
        parameters.append(MaskParameter(match[1], values.get(at, ""), style or "edit", match[2] == "@", choices))
    return Mask(keys.get("MaskType", ""), tuple(parameters), keys.get("MaskInitialization", ""))


def _split(text: str) -> list[str]:
    return [value.replace("\\|", "|") for value in _BAR.split(text)]


def _style(text: str) -> tuple[str, tuple[str, ...]]:
    """Return the style of a dialog field, and the choices of a popup in brackets after it.

    >>> _style("popup(slow|fast)")
    ('popup', ('slow', 'fast'))
    """
    kind, _, rest = text.partition("(")
    choices = rest.removesuffix(")")
    return kind.strip(), tuple(_split(choices)) if choices else ()


@dataclass
class BlockReader:
    """Builds systems from sections.

    `load` returns the section of a system stored in a part of its own; `charts` are charts by block path, `defaults`
    block defaults by type. `data` returns the binary data that a field refers to.
    """

    diagnostics: ReadDiagnostics
    load: Callable[[str], SectionNode | None]
    charts: Mapping[str, StoredChart]
    defaults: Mapping[str, Mapping[str, str]]
    data: Callable[[str], StoredWorkspace | None]
    # parts of the file already read: each belongs to one block; sharing could multiply content without bound
    _used: set[str] = field(default_factory=set)

    def system(self, section: SectionNode, path: tuple[str, ...] = ()) -> System:
        """Build the system of a section with everything below it."""
        name = section.keys.get("Ref")
        if name is not None:
            return self._separate(name, path)
        if len(path) > _MAX_DEPTH:
            raise self.diagnostics.refuse(join_path(*path)[:80], f"has subsystems more than {_MAX_DEPTH} levels deep")
        parts, prefix = enumerate(section.all("Block")), f"{join_path(*path)}/" if path else ""
        blocks = self._distinct([self._block(part, number, path, prefix) for number, part in parts], path)
        return System(tuple(blocks), self._lines(section, blocks, path))

    def _separate(self, name: str, path: tuple[str, ...]) -> System:
        place = _short_path(path)
        if name in self._used:
            raise self.diagnostics.refuse(place, f"has its content in {name[:80]}, which is used twice")
        self._used.add(name)
        section = self.load(name)
        if section is None:
            message = f"has its content in {name[:80]}, which is missing or damaged"
            self.diagnostics.error(place, message, COMPLETE_COPY)
            return System()
        if "Ref" in section.keys:
            raise self.diagnostics.refuse(place, f"has its content in {name[:80]}, which contains no system")
        return self.system(section, path)

    def _block(self, section: SectionNode, number: int, parents: tuple[str, ...], prefix: str) -> ModelBlock:
        """Build the block of a section; `prefix` is the path of its parents, with a slash behind it."""
        keys = section.keys
        kind, name = keys.get("BlockType", ""), normalize_name(keys.get("Name", ""))
        path = f"{prefix}{join_path(name)}"
        instance = section.first("InstanceData")
        parameters = {key: value for key, value in keys.items() if key not in _NAMING}
        if instance is not None:
            parameters |= instance.keys
        parameters |= _bus_element(section)
        inner = section.first("System")
        chart = self.charts.get(path) if keys.get("SFBlockType", "NONE") != "NONE" else None
        return ModelBlock(
            type=kind,
            name=name,
            # SIDs are numbers and colons; the @ keeps those of older files apart from them
            sid=keys.get("SID") or f"{number + 1}@{path}",
            path=path,
            parameters=parameters,
            defaults=self.defaults.get(kind, {}),
            ports=self._checked_ports(section, path),
            mask=read_mask(section),
            reference=_reference(kind, parameters, instance),
            system=self.system(inner, (*parents, name)) if inner is not None else None,
            script=chart.script if chart is not None else "",
            chart=chart,
            model=next((keys[key] for key in _MODEL_KEYS if keys.get(key)), "") if kind == "ModelReference" else "",
            signals=_signals(section),
            lists=_lists(section),
            recording=self._recording(section),
        )

    def _recording(self, section: SectionNode) -> StoredWorkspace | None:
        """Return the signals of a Signal Builder, stored by reference in one of its inner blocks."""
        reference = section.elsewhere.get(_RECORDING) or section.keys.get(_RECORDING)
        return self.data(reference) if reference else None

    def _checked_ports(self, section: SectionNode, path: str) -> Ports | None:
        counted = _ports(section)
        most = max(counted.inputs, counted.outputs) if counted is not None else 0
        if most > _MAX_PORTS:
            raise self.diagnostics.refuse(path[:80], f"has {most} ports; at most {_MAX_PORTS} are supported")
        return counted

    def _distinct(self, blocks: list[ModelBlock], path: tuple[str, ...]) -> list[ModelBlock]:
        """Return the blocks, each with a unique SID, as lines that use names need it."""
        seen: set[str] = set()
        for number, block in enumerate(blocks):
            if block.sid in seen:
                message = f"{_short_path(path)} has two blocks with the SID {block.sid[:40]}"
                self.diagnostics.warn(f"{message}; lines with that SID are connected to the first")
                blocks[number] = block = replace(block, sid=f"{number + 1}@{block.path}")
            seen.add(block.sid)
        return blocks

    def _lines(self, section: SectionNode, blocks: list[ModelBlock], path: tuple[str, ...]) -> tuple[SignalLine, ...]:
        addresses = _Addresses(blocks)
        lines = [_line(part, addresses) for part in section.all("Line")]
        for unknown in addresses.unknown:
            message = f"has a line to the unknown block or port {unknown[:80]}; it is treated as unconnected"
            self.diagnostics.warn(f"{_short_path(path)} {message}")
        return tuple(lines)


def _short_path(path: tuple[str, ...]) -> str:
    return join_path(*path)[:80] or "the root"


class _Addresses:
    """Finds the blocks of one system by the SIDs or names that its lines use."""

    def __init__(self, blocks: list[ModelBlock]) -> None:
        self.by_sid = {block.sid: block for block in blocks}
        # reversed, so that the first of several blocks with one name is kept
        self.by_name = {block.name: block for block in reversed(blocks)}
        self.unknown: list[str] = []

    def end(self, section: SectionNode, side: str) -> Endpoint | None:
        """Read the source ("Src") or destination ("Dst") of a line or branch, None if it has none."""
        keys = section.keys
        if side in keys:
            # newer layouts write "12#out:1", with the SID; older ones SrcBlock "Gain" and SrcPort 1
            match = _ADDRESS.match(keys[side])
            block = self.by_sid.get(match[1]) if match else None
            return self._endpoint(block, keys[side], match[2] if match else "", match[3] if match else "")
        name = keys.get(f"{side}Block")
        if name is None:
            return None
        port = _PORT.match(keys.get(f"{side}Port", "1"))
        block = self.by_name.get(normalize_name(name))
        usual = "out" if side == "Src" else "in"
        return self._endpoint(block, name, (port[1] if port else "") or usual, port[2] if port else "")

    def _endpoint(self, block: ModelBlock | None, written: str, port: str, number: str | None) -> Endpoint | None:
        at = int(number) if number else 1
        if block is None or at > _MAX_PORTS:
            self.unknown.append(written if block is None else f"port {at} of {written}")
            return None
        kind = port.lower()
        return Endpoint(block.sid, _SPECIAL.get(kind, kind), at)

    def name(self, source: Endpoint | None) -> str:
        """Return the name that the source block gives its output."""
        if source is None or source.port != "out":
            return ""
        return self.by_sid[source.block].signals.get(source.number, "")


def _line(section: SectionNode, addresses: _Addresses) -> SignalLine:
    source = addresses.end(section, "Src")
    ends: list[Endpoint] = []
    waiting = [section]
    while waiting:
        branch = waiting.pop()
        end = addresses.end(branch, "Dst")
        if end is not None:
            ends.append(end)
        # reversed, so that the stack yields branches in file order
        waiting.extend(reversed(list(branch.all("Branch"))))
    return SignalLine(source, tuple(ends), normalize_name(section.keys.get("Name", "")) or addresses.name(source))


def _ports(block: SectionNode) -> Ports | None:
    """Return the port counts in `<PortCounts in="2" out="1"/>` or `Ports [2, 1]`."""
    counted = block.first("PortCounts")
    if counted is not None:
        return Ports(_count(counted.keys.get("in", "0")), _count(counted.keys.get("out", "0")))
    if "Ports" not in block.keys:
        return None
    # further numbers of `Ports [2, 1, 0, 1]` count control and physical ports
    return Ports(*map(_count, _NUMBER.findall(block.keys["Ports"])[:2]))


def _count(written: str) -> int:
    match = _NUMBER.match(written.strip())
    return int(match[0]) if match else 0


def _signals(block: SectionNode) -> dict[int, str]:
    """Return the signal names at the output ports."""
    properties = block.first("PortProperties")
    names = {}
    for port in (*block.all("Port"), *(properties.all("Port") if properties else ())):
        name = normalize_name(port.keys.get("Name", ""))
        if name and port.keys.get("Type", "out") == "out":
            names[_count(port.keys.get("Index") or port.keys.get("PortNumber", "1"))] = name
    return names


def _lists(section: SectionNode) -> dict[str, tuple[str, ...]]:
    """Return the parameters that are arrays of texts or one text per port."""
    arrays = {part.keys.get("PropName", ""): part for part in section.all("Array")}
    lists = {name: tuple(section.text for section in part.parts if not section.parts) for name, part in arrays.items()}
    stated = {part.keys.get("ListType", ""): part.keys for part in section.all("List")}
    return lists | {name: tuple(v for key, v in keys.items() if key != "ListType") for name, keys in stated.items()}


def _bus_element(section: SectionNode) -> dict[str, str]:
    """Return bus element fields of zip packages under their names in `.mdl` files."""
    lists = (node.keys for node in section.all("List") if node.keys.get("ListType") == "InterfaceData")
    fields = next(lists, {})
    if fields.get("IsComposite") != "1":
        return {}
    return {"IsBusElementPort": "on", "Element": fields.get("Element", ""), "PortName": fields.get("PortName", "")}


def _reference(kind: str, parameters: Mapping[str, str], instance: SectionNode | None) -> LibraryLink | None:
    source = parameters.get("SourceBlock")
    if kind != "Reference" or source is None:
        return None
    specific = instance.keys if instance is not None else {}
    # what stands in InstanceData sets the library block, even if its name is like one of a look
    rest = {key: value for key, value in parameters.items() if not _LOOKS.match(key)} | specific
    rest = {key: value for key, value in rest.items() if key not in _LINKING}
    return LibraryLink(normalize_path(source), parameters.get("SourceType", ""), rest)
