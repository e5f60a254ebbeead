"""First values that depend on themselves in appearance only.

What resets an integrator may be made from its own state, with another value in the first step: the state port leads
through a block `IC` to the port of the initial value. In the first step that block gives its constant, so that the
initial value is known once the memories in its way are replaced by what they start with.
"""

from collections.abc import Mapping

from kennfeld.graph.operations import OPERATIONS
from kennfeld.models.formula.functions import Loom

__all__ = ["at_start"]

_MOST_ROUNDS = 100  # memories that start from one another


def at_start(loom: Loom, state: int, inits: Mapping[int, int]) -> int | None:
    """The node of a state's first value, free of the state itself; None where it does depend on itself.

    `inits` are the nodes of first values as they are written, by the nodes of states.
    """
    made = inits[state]
    for _ in range(_MOST_ROUNDS):
        behind = _behind(loom, made)
        if state not in behind:
            return made
        known = {at: inits[at] for at in behind if at in inits and at != state}
        if not known:
            return None
        made = _with(loom, made, behind, known)
    return None


def _behind(loom: Loom, root: int) -> set[int]:
    """The nodes that a node is computed from within the step, and itself."""
    seen, stack = {root}, [root]
    while stack:
        args = [a for a in loom.nodes[stack.pop()].args if a not in seen]
        seen.update(args)
        stack += args
    return seen


def _with(loom: Loom, root: int, behind: set[int], known: Mapping[int, int]) -> int:
    """A node with some states replaced."""
    made = dict(known)
    for at in sorted(behind - known.keys()):
        op, args, payload = loom.nodes[at]
        changed = tuple(made[a] for a in args)
        if op == "major" and loom.value(changed[0]) is not None:
            made[at] = changed[0]
        else:
            made[at] = loom.call(op, *changed) if op in OPERATIONS else loom.node(op, changed, payload)
    return made[root]
