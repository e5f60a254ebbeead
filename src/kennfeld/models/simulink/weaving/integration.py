"""Continuous states, advanced by a fixed-step Runge-Kutta method within one step of the graph.

The minor steps evaluate the derivatives again, at states and times in between; what only changes at major steps (the
op `major` marks it) and all inputs keep their values. Coefficients: Euler; Heun; Bogacki and Shampine, Appl. Math.
Lett. 2 (1989) 321; the classic method of fourth order; Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, its
solution of fifth order without error control.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from kennfeld.models.formula.functions import Loom

__all__ = ["SOLVERS", "Integrated", "Tableau", "advance"]


class Tableau(NamedTuple):
    """Nodes, the rows of the matrix below its diagonal, and the weights of an explicit Runge-Kutta method."""

    nodes: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]


SOLVERS: Final = {
    "ode1": Tableau((0.0,), ((),), (1.0,)),
    "ode2": Tableau((0.0, 1.0), ((), (1.0,)), (0.5, 0.5)),
    "ode3": Tableau((0.0, 1 / 2, 3 / 4), ((), (1 / 2,), (0.0, 3 / 4)), (2 / 9, 1 / 3, 4 / 9)),
    "ode4": Tableau((0.0, 0.5, 0.5, 1.0), ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
    "ode5": Tableau(
        (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0),
        (
            (),
            (1 / 5,),
            (3 / 40, 9 / 40),
            (44 / 45, -56 / 15, 32 / 9),
            (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
            (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        ),
        (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    ),
}


class Integrated(NamedTuple):
    """A continuous state: its memory, its first value, how the blocks see it, its slope, limits, and when it runs."""

    state: int
    init: int
    seen: int
    slope: int
    limits: tuple[int | None, int | None] = (None, None)
    active: int | None = None


def advance(loom: Loom, states: Sequence[Integrated], solver: str) -> None:
    """Close the memories of continuous states with what a solver makes of them in one step of length dt."""
    if not states:
        return
    tableau, dt = SOLVERS[solver], loom.input("dt")
    stages: list[list[int]] = []
    for node, row in zip(tableau.nodes, tableau.rows, strict=True):
        if not row:
            stages.append([_limited(loom, one, one.slope, one.seen) for one in states])
            continue
        between = [_moved(loom, one.seen, row, [stage[i] for stage in stages], dt) for i, one in enumerate(states)]
        place = {one.seen: x for one, x in zip(states, between, strict=True)}
        place[loom.input("t")] = _later(loom, node, dt)
        found = _replaced(loom, [one.slope for one in states], place)
        stages.append([_limited(loom, one, f, x) for one, f, x in zip(states, found, between, strict=True)])
    for i, one in enumerate(states):
        _close(loom, one, _moved(loom, one.seen, tableau.weights, [stage[i] for stage in stages], dt))


def _later(loom: Loom, node: float, dt: int) -> int:
    return loom.call("add", loom.input("t"), loom.call("mul", loom.const(node), dt))


def _moved(loom: Loom, x: int, row: Sequence[float], slopes: Sequence[int], dt: int) -> int:
    """A state moved on: x + dt (a1 k1 + a2 k2 + ...)."""
    total = loom.const(0.0)
    for share, slope in zip(row, slopes, strict=True):
        if share:
            total = loom.call("add", total, loom.call("mul", loom.const(share), slope))
    return loom.call("add", x, loom.call("mul", dt, total))


def _limited(loom: Loom, one: Integrated, slope: int, x: int) -> int:
    """The slope of a state that rests at a limit as long as it is pushed outwards."""
    zero = loom.const(0.0)
    low, high = one.limits
    for limit, beyond, outwards in ((low, "le", "lt"), (high, "ge", "gt")):
        if limit is not None:
            rests = loom.call("and", loom.call(beyond, x, limit), loom.call(outwards, slope, zero))
            slope = loom.call("select", rests, zero, slope)
    return slope


def _close(loom: Loom, one: Integrated, new: int) -> None:
    low, high = one.limits
    if low is not None:
        new = loom.call("max", new, low)
    if high is not None:
        new = loom.call("min", new, high)
    if one.active is not None:
        new = loom.call("select", one.active, new, one.seen)
    loom.close(one.state, one.init, new)


def _replaced(loom: Loom, roots: Sequence[int], place: Mapping[int, int]) -> list[int]:
    """The nodes that compute the roots with some nodes replaced by others."""
    made = dict(place)
    needed = _behind(loom, roots, made)
    for at in sorted(needed):
        op, args, payload = loom.nodes[at]
        if op == "major" or all(made.get(a, a) == a for a in args):
            made[at] = at
        else:
            changed = tuple(made.get(a, a) for a in args)
            made[at] = loom.node(op, changed, payload) if op == "lookup" else loom.call(op, *changed)
    return [made.get(root, root) for root in roots]


def _behind(loom: Loom, roots: Sequence[int], stop: Mapping[int, int]) -> set[int]:
    """The nodes that roots are computed from within a minor step, down to those that are replaced."""
    seen: set[int] = set()
    stack = [root for root in roots if root not in stop]
    while stack:
        at = stack.pop()
        if at in seen:
            continue
        seen.add(at)
        if loom.nodes[at].op != "major":
            stack += [a for a in loom.nodes[at].args if a not in stop and a not in seen]
    return seen
