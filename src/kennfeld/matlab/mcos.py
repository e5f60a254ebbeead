"""Objects of classes in MATLAB files, whose properties are stored behind the variables.

Layout: mat-io project. The subsystem, bytes that form a file with a header of 8 bytes, holds a struct with the object
FileWrapper__, a cell array. Its first cell links names, classes, objects and properties by numbers; the others hold the
values, the last one the defaults of the classes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.matlab import mat_nodes as n
from kennfeld.matlab.builtin_objects import convert_builtins
from kennfeld.matlab.mat_v5 import read_elements

_TAG = 0xDD000000  # the first number of a reference
_VERSIONS = (2, 3, 4)
_OFFSETS = 8  # number of table offsets
_MAX_DEPTH = 60
_MAX_OBJECTS = 1_000_000  # objects and values; shared ones could multiply endlessly
_NAME, _VALUE = 0, 1  # sorts of property values
_HEADS = {b"\0\1IM": "<", b"\1\0MI": ">"}
_NO_SUBSYSTEM = "the file does not contain its properties"


def read_workspace(content: bytes, max_bytes: int = n.MAX_BYTES) -> n.MatFileContent:
    """Read the variables of a model workspace, the part `modelWorkspace.mxarray` of a Simulink file.

    Its first array is a struct of the variables, or an array of structs with Name and Value; the subsystem follows.

    Raises:
        MatFileError: The content is not a workspace.
    """
    loaded = _arrays(content, max_bytes)
    if not loaded.further:
        return loaded
    first, *behind = loaded.further
    if isinstance(first, n.MatUnreadable):
        return replace(loaded, variables={})
    return resolve_objects(replace(loaded, variables=_variables_of(first), further=behind), max_bytes)


def read_array(content: bytes, max_bytes: int = n.MAX_BYTES) -> n.Node:
    """Read the single array of content in the form of a workspace; raises `MatFileError` if there is none."""
    loaded = _arrays(content, max_bytes)
    if not loaded.further:
        raise n.MatFileError(loaded.lost or "no array found")
    first, *behind = loaded.further
    return resolve_objects(replace(loaded, variables={"": first}, further=behind), max_bytes).variables[""]


def _arrays(content: bytes, max_bytes: int) -> n.MatFileContent:
    order = _HEADS.get(content[:4])
    if order is None:
        raise n.MatFileError("unknown header")
    return read_elements(memoryview(content), 8, order, max_bytes, _MAX_OBJECTS)


def _variables_of(node: n.Node) -> dict[str, n.Node]:
    # one variable in the form of Name and Value is a struct of these two fields, not one with two variables
    if isinstance(node, n.MatStruct) and not (_is_pair(node) and len(node.fields) == 2):
        return dict(node.fields)
    if isinstance(node, n.MatNumbers) and not node.values.size:
        return {}
    pairs = node.elements if isinstance(node, n.MatStructArray) else [node] if isinstance(node, n.MatStruct) else None
    if pairs is None or not all(map(_is_pair, pairs)):
        raise n.MatFileError("no variables found")
    return {n.node_text(pair.fields["Name"]): pair.fields["Value"] for pair in pairs}


def _is_pair(node: n.MatStruct) -> bool:
    """Return True if a struct holds the name and the value of a variable."""
    return "Value" in node.fields and isinstance(node.fields.get("Name"), n.MatText)


def resolve_objects(loaded: n.MatFileContent, max_bytes: int = n.MAX_BYTES) -> n.MatFileContent:
    """Replace the references to objects by structs of their properties."""
    objects = _find_objects(loaded.further, max_bytes)
    resolved = {name: objects.resolve_safely(node) for name, node in loaded.variables.items()}
    return replace(loaded, variables={name: convert_builtins(node) for name, node in resolved.items()})


def _find_objects(further: Sequence[n.Node], max_bytes: int) -> "Objects":
    """Return the objects of a file; without any, an instance that gives the reason."""
    why = _NO_SUBSYSTEM
    for node in further:
        try:
            cells = _object_cells(_subsystem(node, max_bytes))
            if cells is not None:
                return Objects(cells)
        except n.MatFileError as error:
            why = str(error)
    return Objects(None, why)


def _subsystem(node: n.Node, max_bytes: int) -> n.Node | None:
    """Return the content of a subsystem; version 7.3 stores it without the wrapping bytes."""
    if isinstance(node, n.MatUnreadable) and node.why:
        raise n.MatFileError(node.why)
    if not isinstance(node, n.MatNumbers):
        return node
    raw = _bytes(node)
    # a header of 8 bytes: version, byte order, and four more
    loaded = read_elements(memoryview(raw), 8, "<" if raw[2:4] == b"IM" else ">", max_bytes, _MAX_OBJECTS)
    first = next(iter(loaded.further), None)
    if loaded.damage and not isinstance(first, n.MatStruct):
        raise n.MatFileError(loaded.damage)
    return first


def _object_cells(subsystem: n.Node | None) -> n.MatCells | None:
    """Return the cells that describe the objects."""
    wrapper = subsystem.fields.get("MCOS") if isinstance(subsystem, n.MatStruct) else None
    cells = wrapper.reference if isinstance(wrapper, n.MatUnreadable) else None
    if isinstance(wrapper, n.MatUnreadable) and wrapper.why:
        raise n.MatFileError(wrapper.why)
    return cells if isinstance(cells, n.MatCells) else None


class Objects:
    """The objects of one file; without `cells` none can be resolved, for the reason `why`."""

    def __init__(self, cells: n.MatCells | None, why: str = "") -> None:
        self.why = why
        self.remaining = _MAX_OBJECTS
        self.within: list[int] = []  # the objects being resolved, outermost first
        self.cells = cells.cells if cells is not None else []
        if cells is not None:
            self._read()

    def _read(self) -> None:
        if len(self.cells) < 3 or not isinstance(table := self.cells[0], n.MatNumbers):
            raise n.MatFileError("the object table is missing")
        # 32-bit words, little-endian: version, number of names, 8 offsets in bytes; then the names, each
        # ended by a zero byte, up to the first offset
        raw = _bytes(table)
        self.words = np.frombuffer(raw[: len(raw) // 4 * 4], dtype="<u4").astype(np.int64)
        if self.words.size < 2 + _OFFSETS or int(self.words[0]) not in _VERSIONS:
            raise n.MatFileError("the object table has an unknown version")
        starts = [int(n) for n in self.words[2 : 2 + _OFFSETS]]
        if any(start > len(raw) for start in starts):
            raise n.MatFileError("the object table is truncated")
        self.names = [name.decode("utf-8", "replace") for name in raw[8 + 4 * _OFFSETS : starts[0]].split(b"\0")]
        # a row each: numbers of the names of package and class, and two others
        self.classes = self._rows(starts[0], starts[1], 4)
        self.stored = self._blocks(starts[1], starts[2])
        # a row each: class, two others, block in `stored`, block in `plain`, another; row 0 stands for none
        self.objects = self._rows(starts[2], starts[3], 6)
        self.plain = self._blocks(starts[3], starts[4])

    def resolve_safely(self, node: n.Node, depth: int = 0) -> n.Node:
        """Resolve a node; a damaged object becomes unreadable with the reason."""
        try:
            return self.resolve(node, depth)
        except n.MatFileError as error:
            return n.MatUnreadable(node.kind if isinstance(node, n.MatUnreadable) else "object", why=str(error))

    def resolve(self, node: n.Node, depth: int = 0) -> n.Node:
        """Replace the references in a node by structs of properties; unresolved ones stay unreadable."""
        self.remaining -= 1
        if depth > _MAX_DEPTH or self.remaining < 0:
            raise n.MatFileError("its objects are nested too deeply")
        if isinstance(node, n.MatUnreadable):
            return node if node.reference is None else self._resolve_reference(node, node.reference, depth)
        if isinstance(node, n.MatNumbers) and _is_reference(node):
            return self._resolve_reference(n.MatUnreadable("object", node), node, depth)
        if isinstance(node, n.MatStruct):
            return n.MatStruct({name: self.resolve(inner, depth + 1) for name, inner in node.fields.items()}, node.kind)
        if isinstance(node, n.MatStructArray):
            elements = [self.resolve(element, depth + 1) for element in node.elements]
            return n.MatStructArray([element for element in elements if isinstance(element, n.MatStruct)], node.shape)
        if isinstance(node, n.MatCells):
            return n.MatCells([self.resolve(cell, depth + 1) for cell in node.cells], node.shape)
        return node

    def _resolve_reference(self, node: n.MatUnreadable, reference: n.Node | None, depth: int) -> n.Node:
        """Resolve a reference: tag, number of dimensions, sizes, an object number each, class number."""
        if self.why:
            return replace(node, why=self.why)
        if not isinstance(reference, n.MatNumbers) or not _is_reference(reference):
            return replace(node, why="it is an enumeration or an object without references")
        numbers = [int(n) for n in reference.values.ravel(order="F")]
        sizes = numbers[2 : 2 + numbers[1]]
        # the last number is the class
        objects = numbers[2 + len(sizes) : -1]
        if len(objects) != int(np.prod(sizes, dtype=float)) or len(objects) > self.remaining:
            raise n.MatFileError("the object references are inconsistent")
        resolved = [self._object(number, numbers[-1], depth) for number in objects]
        if len(resolved) == 1:
            return resolved[0]
        structs = [item for item in resolved if isinstance(item, n.MatStruct)]
        return n.MatStructArray(structs, tuple(sizes)) if len(structs) == len(resolved) else node

    def _object(self, number: int, of: int, depth: int) -> n.Node:
        if not 0 < number < len(self.objects):
            raise n.MatFileError(f"object {number} not found")
        # an object may refer to itself through others, as a child to its parent
        if number in self.within:
            raise n.MatFileError("its objects are nested too deeply")
        class_, _, _, stored, plain, _ = self.objects[number]
        block = self._block(self.stored, stored) if stored else self._block(self.plain, plain)
        fields = dict(self._defaults(class_ or of)) | self._own_properties(block)
        self.within.append(number)
        try:
            return n.MatStruct(
                {name: self.resolve_safely(inner, depth + 1) for name, inner in fields.items()},
                self._class(class_ or of),
            )
        finally:
            self.within.pop()

    def _class(self, number: int) -> str:
        if not 0 < number < len(self.classes):
            raise n.MatFileError(f"class {number} not found")
        return ".".join(part for part in map(self._name, self.classes[number][:2]) if part)

    def _own_properties(self, block: list[tuple[int, int, int]]) -> dict[str, n.Node]:
        """Return the properties that an object sets itself."""
        fields: dict[str, n.Node] = {}
        for name, sort, at in block:
            if sort == _VALUE:
                fields[self._name(name)] = self._cell(at)
            elif sort == _NAME:
                fields[self._name(name)] = n.MatText(self._name(at))
        return fields

    def _cell(self, at: int) -> n.Node:
        if not 0 <= at < len(self.cells) - 2:
            raise n.MatFileError("a property of an object has no value")
        # the first two cells are the object table and an unused one
        return self.cells[at + 2]

    def _defaults(self, kind: int) -> Mapping[str, n.Node]:
        table = self.cells[-1]
        defaults = table.cells[kind] if isinstance(table, n.MatCells) and 0 < kind < len(table.cells) else None
        return defaults.fields if isinstance(defaults, n.MatStruct) else {}

    def _name(self, index: int) -> str:
        """Return a name by its number from 1; empty for 0."""
        if not 0 <= index <= len(self.names):
            raise n.MatFileError(f"name {index} not found")
        return self.names[index - 1] if index else ""

    def _rows(self, start: int, stop: int, width: int) -> list[tuple[int, ...]]:
        words = self.words[start // 4 : max(start, stop) // 4]
        return [tuple(int(n) for n in words[at : at + width]) for at in range(0, words.size // width * width, width)]

    def _blocks(self, start: int, stop: int) -> list[list[tuple[int, int, int]]]:
        """Return blocks of properties: a count, then name, sort and value of each, padded to 8 bytes."""
        at, end, blocks = start // 4, max(start, stop) // 4, []
        while at < end:
            count = int(self.words[at])
            if count < 0 or at + 1 + 3 * count > end:
                raise n.MatFileError("the object table is truncated")
            rows = self.words[at + 1 : at + 1 + 3 * count].reshape(-1, 3)
            blocks.append([(int(a), int(b), int(c)) for a, b, c in rows])
            at += (1 + 3 * count + 1) // 2 * 2
        return blocks

    @staticmethod
    def _block(blocks: list[list[tuple[int, int, int]]], number: int) -> list[tuple[int, int, int]]:
        if not 0 <= number < len(blocks):
            raise n.MatFileError(f"properties {number} not found")
        return blocks[number]


def _bytes(node: n.MatNumbers) -> bytes:
    return node.values.ravel(order="F").astype(np.uint8).tobytes()


def _is_reference(node: n.MatNumbers) -> bool:
    values = node.values
    return values.size >= 5 and values.dtype.kind in "ui" and int(values.flat[0]) & 0xFFFFFFFF == _TAG
