"""Code that writes the entries of a tape: the columns that a sample touches, and the slopes of every row there.

A lookup touches the grid points around its coordinate; a position on a free axis the breakpoints around it.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from kennfeld.graph.derivative import Linearization
from kennfeld.native.emitter import Item, Layout, Step
from kennfeld.native.ir import literal
from kennfeld.native.tables import Corner, corners

__all__ = ["Entries", "entries_of", "entry_items"]

ZERO = literal(0.0)
SlopeOf = Callable[[Step, int, int], str]  # the slope of a row with respect to an atom


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
        for count, smoothed in zip(layout.shapes[table.name], table.smoothed, strict=True):
            points *= count if smoothed else min(count, 2)
            fixed = fixed and not smoothed
        room += points
    return Entries(room, fixed)


def entry_items(
    line: Linearization,
    layout: Layout,
    atoms: Sequence[int],
    rows: Sequence[Mapping[int, int]],
    slope_of: SlopeOf,
    also: Sequence[int] = (),
) -> list[Item]:
    """Items that write the grid points of each atom, one after the other; `rows` are the slopes' nodes by atom.

    `slope_of` writes a slope; `also` are nodes that it uses besides.
    """
    entries = entries_of(line, layout, atoms)

    def begin(step: Step) -> None:
        step.f.store(str(entries.room if entries.fixed else 0), "%count", "%row", "i32")

    items, first = [Item((), begin)], 0
    for atom in atoms:
        writer = _Writer(line, layout, entries, rows, slope_of, atom, first)
        items.append(Item((*writer.needs, *also), writer.emit))
        first += entries_of(line, layout, [atom]).room
    return items


@dataclass(frozen=True)
class _Writer:
    """Writes the entries of one atom; the first is number `first` where all samples have as many."""

    line: Linearization
    layout: Layout
    entries: Entries
    rows: Sequence[Mapping[int, int]]
    slope_of: SlopeOf
    atom: int
    first: int

    @property
    def needs(self) -> tuple[int, ...]:
        """The nodes whose values the code uses."""
        op, args, _ = self.line.nodes[self.atom]
        own = (self.atom,) if op == "position" else args
        return (*own, *(row[self.atom] for row in self.rows if self.atom in row))

    def emit(self, step: Step) -> None:
        """Write all grid points of the atom."""
        slopes = [self.slope_of(step, r, self.atom) if self.atom in row else ZERO for r, row in enumerate(self.rows)]
        start = step.f.mul("%row", self.entries.room)
        for number, corner in enumerate(self._corners(step)):
            self._write(step, step.f.add(start, self._number(step, number)), corner, slopes)
            self._count(step)

    def _corners(self, step: Step) -> Iterator[Corner]:
        op, args, payload = self.line.nodes[self.atom]
        if op == "position":
            return corners(step.f, [step.cell(self.atom)], [1])
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

    def _write(self, step: Step, place: str, corner: Corner, slopes: Sequence[str]) -> None:
        f = step.f
        column = f.add(corner.index, self._column)
        f.store(f.new(f"trunc i64 {column} to i32"), "%index", place, "i32")
        into = f.at("%slope", f.mul(place, len(slopes)))
        for row, slope in enumerate(slopes):
            f.store(ZERO if slope == ZERO else step.product(slope, corner.weight), into, row)

    def _count(self, step: Step) -> None:
        if not self.entries.fixed:
            count = step.f.load("%count", "%row", "i32")
            step.f.store(step.f.new(f"add i32 {count}, 1"), "%count", "%row", "i32")
