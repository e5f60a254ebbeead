"""Continuous states, advanced by a fixed-step Runge-Kutta method within one step of the graph.

The minor steps evaluate the derivatives again, at states and times in between; what only changes at major steps (the
op `major` marks it) and all inputs keep their values. Coefficients: Euler; Heun; Bogacki and Shampine, Appl. Math.
Lett. 2 (1989) 321; the classic method of fourth order; Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, its
solution of fifth order without error control.

Continuous states: how blocks see them now, and their slopes, with which the solver advances them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.discrete_states import DiscreteStates
from kennfeld.models.simulink.lowering.pass_state import Key
from kennfeld.models.simulink.lowering.state_ports import ContinuousState
from kennfeld.models.simulink.signals import CONTINUOUS, Signal, fit_to_shape

__all__ = ["SOLVERS", "ContinuousStates"]


class ButcherTableau(NamedTuple):
    """Nodes, the rows of the matrix below its diagonal, and the weights of an explicit Runge-Kutta method."""

    nodes: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]


SOLVERS: Final = {
    "ode1": ButcherTableau((0.0,), ((),), (1.0,)),
    "ode2": ButcherTableau((0.0, 1.0), ((), (1.0,)), (0.5, 0.5)),
    "ode3": ButcherTableau((0.0, 1 / 2, 3 / 4), ((), (1 / 2,), (0.0, 3 / 4)), (2 / 9, 1 / 3, 4 / 9)),
    "ode4": ButcherTableau(
        (0.0, 0.5, 0.5, 1.0), ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0)), (1 / 6, 1 / 3, 1 / 3, 1 / 6)
    ),
    "ode5": ButcherTableau(
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


def integrate_step(builder: GraphBuilder, states: Sequence[ContinuousState], solver: str) -> None:
    """Close the memories of continuous states with what a solver makes of them in one step of length dt."""
    if not states:
        return
    tableau, dt = SOLVERS[solver], builder.input("dt")
    stages: list[list[int]] = []
    for node, row in zip(tableau.nodes, tableau.rows, strict=True):
        if not row:
            stages.append([_limited(builder, one, one.slope, one.seen) for one in states])
            continue
        between = [_moved(builder, one.seen, row, [stage[i] for stage in stages], dt) for i, one in enumerate(states)]
        place = {one.seen: x for one, x in zip(states, between, strict=True)}
        place[builder.input("t")] = _later(builder, node, dt)
        found = _replaced(builder, [one.slope for one in states], place)
        stages.append([_limited(builder, one, f, x) for one, f, x in zip(states, found, between, strict=True)])
    for i, one in enumerate(states):
        _close(builder, one, _moved(builder, one.seen, tableau.weights, [stage[i] for stage in stages], dt))


def _later(builder: GraphBuilder, node: float, dt: int) -> int:
    return builder.call("add", builder.input("t"), builder.call("mul", builder.const(node), dt))


def _moved(builder: GraphBuilder, x: int, row: Sequence[float], slopes: Sequence[int], dt: int) -> int:
    """A state moved on: x + dt (a1 k1 + a2 k2 + ...)."""
    total = builder.const(0.0)
    for share, slope in zip(row, slopes, strict=True):
        if share:
            total = builder.call("add", total, builder.call("mul", builder.const(share), slope))
    return builder.call("add", x, builder.call("mul", dt, total))


def _limited(builder: GraphBuilder, one: ContinuousState, slope: int, x: int) -> int:
    """The slope of a state that rests at a limit as long as it is pushed outwards."""
    zero = builder.const(0.0)
    low, high = one.limits
    for limit, beyond, outwards in ((low, "le", "lt"), (high, "ge", "gt")):
        if limit is not None:
            rests = builder.call("and", builder.call(beyond, x, limit), builder.call(outwards, slope, zero))
            slope = builder.call("select", rests, zero, slope)
    return slope


def _close(builder: GraphBuilder, one: ContinuousState, new: int) -> None:
    low, high = one.limits
    if low is not None:
        new = builder.call("max", new, low)
    if high is not None:
        new = builder.call("min", new, high)
    if one.active is not None:
        new = builder.call("select", one.active, new, one.seen)
    builder.close(one.state, one.init, new)


def _replaced(builder: GraphBuilder, roots: Sequence[int], place: Mapping[int, int]) -> list[int]:
    """The nodes that compute the roots with some nodes replaced by others."""
    made = dict(place)
    needed = _behind(builder, roots, made)
    for at in sorted(needed):
        op, args, payload = builder.nodes[at]
        if op == "major" or all(made.get(a, a) == a for a in args):
            made[at] = at
        else:
            changed = tuple(made.get(a, a) for a in args)
            made[at] = builder.node(op, changed, payload) if op == "lookup" else builder.call(op, *changed)
    return [made.get(root, root) for root in roots]


def _behind(builder: GraphBuilder, roots: Sequence[int], stop: Mapping[int, int]) -> set[int]:
    """The nodes that roots are computed from within a minor step, down to those that are replaced."""
    seen: set[int] = set()
    stack = [root for root in roots if root not in stop]
    while stack:
        at = stack.pop()
        if at in seen:
            continue
        seen.add(at)
        if builder.nodes[at].op != "major":
            stack += [a for a in builder.nodes[at].args if a not in stop and a not in seen]
    return seen


class ContinuousStates:
    """The states that are integrated over time."""

    def __init__(self, memories: DiscreteStates) -> None:
        self.builder = memories.builder
        self.memories = memories
        self.shapes = memories.shapes
        self._found: list[ContinuousState] = []

    def integrate(
        self,
        site: BlockContext,
        number: int,
        init: Signal,
        slope: Callable[[Signal], Signal],
        reset: Signal | None,
        limits: tuple[Signal, Signal] | None,
    ) -> Signal:
        """A continuous state as it is now: the solver advances it at the end of the step."""
        if site.atom.passes:
            raise UnsupportedError("it is integrated over time in a subsystem that runs several times in a step")
        key = (site.atom, number)
        first = self._first(site, key, init, reset, limits)
        states = self.memories.ports.states(key, first)
        read = Signal(np.array(states, dtype=np.int64).reshape(first.shape), CONTINUOUS)
        seen = self.memories.restarted(site.atom, read, first)
        if reset is not None:
            again = site.select(self.memories.timing.at_major(reset), Signal(first), seen)
            seen = replace(seen, nodes=again.nodes)

        def complete() -> None:
            moving = self._slopes(site, key, seen, slope)
            self._note(site, states, first, seen, moving, limits)

        self.memories.agenda.add(site.atom, complete)
        return seen

    def _first(
        self, site: BlockContext, key: Key, init: Signal, reset: Signal | None, limits: tuple[Signal, Signal] | None
    ) -> Nodes:
        """The states at first, within their limits; as many as there are resets or limits, if these are several."""
        inside = init if limits is None else site.clip(init, *limits)
        first = site.spread(inside, *(one for one in (reset, *(limits or ())) if one is not None))[0]
        shape = self.shapes.of(key, first)
        return fit_to_shape(first.nodes, shape) if first.size in (1, int(np.prod(shape))) else first.nodes

    def _slopes(self, site: BlockContext, key: Key, seen: Signal, slope: Callable[[Signal], Signal]) -> Nodes:
        """The slopes of a block's states; the next pass takes another shape that they have."""
        rates = replace(seen, nodes=np.full(seen.shape, self.builder.const(0.0), dtype=np.int64))
        try:
            if self.memories.is_sound(site):
                rates = slope(seen)
        except UnsupportedError as unsupported:
            self.memories.failures.note(site.atom, *unsupported.parts)
        if rates.size == 1 < seen.size:
            self.memories.check_widened(site, key)
        if rates.size > 1 and rates.shape != seen.shape:
            self.memories.ask(site, key, rates.shape, seen.shape)
            rates = replace(seen, nodes=np.full(seen.shape, rates.nodes.ravel()[0], dtype=np.int64))
        return fit_to_shape(rates.nodes, seen.shape)

    def _note(
        self,
        site: BlockContext,
        states: Sequence[int],
        first: Nodes,
        seen: Signal,
        moving: Nodes,
        limits: tuple[Signal, Signal] | None,
    ) -> None:
        """Note the states of a block for the solver."""
        low, high = (None, None) if limits is None else tuple(fit_to_shape(x.nodes, seen.shape).ravel() for x in limits)
        active = self.memories.gates.active(site.atom)
        parts = zip(states, first.ravel(), seen.nodes.ravel(), moving.ravel(), strict=True)
        for at, (state, init, now, rate) in enumerate(parts):
            bounds = (None, None) if low is None or high is None else (int(low[at]), int(high[at]))
            self._found.append(ContinuousState(state, int(init), int(now), int(rate), bounds, active))

    def settle(self) -> None:
        """Free the first values behind state ports of the states themselves."""
        self._found = self.memories.ports.settled(self._found)

    def advance(self, solver: str) -> None:
        """Close the states with what a solver makes of them in one step."""
        integrate_step(self.builder, self._found, solver)
