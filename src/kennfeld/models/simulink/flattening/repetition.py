"""Subsystems that run several times in a step: their blocks, placed once for each pass or element."""

from collections.abc import Callable

from kennfeld.models.simulink.files.tree import Block, Endpoint, joined
from kennfeld.models.simulink.flattening.atoms import Atom, Source
from kennfeld.models.simulink.flattening.iteration import Plan, element_scope
from kennfeld.models.simulink.flattening.levels import Level
from kennfeld.models.simulink.flattening.placed import Placed

__all__ = ["Repetition"]


class Repetition:
    """Places passes. `inside` places a block within one of them."""

    def __init__(self, placed: Placed, inside: Callable[[Level, Block], None]) -> None:
        self.placed = placed
        self._inside = inside

    def place(self, level: Level, face: Level, plan: Plan) -> None:
        """Place the blocks of a subsystem once for each pass; `face` is what is seen of it from outside."""
        assert face.holder is not None
        self.placed.built[joined(*face.path)] = plan.count
        made: list[Level] = []
        passing: list[Atom] = []
        before: list[Atom] = []
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
        self, level: Level, face: Level, plan: Plan, number: int, made: list[Level], passing: list[Atom]
    ) -> Level:
        """One pass, or one element."""
        assert face.holder is not None
        scope = element_scope(plan.block, face.holder, face.scope, number) if plan.each else face.scope
        inner = Level(face.system, face.path, scope, face.control)
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

    def _decision(self, inner: Level, plan: Plan, made: list[Level]) -> Atom:
        """What says whether a pass takes place: the condition of the pass before, for the first one that to begin."""
        found = self.placed.atom(inner, plan.block, "Pass")
        condition = Endpoint(plan.block.sid, "in", 1 if made else 2)
        if made or plan.asks_first:
            self.placed.joints.append((found, [(made[-1] if made else inner, condition)]))
        return found

    def _result(self, face: Level, outport: Block, plan: Plan, made: list[Level], passing: list[Atom]) -> None:
        """An output: that of the last pass that took place, or of all elements side by side."""
        found = self.placed.atom(face, outport, "Joined" if plan.each else "Iterated")
        found.special = {"each": plan.block} if plan.each else {}
        end = Endpoint(outport.sid, "in")
        ends: list[tuple[Level, Endpoint] | Source] = [(inner, end) for inner in (made if plan.each else made[-1:])]
        if plan.decides:
            ends = [one for inner, say in zip(made, passing, strict=True) for one in ((inner, end), Source(say, 0))]
        self.placed.joints.append((found, ends))
        if face.control is not None and face.control.block is face.holder:
            held = self.placed.atom(face, outport, "Held")
            held.inputs = [Source(found, 0)]


def _behind(before: list[Atom], atoms: list[Atom]) -> None:
    """Note which block of a pass is which one of the pass before; those that begin anew have none before them."""
    heads = [(one.last, other) for one, other in zip(before, atoms, strict=False) if other.earlier is None]
    for last, other in heads:
        if not other.begins:
            last.later, other.earlier = other, last
    for one in before:
        one.hidden = True


def _beside(before: list[Atom], atoms: list[Atom]) -> None:
    """Note that the blocks of an element stand for those of the others."""
    for atom in atoms if before else ():
        atom.hidden = True


def _begin(atoms: list[Atom]) -> None:
    """Note that the memories of a first pass begin anew in each step."""
    for atom in atoms:
        if atom.earlier is None:
            atom.begins = True
