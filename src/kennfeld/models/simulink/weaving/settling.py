"""Passes over the blocks until every guess is right.

Sizes and sample times of memories that are fed back are not known when they are first read: they are guessed, and the
graph is built again with what was found until nothing changes.
"""

from collections.abc import Callable, Collection

from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.weaving.guesses import Guesses
from kennfeld.models.simulink.weaving.weaver import Weaver

__all__ = ["settled"]

_MOST_PASSES = 500
_MOST_ASKED = 20_000_000  # operations of all passes
_UNSETTLED = "the sizes or sample times of the signals that are fed back before it do not settle"
_MEND = "Give the delays and integrators before it initial values of the size of their signals."


def settled(make: Callable[[Guesses], Weaver], goals: Collection[Atom]) -> Weaver:
    """The pass in which every guess was right; where none is, that is what stops the first of the goals."""
    guesses = Guesses()
    weaver = make(guesses)
    stopped: Weaver | None = None
    asked = 0
    for _ in range(min(_MOST_PASSES, len(weaver.flat.atoms) + 10)):
        if asked > _MOST_ASKED:
            break
        guesses.changed = False
        weaver = make(guesses)
        weaver.demand(goals)
        asked += weaver.loom.asked
        doubled = guesses.taken | (weaver.inputs.keys() & weaver.declared.parameters.keys())
        guesses.changed |= doubled != guesses.taken
        guesses.taken = doubled
        if guesses.changed:
            continue
        wishes = weaver.shapes.wishes
        if not weaver.failures or not wishes or stopped is not None:
            return stopped if stopped is not None and len(stopped.failures) <= len(weaver.failures) else weaver
        stopped, guesses.wished = weaver, wishes
        guesses.shapes.update(wishes)
    weaver.failures.note(next(iter(goals)), _UNSETTLED, _MEND)
    return weaver
