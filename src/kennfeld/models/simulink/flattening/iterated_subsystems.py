"""Subsystems that run several times in a step: how often, and with what they begin.

Their blocks are built once for each pass. A memory of one pass is read in the next; only the last one lasts until the
step behind. The elements of a For Each subsystem have memories of their own.

Subsystems that run several times in a step: their blocks, placed once for each pass or element.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.simulink.calibration_parameters import DeclaredParameters
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
from kennfeld.models.simulink.flattening.flat_model import FlatBlock, SignalSource
from kennfeld.models.simulink.flattening.hierarchy import FlatteningState, IterationPlan, SystemInstance
from kennfeld.models.simulink.reader.model_tree import Endpoint, ModelBlock, System, join_path
from kennfeld.models.simulink.variables.mask_scope import MaskVariable, Scope, Variable

__all__ = ["LOOPS", "IterationUnroller", "iterator_block", "plan_iterations"]

LOOPS = ("ForIterator", "WhileIterator", "ForEach")
_MOST = 1000  # passes of one subsystem
_UNUSUAL = ("NeedActiveIterationSignal", "ShowActiveIterationCount", "ShowActiveIterationFlag", "ShowResetFlag")
_SEPARATE = "Separate states for each iteration"


def iterator_block(system: System) -> ModelBlock | None:
    """The block that makes a subsystem run several times; None where there is none."""
    return next(system.of(*LOOPS), None)


def plan_iterations(
    block: ModelBlock, holder: ModelBlock, names: Sequence[str], scope: Scope, counts: Mapping[str, int]
) -> IterationPlan:
    """The passes of a subsystem, by its iterator. `names` lead to it, `scope` is what its blocks see.

    `counts` are the passes that an earlier attempt has found by path. Raises `NoValueError` where their number is not
    known, or too large.
    """
    path = join_path(*names)
    reset = (block.value("ResetStates") or "held") == "reset"
    if block.type == "ForEach":
        return IterationPlan(block, _elements(block, holder, path, scope, counts))
    field = f"{join_path(*names, block.name)}:"
    if block.type == "WhileIterator":
        if (block.value("WhileBlockType") or "while") not in ("while", "do-while"):
            raise EvaluationError(f"WhileBlockType is {block.value('WhileBlockType')!r}, which is not supported")
        return IterationPlan(block, _number(field + "MaxIters", block.value("MaxIters") or "5", scope), reset)
    if (block.value("ExternalIncrement") or "off") == "on":
        raise EvaluationError(f"{block.name} takes its next iteration from outside, which is not supported")
    if (block.value("IterationSource") or "internal") == "external":
        return IterationPlan(block, _bounded(counts.get(path, 1), path), reset)
    return IterationPlan(block, _number(field + "IterationLimit", block.value("IterationLimit") or "5", scope), reset)


def _number(field: str, text: str, scope: Scope) -> int:
    """A number of passes: as given for the field, or as written."""
    given = scope.variables.get(field)
    if isinstance(given, Variable) and isinstance(given.value, np.ndarray):
        numbers = given.value
    else:
        numbers = Expressions(GraphBuilder(), DeclaredParameters()).numbers(text, scope)
    if numbers.size != 1 or not float(numbers.item()).is_integer():
        raise EvaluationError(f"the number of its passes is {text[:60]}, which is no whole number")
    if numbers.item() < 0 and field.endswith("MaxIters"):
        raise EvaluationError(f'it may run without end; set "{field}" to the passes that it needs at most')
    return _bounded(int(numbers.item()), field)


def _bounded(count: int, field: str) -> int:
    if not 1 <= count <= _MOST:
        raise EvaluationError(f"{field} asks for {count} passes in a step; 1 to {_MOST} are possible")
    return count


# for each


def _elements(block: ModelBlock, holder: ModelBlock, path: str, scope: Scope, counts: Mapping[str, int]) -> int:
    """The number of elements: as stated, as its mask's parameters have, or as an attempt has found in its inputs."""
    for unusual in _UNUSUAL:
        if (block.value(unusual) or "off") == "on":
            raise EvaluationError(f"{unusual} of {block.name} is on, which is not supported")
    if (block.value("StateHandling") or _SEPARATE) != _SEPARATE:
        raise EvaluationError(f"the elements of {block.name} share their states, which is not supported")
    parts = _parts(block, holder, scope)
    stated = (block.value("SpecifiedNumIters") or "-1").strip()
    if stated != "-1":
        return _number(f"{path}:SpecifiedNumIters", stated, scope)
    return _bounded(parts if parts is not None else counts.get(path, 1), path)


def element_scope(block: ModelBlock, holder: ModelBlock, inside: Scope, number: int) -> Scope:
    """The names that an element sees, counted from 1: of a mask's parameters that are partitioned, its own part."""
    parts = partitioned(block, holder)
    if not parts:
        return inside
    scope = Scope(inside.variables, {}, inside)
    for name in parts:
        found = inside.find(name)
        if isinstance(found, MaskVariable):
            scope.masked[name] = MaskVariable(f"({found.text})({number})", found.outside, found.evaluated, found.field)
    return scope


