"""Subsystems that run several times in a step: how often, and with what they begin.

Their blocks are built once for each pass. A memory of one pass is read in the next; only the last one lasts until the
step behind. The elements of a For Each subsystem have memories of their own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.declared import Declared
from kennfeld.models.simulink.expressions.expressions import Expressions
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.files.tree import Block, System, joined
from kennfeld.models.simulink.variables.scopes import Masked, Scope, Variable

__all__ = ["LOOPS", "Plan", "element_scope", "iterator_of", "planned"]

LOOPS = ("ForIterator", "WhileIterator", "ForEach")
_MOST = 1000  # passes of one subsystem
_UNUSUAL = ("NeedActiveIterationSignal", "ShowActiveIterationCount", "ShowActiveIterationFlag", "ShowResetFlag")
_SEPARATE = "Separate states for each iteration"


@dataclass(frozen=True)
class Plan:
    """The passes of a subsystem: the block that counts them, how many, whether memories begin anew in each step."""

    block: Block
    count: int
    reset: bool = False

    @property
    def each(self) -> bool:
        """Whether the passes are elements side by side, not one after the other."""
        return self.block.type == "ForEach"

    @property
    def decides(self) -> bool:
        """Whether each pass decides on the next one."""
        return self.block.type == "WhileIterator"

    @property
    def asks_first(self) -> bool:
        """Whether even the first pass needs a condition."""
        return self.decides and (self.block.value("WhileBlockType") or "while") == "while"


def iterator_of(system: System) -> Block | None:
    """The block that makes a subsystem run several times; None where there is none."""
    return next(system.of(*LOOPS), None)


def planned(block: Block, holder: Block, names: Sequence[str], scope: Scope, counts: Mapping[str, int]) -> Plan:
    """The passes of a subsystem, by its iterator. `names` lead to it, `scope` is what its blocks see.

    `counts` are the passes that an earlier attempt has found by path. Raises `NoValueError` where their number is not
    known, or too large.
    """
    path = joined(*names)
    reset = (block.value("ResetStates") or "held") == "reset"
    if block.type == "ForEach":
        return Plan(block, _elements(block, holder, path, scope, counts))
    field = f"{joined(*names, block.name)}:"
    if block.type == "WhileIterator":
        if (block.value("WhileBlockType") or "while") not in ("while", "do-while"):
            raise NoValueError(f"WhileBlockType is {block.value('WhileBlockType')!r}, which is not supported")
        return Plan(block, _number(field + "MaxIters", block.value("MaxIters") or "5", scope), reset)
    if (block.value("ExternalIncrement") or "off") == "on":
        raise NoValueError(f"{block.name} takes its next iteration from outside, which is not supported")
    if (block.value("IterationSource") or "internal") == "external":
        return Plan(block, _bounded(counts.get(path, 1), path), reset)
    return Plan(block, _number(field + "IterationLimit", block.value("IterationLimit") or "5", scope), reset)


def _number(field: str, text: str, scope: Scope) -> int:
    """A number of passes: as given for the field, or as written."""
    given = scope.variables.get(field)
    if isinstance(given, Variable) and isinstance(given.value, np.ndarray):
        numbers = given.value
    else:
        numbers = Expressions(Loom(), Declared()).numbers(text, scope)
    if numbers.size != 1 or not float(numbers.item()).is_integer():
        raise NoValueError(f"the number of its passes is {text[:60]}, which is no whole number")
    if numbers.item() < 0 and field.endswith("MaxIters"):
        raise NoValueError(f'it may run without end; set "{field}" to the passes that it needs at most')
    return _bounded(int(numbers.item()), field)


def _bounded(count: int, field: str) -> int:
    if not 1 <= count <= _MOST:
        raise NoValueError(f"{field} asks for {count} passes in a step; 1 to {_MOST} are possible")
    return count


# for each


def _elements(block: Block, holder: Block, path: str, scope: Scope, counts: Mapping[str, int]) -> int:
    """The number of elements: as stated, as its mask's parameters have, or as an attempt has found in its inputs."""
    for unusual in _UNUSUAL:
        if (block.value(unusual) or "off") == "on":
            raise NoValueError(f"{unusual} of {block.name} is on, which is not supported")
    if (block.value("StateHandling") or _SEPARATE) != _SEPARATE:
        raise NoValueError(f"the elements of {block.name} share their states, which is not supported")
    parts = _parts(block, holder, scope)
    stated = (block.value("SpecifiedNumIters") or "-1").strip()
    if stated != "-1":
        return _number(f"{path}:SpecifiedNumIters", stated, scope)
    return _bounded(parts if parts is not None else counts.get(path, 1), path)


def element_scope(block: Block, holder: Block, inside: Scope, number: int) -> Scope:
    """The names that an element sees, counted from 1: of a mask's parameters that are partitioned, its own part."""
    parts = partitioned(block, holder)
    if not parts:
        return inside
    scope = Scope(inside.variables, {}, inside)
    for name in parts:
        found = inside.find(name)
        if isinstance(found, Masked):
            scope.masked[name] = Masked(f"({found.text})({number})", found.outside, found.evaluated, found.field)
    return scope


def partitioned(block: Block, holder: Block) -> tuple[str, ...]:
    """The parameters of a mask of which each element has a part."""
    on = block.listed("SubsysMaskParameterPartition")
    names = [one.name for one in holder.mask.parameters] if holder.mask is not None else []
    return tuple(name for name, switched in zip(names, on, strict=False) if switched == "on")


def _parts(block: Block, holder: Block, inside: Scope) -> int | None:
    """The number of elements that the parameters of the mask have; None where none is partitioned."""
    widths = set(block.listed("SubsysMaskParameterPartitionWidth")) - {"1"}
    sizes = set()
    for name in partitioned(block, holder):
        numbers = Expressions(Loom(), Declared()).numbers(name, inside)
        if widths or 1 not in np.atleast_2d(numbers).shape:
            raise NoValueError(f"the parameter {name} is partitioned otherwise than a vector into its elements")
        sizes.add(numbers.size)
    if len(sizes) > 1:
        raise NoValueError(f"its partitioned parameters have {' and '.join(map(str, sorted(sizes)))} elements")
    return next(iter(sizes), None)
