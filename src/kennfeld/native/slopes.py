"""Code for the rows of slopes of one sample: each written out, or prepared for a pull-back."""

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass

from kennfeld.graph.derivative import Written
from kennfeld.native.emitter import Item, Step
from kennfeld.native.entries import EntryWriter
from kennfeld.native.ir import literal
from kennfeld.native.output import Output, counts
from kennfeld.native.pattern import Pattern
from kennfeld.native.pullprogram import PullProgram

__all__ = ["PulledRows", "SlopeRow", "WrittenRows", "output_row", "state_row"]

ZERO = literal(0.0)


@dataclass(frozen=True)
class SlopeRow:
    """A row of slopes as the tape holds it: times `factor` where it `counts`, else 0, whatever the slopes are."""

    counts: Callable[[Step], str]  # an i1
    factor: float = 1.0
    needs: tuple[int, ...] = ()  # nodes that `counts` uses


def output_row(at: int, output: Output) -> SlopeRow:
    """The slopes of a residual, which count where the sample is scored."""
    return SlopeRow(lambda step: counts(step.f, at), 1.0 / output.scale)


def state_row(node: int) -> SlopeRow:
    """The slopes of a state, whose value is `node`.

    They count where the state is finite: elsewhere only a condition can keep it from the outputs.
    """

    def finite(step: Step) -> str:
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
        """The nodes that the slopes with respect to an atom or a state use."""
        return (node for row, slopes in self._rows if leaf in slopes for node in (slopes[leaf], *row.needs))

    def _slope(self, step: Step, row: int, leaf: int) -> str:
        counted, slopes = self._rows[row]
        if leaf not in slopes:
            return ZERO
        slope = step.value(slopes[leaf])
        scaled = slope if counted.factor == 1.0 else step.f.fmul(slope, literal(counted.factor))
        return step.f.select(counted.counts(step), scaled, ZERO)

    def writer(self, step: Step, atom: int) -> EntryWriter:
        """Writes the slopes of all rows at a grid point of an atom."""
        slopes = [self._slope(step, row, atom) for row in range(len(self._rows))]

        def write(entry: str, place: str, weight: str) -> None:
            into = step.f.at("%slope", step.f.mul(place, len(slopes)))
            for row, slope in enumerate(slopes):
                step.f.store(ZERO if slope == ZERO else step.product(slope, weight), into, row)

        return write

    def matrix_items(self, seeds: Sequence[int], pattern: Pattern) -> list[Item]:
        """Items that write the slopes with respect to states: of the first rows to `%c`, of the others to `%a`."""
        return [self._matrix_row(row, seeds, pattern) for row in range(len(self._rows))]

    def _matrix_row(self, row: int, seeds: Sequence[int], pattern: Pattern) -> Item:
        counted, slopes = self._rows[row]
        of_output = row < pattern.outputs
        matrix, size = ("%c", pattern.outputs * pattern.carried) if of_output else ("%a", pattern.cells)
        cells = [(seeds[i], place) for i, place in pattern.places[row]]

        def emit(step: Step) -> None:
            into = step.f.at(matrix, step.f.mul("%row", size))
            for seed, place in cells:
                step.f.store(self._slope(step, row, seed), into, place)

        return Item((*counted.needs, *(slopes[seed] for seed, _ in cells)), emit)


class PulledRows:
    """Rows whose slopes a pull-back finds, once the code has left its factors and seeds and the entries' weights."""

    def __init__(self, rows: Sequence[SlopeRow], program: PullProgram) -> None:
        self._rows, self._scales = tuple(rows), program.scales
        self.program = program

    def factor_items(self) -> dict[int, Item]:
        """For each node that is a factor an item that keeps it."""

        def keep(node: int, at: int) -> Item:
            return Item((node,), lambda step: step.f.store(step.value(node), "%factors", at))

        return {node: keep(node, at) for node, at in self.program.factors.items()}

    def seed_items(self) -> list[Item]:
        """Items that write where each row's adjoint starts."""

        def start(at: int, row: SlopeRow) -> Item:
            def emit(step: Step) -> None:
                step.f.store(step.f.select(row.counts(step), literal(row.factor), ZERO), "%seeds", at)

            return Item(row.needs, emit)

        return [start(at, row) for at, row in enumerate(self._rows)]

    def needs(self, atom: int) -> Collection[int]:
        """The nodes that `writer` uses."""
        return (self._scales[atom],) if atom in self._scales else ()

    def writer(self, step: Step, atom: int) -> EntryWriter:
        """Leaves the weight of a grid point, and whose adjoint it is to be multiplied with."""
        source = str(self.program.source[atom])
        scale = step.value(self._scales[atom]) if atom in self._scales else ""

        def write(entry: str, place: str, weight: str) -> None:
            step.f.store(source, "%sources", entry, "i32")
            step.f.store(step.product(scale, weight) if scale else weight, "%weights", entry)

        return write
