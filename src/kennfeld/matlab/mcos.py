"""Objects of classes in MATLAB files: their properties, which stand behind the variables.

The layout was worked out by the mat-io project: the subsystem, bytes that are again a file with a header of 8 bytes,
holds a struct with the object FileWrapper__. That is a cell array: its first cell ties names, classes, objects and
properties together by numbers, the others hold the values, the last one the defaults of the classes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.matlab.mat_nodes import (
    MOST_BYTES,
    MatCells,
    MatFileContent,
    MatFileError,
    MatNumbers,
    MatStruct,
    MatStructArray,
    MatText,
    MatUnreadable,
    Node,
    text_of,
)
from kennfeld.matlab.mat_v5 import elements_from

__all__ = ["opened", "single", "workspace"]

_TAG = 0xDD000000  # the first number of a reference
_VERSIONS = (2, 3, 4)
_OFFSETS = 8  # of the tables
_DEEPEST = 60
_MOST = 1_000_000  # objects and values; shared ones could multiply without end
_NAME, _VALUE = 0, 1  # what a property refers to
_HEADS = {b"\0\1IM": "<", b"\1\0MI": ">"}
_ALONE = "the file does not hold its properties"


def workspace(content: bytes, most_bytes: int = MOST_BYTES) -> MatFileContent:
    """The variables of a model workspace, as `modelWorkspace.mxarray` of a Simulink file keeps them.

    Its first array is a struct of the variables, or an array of structs with Name and Value; the subsystem follows.
    `DamageError` where it is no workspace.
    """
    loaded = _arrays(content, most_bytes)
    if not loaded.further:
        return loaded
    first, *behind = loaded.further
    if isinstance(first, MatUnreadable):
        return replace(loaded, variables={})
    return opened(replace(loaded, variables=_named(first), further=behind), most_bytes)


def single(content: bytes, most_bytes: int = MOST_BYTES) -> Node:
    """The array that bytes hold in the form of a model workspace; `DamageError` where they hold none."""
    loaded = _arrays(content, most_bytes)
    if not loaded.further:
        raise MatFileError(loaded.lost or "it holds no array")
    first, *behind = loaded.further
    return opened(replace(loaded, variables={"": first}, further=behind), most_bytes).variables[""]


def _arrays(content: bytes, most_bytes: int) -> MatFileContent:
    order = _HEADS.get(content[:4])
    if order is None:
        raise MatFileError("it does not begin like a workspace")
    return elements_from(memoryview(content), 8, order, most_bytes, _MOST)


def _named(node: Node) -> dict[str, Node]:
    if isinstance(node, MatStruct) and not (_is_pair(node) and len(node.fields) == 2):
        return dict(node.fields)
    if isinstance(node, MatNumbers) and not node.values.size:
        return {}
    pairs = node.elements if isinstance(node, MatStructArray) else [node] if isinstance(node, MatStruct) else None
    if pairs is None or not all(map(_is_pair, pairs)):
        raise MatFileError("it holds no variables")
    return {text_of(pair.fields["Name"]): pair.fields["Value"] for pair in pairs}


def _is_pair(node: MatStruct) -> bool:
    """Whether a struct is one variable with its name."""
    return "Value" in node.fields and isinstance(node.fields.get("Name"), MatText)


def opened(loaded: MatFileContent, most_bytes: int = MOST_BYTES) -> MatFileContent:
    """The same with objects as structs of their properties, which stand behind the variables."""
    objects = _behind(loaded.further, most_bytes)
    return replace(loaded, variables={name: objects.told(node) for name, node in loaded.variables.items()})


def _behind(further: Sequence[Node], most_bytes: int) -> "Objects":
    """The objects of a file; where there are none, one that says why."""
    why = _ALONE
    for node in further:
        try:
            cells = _wrapped(_subsystem(node, most_bytes))
            if cells is not None:
                return Objects(cells)
        except MatFileError as error:
            why = str(error)
    return Objects(None, why)


def _subsystem(node: Node, most_bytes: int) -> Node | None:
    """What stands in the bytes of a subsystem; version 7.3 has it without that wrapping."""
    if isinstance(node, MatUnreadable) and node.why:
        raise MatFileError(node.why)
    if not isinstance(node, MatNumbers):
        return node
    raw = _bytes(node)
    loaded = elements_from(memoryview(raw), 8, "<" if raw[2:4] == b"IM" else ">", most_bytes, _MOST)
    first = next(iter(loaded.further), None)
    if loaded.damage and not isinstance(first, MatStruct):
        raise MatFileError(loaded.damage)
    return first


def _wrapped(subsystem: Node | None) -> MatCells | None:
    """The cells with all that a subsystem knows of objects."""
    wrapper = subsystem.fields.get("MCOS") if isinstance(subsystem, MatStruct) else None
    cells = wrapper.reference if isinstance(wrapper, MatUnreadable) else None
    if isinstance(wrapper, MatUnreadable) and wrapper.why:
        raise MatFileError(wrapper.why)
    return cells if isinstance(cells, MatCells) else None


class Objects:
    """The objects of one file; without `cells` none of them is known, and `why` says the reason."""

    def __init__(self, cells: MatCells | None, why: str = "") -> None:
        self.why = why
        self.left = _MOST
        self.within: list[int] = []  # the objects around what is opened
        self.cells = cells.cells if cells is not None else []
        if cells is not None:
            self._read()

    def _read(self) -> None:
        if len(self.cells) < 3 or not isinstance(table := self.cells[0], MatNumbers):
            raise MatFileError("the table of its objects is missing")
        raw = _bytes(table)
        self.words = np.frombuffer(raw[: len(raw) // 4 * 4], dtype="<u4").astype(np.int64)
        if self.words.size < 2 + _OFFSETS or int(self.words[0]) not in _VERSIONS:
            raise MatFileError("the table of its objects is of an unknown version")
        starts = [int(n) for n in self.words[2 : 2 + _OFFSETS]]
        if any(start > len(raw) for start in starts):
            raise MatFileError("the table of its objects is cut off")
        self.names = [name.decode("utf-8", "replace") for name in raw[8 + 4 * _OFFSETS : starts[0]].split(b"\0")]
        self.classes = self._rows(starts[0], starts[1], 4)
        self.stored = self._blocks(starts[1], starts[2])
        self.objects = self._rows(starts[2], starts[3], 6)
        self.plain = self._blocks(starts[3], starts[4])

    def told(self, node: Node, depth: int = 0) -> Node:
        """A node with the objects in it; one whose objects are damaged says why, and takes no other with it."""
        try:
            return self.resolved(node, depth)
        except MatFileError as error:
            return MatUnreadable(node.kind if isinstance(node, MatUnreadable) else "object", why=str(error))

    def resolved(self, node: Node, depth: int = 0) -> Node:
        """A node with the objects in it as structs of their properties; what is none stays unreadable."""
        self.left -= 1
        if depth > _DEEPEST or self.left < 0:
            raise MatFileError("its objects hold each other too deeply")
        if isinstance(node, MatUnreadable):
            return node if node.reference is None else self._referred(node, node.reference, depth)
        if isinstance(node, MatNumbers) and _is_reference(node):
            return self._referred(MatUnreadable("object", node), node, depth)
        if isinstance(node, MatStruct):
            return MatStruct({name: self.resolved(inner, depth + 1) for name, inner in node.fields.items()}, node.kind)
        if isinstance(node, MatStructArray):
            elements = [self.resolved(element, depth + 1) for element in node.elements]
            return MatStructArray([element for element in elements if isinstance(element, MatStruct)], node.shape)
        if isinstance(node, MatCells):
            return MatCells([self.resolved(cell, depth + 1) for cell in node.cells], node.shape)
        return node

    def _referred(self, node: MatUnreadable, reference: Node | None, depth: int) -> Node:
        """The objects of a reference: tag, number of dimensions, sizes, a number for each object, that of the class."""
        if self.why:
            return replace(node, why=self.why)
        if not isinstance(reference, MatNumbers) or not _is_reference(reference):
            return replace(node, why="it is an enumeration or an object without numbers")
        numbers = [int(n) for n in reference.values.ravel(order="F")]
        sizes = numbers[2 : 2 + numbers[1]]
        given = numbers[2 + len(sizes) : -1]
        if len(given) != int(np.prod(sizes, dtype=float)) or len(given) > self.left:
            raise MatFileError("the numbers of its objects make no sense")
        made = [self._object(number, numbers[-1], depth) for number in given]
        if len(made) == 1:
            return made[0]
        structs = [one for one in made if isinstance(one, MatStruct)]
        return MatStructArray(structs, tuple(sizes)) if len(structs) == len(made) else node

    def _object(self, number: int, of: int, depth: int) -> Node:
        if not 0 < number < len(self.objects):
            raise MatFileError(f"it holds no object {number}")
        if number in self.within:
            raise MatFileError("its objects hold each other too deeply")
        class_, _, _, stored, plain, _ = self.objects[number]
        block = self._block(self.stored, stored) if stored else self._block(self.plain, plain)
        fields = dict(self._defaults(class_ or of)) | self._stated(block)
        self.within.append(number)
        try:
            return MatStruct(
                {name: self.told(inner, depth + 1) for name, inner in fields.items()}, self._class(class_ or of)
            )
        finally:
            self.within.pop()

    def _class(self, number: int) -> str:
        if not 0 < number < len(self.classes):
            raise MatFileError(f"it holds no class {number}")
        return ".".join(part for part in map(self._name, self.classes[number][:2]) if part)

    def _stated(self, block: list[tuple[int, int, int]]) -> dict[str, Node]:
        """What an object says of itself."""
        fields: dict[str, Node] = {}
        for name, sort, at in block:
            if sort == _VALUE:
                fields[self._name(name)] = self._cell(at)
            elif sort == _NAME:
                fields[self._name(name)] = MatText(self._name(at))
        return fields

    def _cell(self, at: int) -> Node:
        if not 0 <= at < len(self.cells) - 2:
            raise MatFileError("a property of an object has no value")
        return self.cells[at + 2]

    def _defaults(self, kind: int) -> Mapping[str, Node]:
        table = self.cells[-1]
        given = table.cells[kind] if isinstance(table, MatCells) and 0 < kind < len(table.cells) else None
        return given.fields if isinstance(given, MatStruct) else {}

    def _name(self, index: int) -> str:
        """A name by its number from 1; empty for 0."""
        if not 0 <= index <= len(self.names):
            raise MatFileError(f"it holds no name {index}")
        return self.names[index - 1] if index else ""

    def _rows(self, start: int, stop: int, width: int) -> list[tuple[int, ...]]:
        words = self.words[start // 4 : max(start, stop) // 4]
        return [tuple(int(n) for n in words[at : at + width]) for at in range(0, words.size // width * width, width)]

    def _blocks(self, start: int, stop: int) -> list[list[tuple[int, int, int]]]:
        """Blocks of properties: their count, three numbers for each (name, sort, value), a gap up to 8 bytes."""
        at, end, blocks = start // 4, max(start, stop) // 4, []
        while at < end:
            count = int(self.words[at])
            if count < 0 or at + 1 + 3 * count > end:
                raise MatFileError("the table of its objects is cut off")
            rows = self.words[at + 1 : at + 1 + 3 * count].reshape(-1, 3)
            blocks.append([(int(a), int(b), int(c)) for a, b, c in rows])
            at += (1 + 3 * count + 1) // 2 * 2
        return blocks

    @staticmethod
    def _block(blocks: list[list[tuple[int, int, int]]], number: int) -> list[tuple[int, int, int]]:
        if not 0 <= number < len(blocks):
            raise MatFileError(f"it holds no properties {number}")
        return blocks[number]


def _bytes(node: MatNumbers) -> bytes:
    return node.values.ravel(order="F").astype(np.uint8).tobytes()


def _is_reference(node: MatNumbers) -> bool:
    values = node.values
    return values.size >= 5 and values.dtype.kind in "ui" and int(values.flat[0]) & 0xFFFFFFFF == _TAG
