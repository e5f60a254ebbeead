"""Native functions that write the tape of linearised steps, and the states at its start.

The tape holds for each sample what the sums over samples need, independently of the model:

| array | contents |
|---|---|
| residual, weight | [outputs], 0 for samples that are not scored |
| c | [outputs][carried], slopes of outputs with respect to states |
| a | slopes of next states with respect to states, see `TapeLayout` |
| index, slope | [entries], [entries][rows]: column and slopes of each value that the step touches |
| count | number of entries |

Rows are those of the outputs and of the states kept by the layout. An entry is a grid point of a lookup; several
entries may have the same column.
"""

from collections.abc import Sequence

from kennfeld.base.machine_code.ir import ZERO, FunctionWriter
from kennfeld.graph.adjoints import AdjointProgram
from kennfeld.graph.derivative import Linearization
from kennfeld.native.adjoint_loop import FILLED, PullProgram
from kennfeld.native.column_table import find
from kennfeld.native.emitter import PARAMETERS, CodeItem, MemoryLayout, StepEmitter, emit_items
from kennfeld.native.jacobian_rows import PulledRows, WrittenRows, entries_of, entry_items, output_row, state_row
from kennfeld.native.sample_loop import (
    RANGE,
    ROW,
    Output,
    SampleCursor,
    apply_weight,
    each_sample,
    is_counted,
    loop_code,
    loss_of,
    node_items,
    scaled_residual,
    step_items,
)
from kennfeld.native.tape_layout import TapeLayout

TAPE = tuple(("ptr", name) for name in ("targets", "scores", "residual", "weight", "c", "a", "index", "slope", "count"))
START = tuple(("ptr", name) for name in ("index", "slope", "count"))


def tape_code(line: Linearization, layout: MemoryLayout, outputs: Sequence[Output]) -> FunctionWriter:
    """Write `tape(..., targets, scores, residual, ..., count, first, last)`: the tape of a range of samples.

    `scores[output]` is the weight of the dataset and criterion.
    """
    pattern = TapeLayout.of(line)
    rows = [output_row(at, output) for at, output in enumerate(outputs)]
    rows += [state_row(line.states[line.carried[i]].next) for i in pattern.kept]
    slopes = line.slopes.only([*range(len(outputs)), *(len(outputs) + i for i in pattern.kept)])
    tail = [_residual(at, output, len(outputs)) for at, output in enumerate(outputs)]
    if isinstance(slopes, AdjointProgram):
        room = entries_of(line, layout, line.atoms).room
        cells = [[(line.seeds[i], place) for i, place in row] for row in pattern.places]
        pulled = PulledRows(rows, PullProgram("tape", slopes, cells, room))
        return _pulled_tape(line, layout, pulled, tail, room, pattern)
    written = WrittenRows(rows, slopes)
    tail += written.matrix_items(line.seeds, pattern)
    tail += entry_items(line, layout, line.atoms, written.writer, written.needs)
    return loop_code("tape", TAPE, tail, line, layout, len(outputs))


def _residual(at: int, output: Output, outputs: int) -> CodeItem:
    """Return the item that writes residual and weight of an output."""

    def emit(step: StepEmitter) -> None:
        f = step.f
        residual, _ = scaled_residual(step, at, output)
        # not the target alone: an output of weight 0 is off, even where its residual is not finite
        scored = is_counted(f, at)
        _, weight = loss_of(f, residual, output)
        scored_weight = apply_weight(step, f.fmul(weight, f.load("%scores", at)), output)
        place = f.add(f.mul("%row", outputs), at)
        f.store(f.select(scored, residual, ZERO), "%residual", place)
        f.store(f.select(scored, scored_weight, ZERO), "%weight", place)

    return CodeItem(output.nodes, emit)


def _pulled_tape(
    line: Linearization, layout: MemoryLayout, rows: PulledRows, tail: list[CodeItem], room: int, pattern: TapeLayout
) -> FunctionWriter:
    """Write the tape by an adjoint program: the code of a sample stores its factors, a loop computes the slopes."""
    program, outputs = rows.program, pattern.outputs
    tail = [*tail, *rows.seed_items(), *entry_items(line, layout, line.atoms, rows.writer, rows.needs)]
    items = step_items(line, layout, tail, rows.factor_items())
    own = [*PARAMETERS, *TAPE]
    step = emit_items("tape_step", [*own, *FILLED, ROW], items, line.nodes, layout)
    f = FunctionWriter("tape", [*own, *RANGE], before=program.tables() + step)
    memory = program.memory(f)
    filled = [(kind, memory[name]) for kind, name in FILLED]
    with each_sample(f, line, layout, outputs) as sample:
        f.call("tape_step", [*sample.arguments(own), *filled, *sample.place])
        sizes = (("%c", outputs * pattern.carried), ("%a", pattern.cells))
        c, a = (f.at(matrix, f.mul(sample.row, size)) for matrix, size in sizes)
        slope = f.at("%slope", f.mul(sample.row, room * program.rows))
        entries = f.load_index("%count", sample.row)
        program.run(f, memory, entries=entries, slope=slope, outputs=outputs, c=c, a=a)
    program.free(f, memory)
    return f


def start_code(line: Linearization, layout: MemoryLayout) -> FunctionWriter:
    """Write `start(..., index, slope, count, k)`: first values of all states at sample k, entries of their slopes."""
    rows = [state_row(line.starts[i]) for i in line.carried]
    if isinstance(line.start_slopes, AdjointProgram):
        room = entries_of(line, layout, line.start_atoms).room
        pulled = PulledRows(rows, PullProgram("start", line.start_slopes, [() for _ in rows], room))
        items = node_items(line.nodes, line.starts, pulled.factor_items())
        items += pulled.seed_items()
        return _start_function(line, layout, items, pulled)
    written = WrittenRows(rows, line.start_slopes)
    return _start_function(line, layout, node_items(line.nodes, [*line.starts, *written.slope_nodes]), written)


def _start_function(
    line: Linearization, layout: MemoryLayout, items: list[CodeItem], rows: WrittenRows | PulledRows
) -> FunctionWriter:
    program = rows.program if isinstance(rows, PulledRows) else None
    filled = FILLED if program else ()
    entries = entry_items(line, layout, line.start_atoms, rows.writer, rows.needs)
    items = [*items, *entries, _fill_memory(line, layout)]
    own = [*PARAMETERS, *START]
    step = emit_items("start_step", [*own, *filled, ROW], items, line.nodes, layout)
    f = FunctionWriter("start", [*own, ("i64", "k")], before=(program.tables() if program else "") + step)
    memory = program.memory(f) if program else {}
    sample = SampleCursor(f, "0", *find(f, "%k"))
    f.call("start_step", [*sample.arguments(own), *((kind, memory[name]) for kind, name in filled), *sample.place])
    if program:
        program.run(f, memory, entries=f.load_index("%count"), slope="%slope", outputs=0, c="null", a="null")
        program.free(f, memory)
    return f


def _fill_memory(line: Linearization, layout: MemoryLayout) -> CodeItem:
    """Return the item that writes the first value of every state to all its cells."""

    def emit(step: StepEmitter) -> None:
        f = step.f
        for i, state in enumerate(line.states):
            # all cells of a delay hold the first value; an earlier piece may have left its ring elsewhere than at 0
            first = step.value(line.starts[i])
            base = f.at("%memory", layout.memory_offsets[i])
            with f.loop(0, state.latency) as slot:
                f.store(first, base, slot)
            if state.latency > 1:
                f.store("0", "%hints", i, "i64")

    return CodeItem(tuple(line.starts), emit)
