"""Code that writes the entries of a tape: the columns that a sample touches, and what belongs to each.

A lookup touches the grid points around its coordinate; a position on a free axis the breakpoints around it; an
expansion all of its values.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

from kennfeld.graph.derivative import Linearization
from kennfeld.graph.lowering import ExpansionRef
from kennfeld.native.emitter import Item, Layout, Step
from kennfeld.native.tables import Corner, corners

__all__ = ["Entries", "EntryWriter", "entries_of", "entry_items"]

# Called for each grid point of an atom: the number of the entry in its sample, that in the tape, and its weight.
EntryWriter = Callable[[str, str, str], None]


@dataclass(frozen=True)
class Entries:
    """How many entries a tape has room for; `fixed` if every sample writes exactly as many."""

    room: int
    fixed: bool


def entries_of(line: Linearization, layout: Layout, atoms: Sequence[int]) -> Entries:
    """Room for the grid points that the atoms of one sample touch."""
    room, fixed = 0, True
    for atom in atoms:
        points = 1
        if line.nodes[atom].op == "position":
            room += min(layout.axes[line.nodes[atom].payload.number].size, 2)
            continue
        table = line.nodes[atom].payload
        if line.nodes[atom].op == "expansion":
            room, fixed = room + layout.shapes[table.name][0], False
            continue
        for count, smoothed in zip(layout.shapes[table.name], table.smoothed, strict=True):
            points *= count if smoothed else min(count, 2)
            fixed = fixed and not smoothed
        room += points
    return Entries(room, fixed)


def entry_items(
    line: Linearization,
    layout: Layout,
    atoms: Sequence[int],
    writer: Callable[[Step, int], EntryWriter],
    needs: Callable[[int], Iterable[int]],
) -> list[Item]:
    """Items that go through the grid points of each atom, one after the other, and write their columns.

    `writer(step, atom)` says how to write the rest, `needs(atom)` are the nodes it uses.
    """
    entries = entries_of(line, layout, atoms)

    def begin(step: Step) -> None:
        step.f.store(str(entries.room if entries.fixed else 0), "%count", "%row", "i32")

    items, first = [Item((), begin)], 0
    for atom in atoms:
        points = _Points(line, layout, entries, writer, atom, first)
        items.append(Item((*points.needs, *needs(atom)), points.emit))
        first += entries_of(line, layout, [atom]).room
    return items


@dataclass(frozen=True)
class _Points:
    """The grid points of one atom; the first is entry `first` where all samples have as many."""

    line: Linearization
    layout: Layout
    entries: Entries
    writer: Callable[[Step, int], EntryWriter]
    atom: int
    first: int

    @property
    def needs(self) -> tuple[int, ...]:
        """The nodes whose values the columns use."""
        op, args, _ = self.line.nodes[self.atom]
        return (self.atom,) if op == "position" else args

    def emit(self, step: Step) -> None:
        """Write all entries of the atom."""
        write = self.writer(step, self.atom)
        start = step.f.mul("%row", self.entries.room)
        for number, corner in enumerate(self._corners(step)):
            entry = self._number(step, number)
            place = step.f.add(start, entry)
            self._write_column(step, place, corner)
            write(entry, place, corner.weight)
            self._count(step)

    def _corners(self, step: Step) -> Iterator[Corner]:
        op, args, payload = self.line.nodes[self.atom]
        if op == "position":
            return corners(step.f, [step.cell(self.atom)], [1])
        if op == "expansion":
            return _all_values(step, payload, args)
        return corners(step.f, step.sides(payload, args), self.layout.strides(payload.name))

    @property
    def _column(self) -> int:
        """The first column of the table or axis."""
        op, _, payload = self.line.nodes[self.atom]
        return self.layout.moving[payload.key] if op == "position" else self.layout.offsets[payload.name]

    def _number(self, step: Step, number: int) -> str:
        if self.entries.fixed:
            return str(self.first + number)
        return step.f.new(f"sext i32 {step.f.load('%count', '%row', 'i32')} to i64")

    def _write_column(self, step: Step, place: str, corner: Corner) -> None:
        f = step.f
        column = f.add(corner.index, self._column)
        f.store(f.new(f"trunc i64 {column} to i32"), "%index", place, "i32")

    def _count(self, step: Step) -> None:
        if not self.entries.fixed:
            count = step.f.load("%count", "%row", "i32")
            step.f.store(step.f.new(f"add i32 {count}, 1"), "%count", "%row", "i32")


def _all_values(step: Step, ref: ExpansionRef, args: tuple[int, ...]) -> Iterator[Corner]:
    count, weights = step.expansion_weights(ref, args)
    with step.f.loop(0, count) as value:
        yield Corner(value, step.f.load(weights, value))
