"""LLVM IR that writes the derivatives of one sample to the tape: entries (column and slopes) and state matrices.

A lookup touches the grid points around its coordinate, a position on a free axis the breakpoints around it, an
expansion all of its values. The slopes of the rows are either written out as nodes (`WrittenRows`) or computed by an
adjoint program (`PulledRows`).
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from kennfeld.graph.derivative import Linearization, Written
from kennfeld.graph.lookup_lowering import ExpansionRef
from kennfeld.native.adjoint_loop import PullProgram
from kennfeld.native.emitter import CodeItem, MemoryLayout, StepEmitter
from kennfeld.native.ir import literal
from kennfeld.native.sample_loop import Output, is_counted
from kennfeld.native.table_lookup import Corner, corners
from kennfeld.native.tape_layout import TapeLayout

# Called for each grid point of an atom: the number of the entry in its sample, that in the tape, and its weight.
EntryWriter = Callable[[str, str, str], None]

ZERO = literal(0.0)


@dataclass(frozen=True)
class Entries:
    """Maximum number of entries per sample; `fixed` if every sample writes exactly as many."""

    room: int
    fixed: bool


def entries_of(line: Linearization, layout: MemoryLayout, atoms: Sequence[int]) -> Entries:
    """Return the number of entries for the grid points that the atoms of one sample touch."""
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
    layout: MemoryLayout,
    atoms: Sequence[int],
    writer: Callable[[StepEmitter, int], EntryWriter],
    needs: Callable[[int], Iterable[int]],
) -> list[CodeItem]:
    """Return items that go through the grid points of each atom in turn and write their columns.

    `writer(step, atom)` returns a function that writes the rest; `needs(atom)` are the nodes it uses.
    """
    entries = entries_of(line, layout, atoms)

    def begin(step: StepEmitter) -> None:
        step.f.store(str(entries.room if entries.fixed else 0), "%count", "%row", "i32")

    items, first = [CodeItem((), begin)], 0
    for atom in atoms:
        points = _Points(line, layout, entries, writer, atom, first)
        items.append(CodeItem((*points.needs, *needs(atom)), points.emit))
        first += entries_of(line, layout, [atom]).room
    return items


@dataclass(frozen=True)
class _Points:
    """The grid points of one atom; the first is entry `first` if all samples have the same number."""

    line: Linearization
    layout: MemoryLayout
    entries: Entries
    writer: Callable[[StepEmitter, int], EntryWriter]
    atom: int
    first: int

    @property
    def needs(self) -> tuple[int, ...]:
        """The nodes whose values the columns use."""
        op, args, _ = self.line.nodes[self.atom]
        return (self.atom,) if op == "position" else args

    def emit(self, step: StepEmitter) -> None:
        """Write all entries of the atom."""
        write = self.writer(step, self.atom)
        start = step.f.mul("%row", self.entries.room)
        for number, corner in enumerate(self._corners(step)):
            entry = self._number(step, number)
            place = step.f.add(start, entry)
            self._write_column(step, place, corner)
            write(entry, place, corner.weight)
            self._count(step)

    def _corners(self, step: StepEmitter) -> Iterator[Corner]:
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

    def _number(self, step: StepEmitter, number: int) -> str:
        if self.entries.fixed:
            return str(self.first + number)
        return step.f.new(f"sext i32 {step.f.load('%count', '%row', 'i32')} to i64")

    def _write_column(self, step: StepEmitter, place: str, corner: Corner) -> None:
        f = step.f
        column = f.add(corner.index, self._column)
        f.store(f.new(f"trunc i64 {column} to i32"), "%index", place, "i32")

    def _count(self, step: StepEmitter) -> None:
        if not self.entries.fixed:
            count = step.f.load("%count", "%row", "i32")
            step.f.store(step.f.new(f"add i32 {count}, 1"), "%count", "%row", "i32")


def _all_values(step: StepEmitter, ref: ExpansionRef, args: tuple[int, ...]) -> Iterator[Corner]:
    count, weights = step.expansion_weights(ref, args)
    with step.f.loop(0, count) as value:
        yield Corner(value, step.f.load(weights, value))


@dataclass(frozen=True)
class SlopeRow:
    """A row of slopes on the tape: multiplied by `factor` if it `counts`, else 0, whatever the slopes are."""

    counts: Callable[[StepEmitter], str]  # an i1
    factor: float = 1.0
    needs: tuple[int, ...] = ()  # nodes that `counts` uses


def output_row(at: int, output: Output) -> SlopeRow:
    """Return the slopes of a residual, which count if the sample is scored."""
    return SlopeRow(lambda step: is_counted(step.f, at), 1.0 / output.scale)


def state_row(node: int) -> SlopeRow:
    """Return the slopes of a state, whose value is `node`.

    They count if the state is finite; otherwise only a condition can keep it from the outputs.
    """

    def finite(step: StepEmitter) -> str:
        nothing = step.f.new(f"fsub double {step.value(node)}, {step.value(node)}")
        return step.f.new(f"fcmp oeq double {nothing}, {ZERO}")

    return SlopeRow(finite, needs=(node,))


class WrittenRows:
    """Rows whose slopes are nodes."""

    def __init__(self, rows: Sequence[SlopeRow], slopes: Written) -> None:
        self._rows = tuple(zip(rows, slopes.rows, strict=True))

    @property
    def slope_nodes(self) -> Iterable[int]:
        """The nodes of all slopes."""
        return (node for _, slopes in self._rows for node in slopes.values())

    def needs(self, leaf: int) -> Iterable[int]:
        """Return the nodes that the slopes with respect to an atom or a state use."""
        return (node for row, slopes in self._rows if leaf in slopes for node in (slopes[leaf], *row.needs))

    def _slope(self, step: StepEmitter, row: int, leaf: int) -> str:
        counted, slopes = self._rows[row]
        if leaf not in slopes:
            return ZERO
        slope = step.value(slopes[leaf])
        scaled = slope if counted.factor == 1.0 else step.f.fmul(slope, literal(counted.factor))
        return step.f.select(counted.counts(step), scaled, ZERO)

    def writer(self, step: StepEmitter, atom: int) -> EntryWriter:
        """Return a function that writes the slopes of all rows at a grid point of an atom."""
        slopes = [self._slope(step, row, atom) for row in range(len(self._rows))]

        def write(entry: str, place: str, weight: str) -> None:
            into = step.f.at("%slope", step.f.mul(place, len(slopes)))
            for row, slope in enumerate(slopes):
                step.f.store(ZERO if slope == ZERO else step.product(slope, weight), into, row)

        return write

    def matrix_items(self, seeds: Sequence[int], pattern: TapeLayout) -> list[CodeItem]:
        """Return items that write the slopes with respect to states: first rows to `%c`, others to `%a`."""
        return [self._matrix_row(row, seeds, pattern) for row in range(len(self._rows))]

    def _matrix_row(self, row: int, seeds: Sequence[int], pattern: TapeLayout) -> CodeItem:
        counted, slopes = self._rows[row]
        of_output = row < pattern.outputs
        matrix, size = ("%c", pattern.outputs * pattern.carried) if of_output else ("%a", pattern.cells)
        cells = [(seeds[i], place) for i, place in pattern.places[row]]

        def emit(step: StepEmitter) -> None:
            into = step.f.at(matrix, step.f.mul("%row", size))
            for seed, place in cells:
                step.f.store(self._slope(step, row, seed), into, place)

        return CodeItem((*counted.needs, *(slopes[seed] for seed, _ in cells)), emit)


class PulledRows:
    """Rows whose slopes an adjoint program computes, given the factors, the seeds and the weights of the entries."""

    def __init__(self, rows: Sequence[SlopeRow], program: PullProgram) -> None:
        self._rows, self._scales = tuple(rows), program.scales
        self.program = program

    def factor_items(self) -> dict[int, CodeItem]:
        """Return for each node that is a factor an item that stores it."""

        def keep(node: int, at: int) -> CodeItem:
            return CodeItem((node,), lambda step: step.f.store(step.value(node), "%factors", at))

        return {node: keep(node, at) for node, at in self.program.factors.items()}

    def seed_items(self) -> list[CodeItem]:
        """Return items that write the start of each row's adjoint."""

        def start(at: int, row: SlopeRow) -> CodeItem:
            def emit(step: StepEmitter) -> None:
                step.f.store(step.f.select(row.counts(step), literal(row.factor), ZERO), "%seeds", at)

            return CodeItem(row.needs, emit)

        return [start(at, row) for at, row in enumerate(self._rows)]

    def needs(self, atom: int) -> Collection[int]:
        """Return the nodes that `writer` uses."""
        return (self._scales[atom],) if atom in self._scales else ()

    def writer(self, step: StepEmitter, atom: int) -> EntryWriter:
        """Return a function that stores the weight of a grid point, and the adjoint by which it is multiplied."""
        source = str(self.program.source[atom])
        scale = step.value(self._scales[atom]) if atom in self._scales else ""

        def write(entry: str, place: str, weight: str) -> None:
            step.f.store(source, "%sources", entry, "i32")
            step.f.store(step.product(scale, weight) if scale else weight, "%weights", entry)

        return write
