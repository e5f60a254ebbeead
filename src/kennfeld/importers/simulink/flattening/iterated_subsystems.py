"""For, while and for-each subsystems: iteration count, and copies of their blocks.

The blocks are placed once for each iteration. A state written in one iteration is read in the next; the last one keeps
it until the next step. The elements of a For Each subsystem have separate states.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.calibration_parameters import DeclaredParameters
from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, SignalSource
from kennfeld.importers.simulink.flattening.hierarchy import FlatteningState, IterationPlan, SystemInstance
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.model_tree import Endpoint, ModelBlock, System, join_path
from kennfeld.importers.simulink.variables.mask_scope import MaskVariable, Scope, Variable
from kennfeld.models.imperative.evaluation_errors import EvaluationError

LOOPS = ("ForIterator", "WhileIterator", "ForEach")
_MAX_ITERATIONS = 1000  # of one subsystem
_UNUSUAL = ("NeedActiveIterationSignal", "ShowActiveIterationCount", "ShowActiveIterationFlag", "ShowResetFlag")
_SEPARATE = "Separate states for each iteration"


def iterator_block(system: System) -> ModelBlock | None:
    """Return the block that makes a subsystem iterate, None if there is none."""
    return next(system.of(*LOOPS), None)


def plan_iterations(
    block: ModelBlock, holder: ModelBlock, names: Sequence[str], scope: Scope, counts: Mapping[str, int]
) -> IterationPlan:
    """Plan the iterations of a subsystem.

    Args:
        block: the iterator.
        holder: the subsystem block, whose mask may set iteration parameters.
        names: path of the iterator.
        scope: names that its blocks see.
        counts: iteration counts by path from earlier attempts.

    Raises:
        EvaluationError: if the iteration count is unknown or too large.
    """
    path = join_path(*names)
    reset = block.is_set_to("ResetStates", "reset")
    if block.type == "ForEach":
        return IterationPlan(block, _elements(block, holder, path, scope, counts))
    field = f"{join_path(*names, block.name)}:"
    if block.type == "WhileIterator":
        if not block.is_set_to("WhileBlockType", "while", "do-while", default="while"):
            raise EvaluationError(f"WhileBlockType {block.value('WhileBlockType')!r} is not supported")
        return IterationPlan(block, _number(field + "MaxIters", block.value("MaxIters") or "5", scope), reset)
    if block.is_set_to("ExternalIncrement", "on"):
        raise EvaluationError(f"{block.name} sets its iteration variable externally, which is not supported")
    if block.is_set_to("IterationSource", "external"):
        # the first attempt has one iteration; lowering it finds the count at the input
        return IterationPlan(block, _check_count(counts.get(path, 1), path), reset)
    return IterationPlan(block, _number(field + "IterationLimit", block.value("IterationLimit") or "5", scope), reset)


def _number(field: str, text: str, scope: Scope) -> int:
    """Return an iteration count: as given for the field, or as written."""
    variable = scope.variables.get(field)
    if isinstance(variable, Variable) and isinstance(variable.value, np.ndarray):
        numbers = variable.value
    else:
        numbers = ParameterExpressions(GraphBuilder(), DeclaredParameters()).numbers(text, scope)
    if numbers.size != 1 or not float(numbers.item()).is_integer():
        raise EvaluationError(f"its iteration count must be an integer, got {text[:60]}")
    if numbers.item() < 0 and field.endswith("MaxIters"):
        limit = f'set "{field}" to the maximum number of iterations'
        raise EvaluationError(f"its number of iterations is unbounded; {limit}")
    return _check_count(int(numbers.item()), field)


def _check_count(count: int, field: str) -> int:
    if not 1 <= count <= _MAX_ITERATIONS:
        limits = f"it must be between 1 and {_MAX_ITERATIONS}"
        raise EvaluationError(f"{field} requires {count} iterations in a step; {limits}")
    return count


def _elements(block: ModelBlock, holder: ModelBlock, path: str, scope: Scope, counts: Mapping[str, int]) -> int:
    """Return the number of elements: as specified, of mask parameters, or of the inputs in an earlier attempt."""
    for unusual in _UNUSUAL:
        if block.is_set_to(unusual, "on"):
            raise EvaluationError(f"{unusual} of {block.name} is on, which is not supported")
    if not block.is_set_to("StateHandling", _SEPARATE, default=_SEPARATE):
        raise EvaluationError(f"the iterations of {block.name} share their states, which is not supported")
    parts = _parts(block, holder, scope)
    stated = (block.value("SpecifiedNumIters") or "-1").strip()
    if stated != "-1":
        return _number(f"{path}:SpecifiedNumIters", stated, scope)
    # as for a count from outside: the width of the inputs is known after an attempt
    return _check_count(parts if parts is not None else counts.get(path, 1), path)


def element_scope(block: ModelBlock, holder: ModelBlock, inside: Scope, number: int) -> Scope:
    """Return the scope of one element, from 1, with its part of the partitioned mask parameters."""
    parts = partitioned_parameters(block, holder)
    if not parts:
        return inside
    scope = Scope(inside.variables, {}, inside)
    for name in parts:
        variable = inside.find(name)
        if isinstance(variable, MaskVariable):
            # element `number` of the expression, in MATLAB's words: `([1 2 3])(2)`
            scope.masked[name] = replace(variable, text=f"({variable.text})({number})", written="")
    return scope


def partitioned_parameters(block: ModelBlock, holder: ModelBlock) -> tuple[str, ...]:
    """Return the names of the partitioned mask parameters."""
    on = block.listed("SubsysMaskParameterPartition")
    names = [parameter.name for parameter in holder.mask.parameters] if holder.mask is not None else []
    return tuple(name for name, switched in zip(names, on, strict=False) if match_word(switched, ("on",)))


def _parts(block: ModelBlock, holder: ModelBlock, inside: Scope) -> int | None:
    """Return the number of elements in the partitioned mask parameters, None if there are none."""
    widths = set(block.listed("SubsysMaskParameterPartitionWidth")) - {"1"}
    sizes = set()
    for name in partitioned_parameters(block, holder):
        numbers = ParameterExpressions(GraphBuilder(), DeclaredParameters()).numbers(name, inside)
        if widths or 1 not in np.atleast_2d(numbers).shape:
            problem = "is not partitioned into single elements, which is not supported"
            raise EvaluationError(f"the parameter {name} {problem}")
        sizes.add(numbers.size)
    if len(sizes) > 1:
        lengths = " and ".join(map(str, sorted(sizes)))
        raise EvaluationError(f"its partitioned parameters have different lengths: {lengths}")
    return next(iter(sizes), None)


class IterationUnroller:
    """Places copies of an iterated subsystem; `inside` places a block within one of them."""

    def __init__(self, placed: FlatteningState, inside: Callable[[SystemInstance, ModelBlock], None]) -> None:
        self.placed = placed
        self._inside = inside

    def place(self, level: SystemInstance, face: SystemInstance, plan: IterationPlan) -> None:
        """Place the blocks of a subsystem once for each iteration; `face` is its instance as seen from outside."""
        assert face.holder is not None
        self.placed.built[join_path(*face.path)] = plan.count
        levels: list[SystemInstance] = []
        passing: list[FlatBlock] = []
        before: list[FlatBlock] = []
        for number in range(1, plan.count + 1):
            # all blocks placed from here on belong to this iteration, those of inner systems too
            start = len(self.placed.flat_blocks)
            inner = _iteration(level, face, plan, number)
            if plan.decides:
                passing.append(self._place_decision(inner, plan, levels))
                # the blocks of an iteration run only if its condition holds
                inner.control = passing[-1]
            self.placed.levels.append(inner)
            for block in inner.system.blocks:
                self._inside(inner, block)
            levels.append(inner)
            blocks = self.placed.flat_blocks[start:]
            if plan.each:  # the first element represents the others
                for flat in blocks if before else ():
                    flat.hidden = True
            else:
                _link_iterations(before, blocks)
            # the states of later iterations are those that the first one leaves
            if number == 1 and plan.reset and not plan.each:
                for flat in blocks:
                    flat.resets_each_step |= flat.previous_pass is None
            before = blocks
        for outport in face.system.of("Outport"):
            self._place_output(face, outport, plan, levels, passing)

    def _place_decision(self, inner: SystemInstance, plan: IterationPlan, levels: list[SystemInstance]) -> FlatBlock:
        """Place the block that decides if an iteration runs: the condition of the previous one, for the first the
        initial one.
        """
        flat = self.placed.place(inner, plan.block, "IterationCondition")
        # port 1 is the condition of a later iteration, port 2 that of the first one
        condition = Endpoint(plan.block.sid, "in", 1 if levels else 2)
        if levels or plan.asks_first:
            self.placed.joints.append((flat, [(levels[-1] if levels else inner, condition)]))
        return flat

    def _place_output(
        self,
        face: SystemInstance,
        outport: ModelBlock,
        plan: IterationPlan,
        levels: list[SystemInstance],
        passing: list[FlatBlock],
    ) -> None:
        """Place the block of an output: of the last iteration that ran, or all elements concatenated."""
        flat = self.placed.place(face, outport, "ForEachConcatenation" if plan.each else "IterationOutput")
        flat.control_ports = {"each": plan.block} if plan.each else {}
        end = Endpoint(outport.sid, "in")
        ends: list[tuple[SystemInstance, Endpoint] | SignalSource] = [
            (inner, end) for inner in (levels if plan.each else levels[-1:])
        ]
        if plan.decides:
            ends = [
                source
                for inner, condition in zip(levels, passing, strict=True)
                # of each iteration its signal, and whether it ran
                for source in ((inner, end), SignalSource(condition, 0))
            ]
        self.placed.joints.append((flat, ends))
        if face.control is not None and face.control.block is face.holder:
            block = self.placed.place(face, outport, "ConditionalOutput")
            block.inputs = [SignalSource(flat, 0)]


def _iteration(level: SystemInstance, face: SystemInstance, plan: IterationPlan, number: int) -> SystemInstance:
    """Return the instance of a subsystem in one of its iterations."""
    assert face.holder is not None
    scope = element_scope(plan.block, face.holder, face.scope, number) if plan.each else face.scope
    inner = SystemInstance(face.system, face.path, scope, face.control)
    inner.within(level, face.holder)
    inner.repeated = plan
    inner.element = number if plan.each else level.element
    inner.passes = level.passes if plan.each else (*level.passes, number)
    # as if the iterations were systems with their numbers as priorities, which orders their data stores
    inner.places = (*inner.places, (f"{face.holder.sid}:{number}", number))
    return inner


def _link_iterations(before: list[FlatBlock], blocks: list[FlatBlock]) -> None:
    """Link the blocks of an iteration to those of the previous one, except reset ones."""
    # iterations place the same blocks in the same order; of an inner loop, the last pass precedes the next first one
    heads = [(flat.last, other) for flat, other in zip(before, blocks, strict=False) if other.previous_pass is None]
    for last, other in heads:
        if not other.resets_each_step:
            last.next_pass, other.previous_pass = other, last
    for flat in before:
        flat.hidden = True
