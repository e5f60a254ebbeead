"""LLVM IR that writes the derivatives of one sample to the tape: entries (column and slopes) and state matrices.

A lookup touches the grid points around its coordinate, a position on a free axis the breakpoints around it, an
expansion all of its values, an output of a dense layer a column of weights. The slopes of the rows are either written
out as nodes (`WrittenRows`) or computed by an adjoint program (`PulledRows`).
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from math import prod

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.ir import ZERO, literal
from kennfeld.graph.derivative import Linearization, Written
from kennfeld.native.adjoint_loop import PullProgram
from kennfeld.native.elementwise import guarded_product
from kennfeld.native.emitter import CodeItem, MemoryLayout, StepEmitter
from kennfeld.native.sample_loop import Output, is_counted
from kennfeld.native.table_lookup import Corner, corners
from kennfeld.native.tape_layout import TapeLayout

# Called for each grid point of an atom: the number of the entry in its sample, that in the tape, and its weight.
EntryWriter = Callable[[str, str, str], None]


@dataclass(frozen=True)
class Entries:
    """Maximum number of entries per sample; `fixed` if every sample writes exactly as many."""

    room: int
    fixed: bool


def entries_of(line: Linearization, layout: MemoryLayout, atoms: Sequence[int]) -> Entries:
    """Count the entries for the grid points that the atoms of one sample touch."""
    room, fixed = 0, True
    for atom in atoms:
        op, _, payload = line.nodes[atom]
        if op == "position":
            room += min(layout.axes[payload.number].size, 2)
        elif op == "expansion":
            # expansions, layers and windows are loops, whose entries have no number while the code is written
            room, fixed = room + layout.shapes[payload.name][0], False
        elif op == "dense":
            room, fixed = room + payload.layer.inputs + 1, False
        else:
            sizes = [*zip(layout.shapes[payload.name], payload.smoothed, strict=True)]
            room += prod(count if smoothed else min(count, 2) for count, smoothed in sizes)
            fixed = fixed and not any(payload.smoothed)
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
        # counted while entries are written, unless all samples have as many
        step.f.store(str(entries.room if entries.fixed else 0), "%count", "%row", "i32")

    items, first = [CodeItem((), begin)], 0
    for atom in atoms:
        op, args, _ = line.nodes[atom]
        emit = partial(_write_entries, line=line, entries=entries, writer=writer, atom=atom, first=first)
        items.append(CodeItem((*((atom,) if op == "position" else args), *needs(atom)), emit))
        first += entries_of(line, layout, [atom]).room
    return items


def _write_entries(
    step: StepEmitter,
    line: Linearization,
    entries: Entries,
    writer: Callable[[StepEmitter, int], EntryWriter],
    atom: int,
    first: int,
) -> None:
    """Write all entries of an atom; the first is entry `first` if all samples have the same number."""
    f, (op, _, payload) = step.f, line.nodes[atom]
    base = step.layout.moving[payload.key] if op == "position" else step.layout.offsets[payload.name]
    write = writer(step, atom)
    start = f.mul("%row", entries.room)
    for number, corner in enumerate(_corners(step, atom)):
        entry = str(first + number) if entries.fixed else f.load_index("%count", "%row")
        place = f.add(start, entry)
        column = f.new(f"trunc i64 {f.add(corner.index, base)} to i32")
        f.store(column, "%index", place, "i32")
        write(entry, place, corner.weight)
        if not entries.fixed:
            count = f.load("%count", "%row", "i32")
            f.store(f.new(f"add i32 {count}, 1"), "%count", "%row", "i32")


def _corners(step: StepEmitter, atom: int) -> Iterator[Corner]:
    """Emit the body for each grid point that an atom touches."""
    op, args, payload = step.nodes[atom]
    if op == "position":
        yield from corners(step.f, [step.cell(atom, step.layout.axes[payload.number].size)], [1])
    elif op == "expansion":
        count, weights = step.expansion_weights(payload, args)
        with step.f.loop(0, count) as value:
            yield Corner(value, step.f.load(weights, value))
    elif op == "dense":
        f, (layer, number) = step.f, payload
        memory = step.layer(layer, args)
        # dy_i/dw_ji = a'(z_i) x_j, with x = 1 for the bias
        slope = f.load(memory.outputs, layer.outputs + number)
        with f.loop(0, layer.inputs + 1) as row:
            weight = f.add(f.mul(row, layer.outputs), number)
            yield Corner(weight, guarded_product(f, slope, f.load(memory.inputs, row)))
    else:
        yield from corners(step.f, step.sides(payload, args), step.layout.strides(payload.name))


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
        # 0 for a finite value, else NaN
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
        # not a product with 0 or 1, which a slope that is not finite would pass
        return step.f.select(counted.counts(step), scaled, ZERO)

    def writer(self, step: StepEmitter, atom: int) -> EntryWriter:
        """Return a function that writes the slopes of all rows at a grid point of an atom."""
        slopes = [self._slope(step, row, atom) for row in range(len(self._rows))]

        def write(entry: str, place: str, weight: str) -> None:
            into = step.f.at("%slope", step.f.mul(place, len(slopes)))
            for row, slope in enumerate(slopes):
                step.f.store(ZERO if slope == ZERO else guarded_product(step.f, slope, weight), into, row)

        return write

    def matrix_items(self, seeds: Sequence[int], pattern: TapeLayout) -> list[CodeItem]:
        """Return items that write the slopes with respect to states: first rows to `%c`, others to `%a`."""

        def item(row: int) -> CodeItem:
            counted, slopes = self._rows[row]
            of_output = row < pattern.outputs
            matrix, size = ("%c", pattern.outputs * pattern.carried) if of_output else ("%a", pattern.cells)
            cells = [(seeds[i], place) for i, place in pattern.places[row]]

            def emit(step: StepEmitter) -> None:
                into = step.f.at(matrix, step.f.mul("%row", size))
                for seed, place in cells:
                    step.f.store(self._slope(step, row, seed), into, place)

            return CodeItem((*counted.needs, *(slopes[seed] for seed, _ in cells)), emit)

        return [item(row) for row in range(len(self._rows))]


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
            step.f.store(guarded_product(step.f, scale, weight) if scale else weight, "%weights", entry)

        return write
