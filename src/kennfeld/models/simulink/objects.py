"""The properties of objects in a MAT-file: the subsystem that is kept behind the variables.

Its layout was worked out by the mat-io project: a cell array, whose first cell ties names, classes, objects and
properties together by numbers, whose further cells hold the values, and whose last holds the defaults of classes.
"""

import numpy as np

from kennfeld.models.simulink.data import Entry, Value, entry_of
from kennfeld.models.simulink.mat5 import Mat5Error, Opaque, Plain, Reader, Unread, elements

__all__ = ["Objects", "objects_of"]

_TAG = 0xDD000000  # the first number of a reference to an object
_VERSIONS = (2, 3, 4)
_OFFSETS = 8  # of the regions; versions before 4 leave the last two 0
_NEEDED = ("Value", "Table", "Breakpoints")
_DEEPEST = 20
_MOST = 1_000_000  # objects and values in one file; shared ones could multiply without end


class Objects:
    """The objects of one file."""

    def __init__(self, cells: tuple[Plain, ...]) -> None:
        if len(cells) < 3 or not isinstance(cells[0], np.ndarray):
            raise Mat5Error("the table of its objects is missing")
        self.cells = cells
        self.left = _MOST
        raw = cells[0].astype(np.uint8).tobytes(order="F")
        words = np.frombuffer(raw[: len(raw) // 4 * 4], dtype="<u4").astype(np.int64)
        if words.size < 3 or int(words[0]) not in _VERSIONS:
            raise Mat5Error("the table of its objects is of an unknown version")
        offsets = [int(n) for n in words[2 : 2 + _OFFSETS]]
        if len(offsets) < _OFFSETS or any(n > len(raw) for n in offsets):
            raise Mat5Error("the table of its objects is cut off")
        self.names = [name.decode("utf-8", "replace") for name in raw[8 + 4 * _OFFSETS : offsets[0]].split(b"\0")]
        self.words = words
        self.classes = self._table(offsets[0], offsets[1], 4)
        self.stored = self._blocks(offsets[1], offsets[2])
        self.objects = self._table(offsets[2], offsets[3], 6)
        self.plain = self._blocks(offsets[3], offsets[4])

    def value(self, given: Plain, depth: int = 0) -> Value:
        """A value with the objects in it by their properties; raises `Mat5Error` where there is no such object."""
        self.left -= 1
        if depth > _DEEPEST or self.left < 0:
            raise Mat5Error("its objects hold each other too deeply")
        if isinstance(given, Unread):
            raise Mat5Error(given.why)
        if isinstance(given, Opaque):
            return self._referred(given.reference, depth)
        if isinstance(given, np.ndarray):
            return self._referred(given, depth) if _is_reference(given) else given
        if isinstance(given, str):
            return given
        if isinstance(given, tuple):
            return tuple(self.value(inner, depth + 1) for inner in given)
        return {name: self.value(inner, depth + 1) for name, inner in given.items()}

    def _referred(self, reference: Plain, depth: int) -> Value:
        """The object of a reference, or a tuple of several: tag, number of dimensions, sizes, objects, class."""
        if not isinstance(reference, np.ndarray) or not _is_reference(reference):
            raise Mat5Error("it is an enumeration or an object without numbers")
        numbers = [int(n) for n in reference.ravel(order="F")]
        sizes = numbers[2 : 2 + numbers[1]] if len(numbers) > 2 else []
        count = int(np.prod(sizes, dtype=float)) if sizes else 0
        found = numbers[2 + len(sizes) : -1]
        if len(found) != count or count > self.left:
            raise Mat5Error("the numbers of its objects make no sense")
        made = tuple(self._object(number, numbers[-1], depth) for number in found)
        return made[0] if len(made) == 1 else made

    def _object(self, number: int, kind: int, depth: int) -> Entry | Value:
        if not 0 < number < len(self.objects):
            raise Mat5Error(f"the file holds no object {number}")
        of_class, _, _, stored, plain, _ = self.objects[number]
        name = self._class(of_class or kind)
        block = self._block(self.stored, stored) if stored else self._block(self.plain, plain)
        properties: dict[str, Value] = {}
        for index, sort, value in block:
            if sort == 1:
                self._property(self._name(index), value, properties, depth)
            elif sort == 0:
                properties[self._name(index)] = self._name(value)
        defaults = self._defaults(of_class or kind, properties, depth)
        return entry_of("", name, {**defaults, **properties})

    def _property(self, name: str, cell: int, properties: dict[str, Value], depth: int) -> None:
        """Add a property; one that cannot be decoded is left out, unless it is what an object is there for."""
        if not 0 <= cell < len(self.cells) - 2:
            raise Mat5Error("a property of it has no value")
        try:
            properties[name] = self.value(self.cells[cell + 2], depth + 1)
        except Mat5Error:
            if name in _NEEDED:
                raise

    def _defaults(self, kind: int, given: dict[str, Value], depth: int) -> dict[str, Value]:
        """What the class says of properties that the object does not state; unreadable defaults are left out."""
        table = self.cells[-1]
        if not isinstance(table, tuple) or not 0 < kind < len(table):
            return {}
        struct = table[kind]
        found: dict[str, Value] = {}
        for name, value in struct.items() if isinstance(struct, dict) else ():
            if (
                name in given
                or isinstance(value, Opaque | Unread)
                or (isinstance(value, np.ndarray) and _is_reference(value))
            ):
                continue
            try:
                found[name] = self.value(value, depth + 1)
            except Mat5Error:
                continue
        return found

    def _class(self, number: int) -> str:
        if not 0 < number < len(self.classes):
            raise Mat5Error(f"the file holds no class {number}")
        package, name = self.classes[number][:2]
        return ".".join(part for part in (self._name(package), self._name(name)) if part)

    def _name(self, index: int) -> str:
        """A name by its number from 1; empty for 0."""
        if not 0 <= index <= len(self.names):
            raise Mat5Error(f"the file holds no name {index}")
        return self.names[index - 1] if index else ""

    def _table(self, start: int, stop: int, width: int) -> list[tuple[int, ...]]:
        words = self.words[start // 4 : max(start, stop) // 4]
        return [tuple(int(n) for n in words[at : at + width]) for at in range(0, words.size // width * width, width)]

    def _blocks(self, start: int, stop: int) -> list[list[tuple[int, int, int]]]:
        """Blocks of properties (name, sort, value): a count, so many times three numbers, and a gap to 8 bytes."""
        at, end, blocks = start // 4, max(start, stop) // 4, []
        while at < end:
            count = int(self.words[at])
            if count < 0 or at + 1 + 3 * count > end:
                raise Mat5Error("the table of its objects is cut off")
            rows = self.words[at + 1 : at + 1 + 3 * count].reshape(-1, 3)
            blocks.append([(int(a), int(b), int(c)) for a, b, c in rows])
            at += (1 + 3 * count + 1) // 2 * 2
        return blocks

    @staticmethod
    def _block(blocks: list[list[tuple[int, int, int]]], number: int) -> list[tuple[int, int, int]]:
        if not 0 <= number < len(blocks):
            raise Mat5Error(f"the file holds no properties {number}")
        return blocks[number]


def objects_of(subsystem: Plain) -> Objects:
    """The objects in the bytes of a subsystem; raises `Mat5Error` where they are none."""
    if not isinstance(subsystem, np.ndarray):
        raise Mat5Error("the file holds no objects")
    raw = subsystem.astype(np.uint8).tobytes(order="F")
    order = "<" if raw[2:4] == b"IM" else ">"
    first = next(elements(raw[8:], order), None)
    if first is None:
        raise Mat5Error("the file holds no objects")
    value = Reader(order).array(first)[2]
    wrapper = value.get("MCOS") if isinstance(value, dict) else None
    if not isinstance(wrapper, Opaque) or not isinstance(wrapper.reference, tuple):
        raise Mat5Error("the file holds no objects of this kind")
    return Objects(wrapper.reference)


def _is_reference(given: Plain) -> bool:
    return isinstance(given, np.ndarray) and given.size >= 5 and float(given.flat[0]) == _TAG
