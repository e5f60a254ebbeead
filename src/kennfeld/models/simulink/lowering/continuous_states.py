"""Continuous states, advanced by a fixed-step Runge-Kutta method within one step of the graph.

Minor steps evaluate the derivatives again at intermediate states and times; inputs and what changes only at major steps
(marked by the op `major`) are held. Coefficients: Euler; Heun; Bogacki and Shampine, Appl. Math. Lett. 2 (1989) 321;
the classic fourth-order method; Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, its fifth-order solution
without error control.
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


class ButcherTableau(NamedTuple):
    """Explicit Runge-Kutta method: nodes, rows of the matrix below the diagonal, and weights."""

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
    """Close continuous states with their values after one solver step of length dt."""
    if not states:
        return
    tableau, dt = SOLVERS[solver], builder.input("dt")
    stages: list[list[int]] = []
    for node, row in zip(tableau.nodes, tableau.rows, strict=True):
        if not row:
            stages.append([_limit_slope(builder, state, state.slope, state.seen) for state in states])
            continue
        between = [
            _advance_state(builder, state.seen, row, [stage[i] for stage in stages], dt)
            for i, state in enumerate(states)
        ]
        place = {state.seen: x for state, x in zip(states, between, strict=True)}
        place[builder.input("t")] = _later(builder, node, dt)
        new_states = _replace_nodes(builder, [state.slope for state in states], place)
        stages.append(
            [_limit_slope(builder, state, f, x) for state, f, x in zip(states, new_states, between, strict=True)]
        )
    for i, state in enumerate(states):
        _close(builder, state, _advance_state(builder, state.seen, tableau.weights, [stage[i] for stage in stages], dt))


def _later(builder: GraphBuilder, node: float, dt: int) -> int:
    return builder.call("add", builder.input("t"), builder.call("mul", builder.const(node), dt))


def _advance_state(builder: GraphBuilder, x: int, row: Sequence[float], slopes: Sequence[int], dt: int) -> int:
    """Return x + dt (a1 k1 + a2 k2 + ...)."""
    total = builder.const(0.0)
    for share, slope in zip(row, slopes, strict=True):
        if share:
            total = builder.call("add", total, builder.call("mul", builder.const(share), slope))
    return builder.call("add", x, builder.call("mul", dt, total))


def _limit_slope(builder: GraphBuilder, state: ContinuousState, slope: int, x: int) -> int:
    """Return the slope of a state, 0 at a limit while it points outwards."""
    zero = builder.const(0.0)
    low, high = state.limits
    for limit, beyond, outwards in ((low, "le", "lt"), (high, "ge", "gt")):
        if limit is not None:
            rests = builder.call("and", builder.call(beyond, x, limit), builder.call(outwards, slope, zero))
            slope = builder.call("select", rests, zero, slope)
    return slope


def _close(builder: GraphBuilder, state: ContinuousState, new: int) -> None:
    low, high = state.limits
    if low is not None:
        new = builder.call("max", new, low)
    if high is not None:
        new = builder.call("min", new, high)
    if state.active is not None:
        new = builder.call("select", state.active, new, state.seen)
    builder.close(state.state, state.init, new)


def _replace_nodes(builder: GraphBuilder, roots: Sequence[int], place: Mapping[int, int]) -> list[int]:
    """Return the nodes of roots with some nodes replaced."""
    replaced = dict(place)
    needed = _dependencies(builder, roots, replaced)
    for at in sorted(needed):
        op, args, payload = builder.nodes[at]
        if op == "major" or all(replaced.get(a, a) == a for a in args):
            replaced[at] = at
        else:
            changed = tuple(replaced.get(a, a) for a in args)
            replaced[at] = builder.node(op, changed, payload) if op == "lookup" else builder.call(op, *changed)
    return [replaced.get(root, root) for root in roots]


def _dependencies(builder: GraphBuilder, roots: Sequence[int], stop: Mapping[int, int]) -> set[int]:
    """Return the nodes that roots depend on within a minor step, down to the replaced ones."""
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
    """Continuous states of all blocks."""

    def __init__(self, memories: DiscreteStates) -> None:
        self.builder = memories.builder
        self.memories = memories
        self.shapes = memories.shapes
        self._found: list[ContinuousState] = []

    def integrate(
        self,
        block: BlockContext,
        number: int,
        init: Signal,
        slope: Callable[[Signal], Signal],
        reset: Signal | None,
        limits: tuple[Signal, Signal] | None,
    ) -> Signal:
        """Return a continuous state as it is now; the solver advances it at the end of the step."""
        if block.flat.passes:
            raise UnsupportedError("it integrates over time in an iterated subsystem, which is not supported")
        key = (block.flat, number)
        first = self._initial_states(block, key, init, reset, limits)
        states = self.memories.ports.states(key, first)
        read = Signal(np.array(states, dtype=np.int64).reshape(first.shape), CONTINUOUS)
        seen = self.memories.reset_with_subsystem(block.flat, read, first)
        if reset is not None:
            again = block.select(self.memories.timing.hold_in_minor_steps(reset), Signal(first), seen)
            seen = replace(seen, nodes=again.nodes)

        def complete() -> None:
            moving = self._slopes(block, key, seen, slope)
            self._register(block, states, first, seen, moving, limits)

        self.memories.agenda.add(block.flat, complete)
        return seen

    def _initial_states(
        self, block: BlockContext, key: Key, init: Signal, reset: Signal | None, limits: tuple[Signal, Signal] | None
    ) -> Nodes:
        """Return the initial states within limits, as many as there are elements in state, reset or limits."""
        inside = init if limits is None else block.clip(init, *limits)
        first = block.broadcast(inside, *(limit for limit in (reset, *(limits or ())) if limit is not None))[0]
        shape = self.shapes.state_shape(key, first)
        return fit_to_shape(first.nodes, shape) if first.size in (1, int(np.prod(shape))) else first.nodes

    def _slopes(self, block: BlockContext, key: Key, seen: Signal, slope: Callable[[Signal], Signal]) -> Nodes:
        """Return the slopes of a block's states; another shape is used in the next pass."""
        rates = replace(seen, nodes=np.full(seen.shape, self.builder.const(0.0), dtype=np.int64))
        try:
            if self.memories.is_sound(block):
                rates = slope(seen)
        except UnsupportedError as unsupported:
            self.memories.failures.note(block.flat, *unsupported.parts)
        if rates.size == 1 < seen.size:
            self.memories.check_widened(block, key)
        if rates.size > 1 and rates.shape != seen.shape:
            self.memories.request_shape(block, key, rates.shape, seen.shape)
            rates = replace(seen, nodes=np.full(seen.shape, rates.nodes.ravel()[0], dtype=np.int64))
        return fit_to_shape(rates.nodes, seen.shape)

    def _register(
        self,
        block: BlockContext,
        states: Sequence[int],
        first: Nodes,
        seen: Signal,
        moving: Nodes,
        limits: tuple[Signal, Signal] | None,
    ) -> None:
        low, high = (None, None) if limits is None else tuple(fit_to_shape(x.nodes, seen.shape).ravel() for x in limits)
        active = self.memories.gates.run_condition(block.flat)
        parts = zip(states, first.ravel(), seen.nodes.ravel(), moving.ravel(), strict=True)
        for at, (state, init, now, rate) in enumerate(parts):
            bounds = (None, None) if low is None or high is None else (int(low[at]), int(high[at]))
            self._found.append(ContinuousState(state, int(init), int(now), int(rate), bounds, active))

    def resolve_initial_values(self) -> None:
        """Make initial values at state ports independent of the states themselves."""
        self._found = self.memories.ports.resolve_initial_values(self._found)

    def advance(self, solver: str) -> None:
        """Close the states with their values after one solver step."""
        integrate_step(self.builder, self._found, solver)