def partitioned(block: ModelBlock, holder: ModelBlock) -> tuple[str, ...]:
    """The parameters of a mask of which each element has a part."""
    on = block.listed("SubsysMaskParameterPartition")
    names = [one.name for one in holder.mask.parameters] if holder.mask is not None else []
    return tuple(name for name, switched in zip(names, on, strict=False) if switched == "on")


def _parts(block: ModelBlock, holder: ModelBlock, inside: Scope) -> int | None:
    """The number of elements that the parameters of the mask have; None where none is partitioned."""
    widths = set(block.listed("SubsysMaskParameterPartitionWidth")) - {"1"}
    sizes = set()
    for name in partitioned(block, holder):
        numbers = Expressions(GraphBuilder(), DeclaredParameters()).numbers(name, inside)
        if widths or 1 not in np.atleast_2d(numbers).shape:
            raise EvaluationError(f"the parameter {name} is partitioned otherwise than a vector into its elements")
        sizes.add(numbers.size)
    if len(sizes) > 1:
        raise EvaluationError(f"its partitioned parameters have {' and '.join(map(str, sorted(sizes)))} elements")
    return next(iter(sizes), None)


class IterationUnroller:
    """Places passes. `inside` places a block within one of them."""

    def __init__(self, placed: FlatteningState, inside: Callable[[SystemInstance, ModelBlock], None]) -> None:
        self.placed = placed
        self._inside = inside

    def place(self, level: SystemInstance, face: SystemInstance, plan: IterationPlan) -> None:
        """Place the blocks of a subsystem once for each pass; `face` is what is seen of it from outside."""
        assert face.holder is not None
        self.placed.built[join_path(*face.path)] = plan.count
        made: list[SystemInstance] = []
        passing: list[FlatBlock] = []
        before: list[FlatBlock] = []
        for number in range(1, plan.count + 1):
            start = len(self.placed.atoms)
            inner = self._pass(level, face, plan, number, made, passing)
            made.append(inner)
            atoms = self.placed.atoms[start:]
            (_beside if plan.each else _behind)(before, atoms)
            if number == 1 and plan.reset and not plan.each:
                _begin(atoms)
            before = atoms
        for outport in face.system.of("Outport"):
            self._result(face, outport, plan, made, passing)

    def _pass(
        self,
        level: SystemInstance,
        face: SystemInstance,
        plan: IterationPlan,
        number: int,
        made: list[SystemInstance],
        passing: list[FlatBlock],
    ) -> SystemInstance:
        """One pass, or one element."""
        assert face.holder is not None
        scope = element_scope(plan.block, face.holder, face.scope, number) if plan.each else face.scope
        inner = SystemInstance(face.system, face.path, scope, face.control)
        inner.within(level, face.holder)
        inner.repeated = plan
        inner.element = number if plan.each else level.element
        inner.passes = level.passes if plan.each else (*level.passes, number)
        inner.places = (*inner.places, (f"{face.holder.sid}:{number}", number))
        if plan.decides:
            passing.append(self._decision(inner, plan, made))
            inner.control = passing[-1]
        self.placed.levels.append(inner)
        for block in inner.system.blocks:
            self._inside(inner, block)
        return inner

    def _decision(self, inner: SystemInstance, plan: IterationPlan, made: list[SystemInstance]) -> FlatBlock:
        """What says whether a pass takes place: the condition of the pass before, for the first one that to begin."""
        found = self.placed.atom(inner, plan.block, "Pass")
        condition = Endpoint(plan.block.sid, "in", 1 if made else 2)
        if made or plan.asks_first:
            self.placed.joints.append((found, [(made[-1] if made else inner, condition)]))
        return found

    def _result(
        self,
        face: SystemInstance,
        outport: ModelBlock,
        plan: IterationPlan,
        made: list[SystemInstance],
        passing: list[FlatBlock],
    ) -> None:
        """An output: that of the last pass that took place, or of all elements side by side."""
        found = self.placed.atom(face, outport, "Joined" if plan.each else "Iterated")
        found.special = {"each": plan.block} if plan.each else {}
        end = Endpoint(outport.sid, "in")
        ends: list[tuple[SystemInstance, Endpoint] | SignalSource] = [
            (inner, end) for inner in (made if plan.each else made[-1:])
        ]
        if plan.decides:
            ends = [
                one for inner, say in zip(made, passing, strict=True) for one in ((inner, end), SignalSource(say, 0))
            ]
        self.placed.joints.append((found, ends))
        if face.control is not None and face.control.block is face.holder:
            held = self.placed.atom(face, outport, "Held")
            held.inputs = [SignalSource(found, 0)]


def _behind(before: list[FlatBlock], atoms: list[FlatBlock]) -> None:
    """Note which block of a pass is which one of the pass before; those that begin anew have none before them."""
    heads = [(one.last, other) for one, other in zip(before, atoms, strict=False) if other.earlier is None]
    for last, other in heads:
        if not other.begins:
            last.later, other.earlier = other, last
    for one in before:
        one.hidden = True


def _beside(before: list[FlatBlock], atoms: list[FlatBlock]) -> None:
    """Note that the blocks of an element stand for those of the others."""
    for atom in atoms if before else ():
        atom.hidden = True


def _begin(atoms: list[FlatBlock]) -> None:
    """Note that the memories of a first pass begin anew in each step."""
    for atom in atoms:
        if atom.earlier is None:
            atom.begins = True
