"""Continuous states, advanced by a fixed-step Runge-Kutta method within one step of the graph.

Minor steps evaluate the derivatives again at intermediate states and times; inputs and what changes only at major steps
(marked by the op `major`) are held. Coefficients: Euler; Heun; Bogacki and Shampine, Appl. Math. Lett. 2 (1989) 321;
the classic fourth-order method; Dormand and Prince, J. Comput. Appl. Math. 6 (1980) 19, its fifth-order solution
without error control.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.lowering.diagnostics import UnsupportedError
from kennfeld.models.simulink.lowering.discrete_states import DiscreteStates
from kennfeld.models.simulink.lowering.pass_state import Key
from kennfeld.models.simulink.lowering.state_ports import ContinuousState
from kennfeld.models.simulink.signals import Signal, SignalRule, broadcast, clip, fit_to_shape, select


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
            _advance_state(builder, state.seen, row, slopes, dt) for state, *slopes in zip(states, *stages, strict=True)
        ]
        replaced = {state.seen: x for state, x in zip(states, between, strict=True)}
        t = builder.input("t")
        replaced[t] = builder.call("add", t, builder.call("mul", builder.const(node), dt))
        slopes = _replace_nodes(builder, [state.slope for state in states], replaced)
        parts = zip(states, slopes, between, strict=True)
        stages.append([_limit_slope(builder, state, slope, x) for state, slope, x in parts])
    for state, *slopes in zip(states, *stages, strict=True):
        _close(builder, state, _advance_state(builder, state.seen, tableau.weights, slopes, dt))


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
    for at in sorted(_dependencies(builder, roots, replaced)):
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
        self._states: list[ContinuousState] = []

    def integrate(
        self,
        flat: FlatBlock,
        number: int,
        init: Signal,
        slope: SignalRule,
        reset: Signal | None,
        limits: tuple[Signal, Signal] | None,
    ) -> Signal:
        """Return a continuous state as it is now; the solver advances it at the end of the step."""
        if flat.passes:
            raise UnsupportedError("it integrates over time in an iterated subsystem, which is not supported")
        key = (flat, number)
        first = self._initial_states(key, init, reset, limits)
        states = self.memories.ports.states(key, first)
        read = Signal(np.array(states, dtype=np.int64).reshape(first.shape), builder=self.builder)
        seen = self.memories.reset_with_subsystem(flat, read, first)
        if reset is not None:
            again = select(self.memories.timing.hold_in_minor_steps(reset), Signal(first), seen)
            seen = replace(seen, nodes=again.nodes)

        def complete() -> None:
            slopes = self._slopes(flat, key, seen, slope)
            bounds: list[tuple[int | None, int | None]] = [(None, None)] * seen.size
            if limits is not None:
                low, high = (fit_to_shape(limit.nodes, seen.shape).ravel() for limit in limits)
                bounds = [(int(lower), int(upper)) for lower, upper in zip(low, high, strict=True)]
            active = self.memories.gates.run_condition(flat)
            parts = zip(states, first.ravel(), seen.nodes.ravel(), slopes.ravel(), bounds, strict=True)
            for state, init, now, rate, bound in parts:
                self._states.append(ContinuousState(state, int(init), int(now), int(rate), bound, active))

        self.memories.agenda.add(flat, complete)
        return seen

    def _initial_states(
        self, key: Key, init: Signal, reset: Signal | None, limits: tuple[Signal, Signal] | None
    ) -> Nodes:
        """Return the initial states within limits, as many as there are elements in state, reset or limits."""
        inside = init if limits is None else clip(init, *limits)
        first = broadcast(inside, *(limit for limit in (reset, *(limits or ())) if limit is not None))[0]
        shape = self.shapes.state_shape(key, first)
        return fit_to_shape(first.nodes, shape) if first.size in (1, int(np.prod(shape))) else first.nodes

    def _slopes(self, flat: FlatBlock, key: Key, seen: Signal, slope: SignalRule) -> Nodes:
        """Return the slopes of a block's states; another shape is used in the next pass."""
        rates = replace(seen, nodes=np.full(seen.shape, self.builder.const(0.0), dtype=np.int64))
        with self.memories.failures.note_errors(flat):
            if self.memories.is_sound(flat):
                rates = slope(seen)
        if rates.size == 1 < seen.size:
            self.memories.check_widened(flat, key)
        if rates.size > 1 and rates.shape != seen.shape:
            self.memories.request_shape(flat, key, rates.shape, seen.shape)
            rates = replace(seen, nodes=np.full(seen.shape, rates.nodes.ravel()[0], dtype=np.int64))
        return fit_to_shape(rates.nodes, seen.shape)

    def resolve_initial_values(self) -> None:
        """Make initial values at state ports independent of the states themselves."""
        self._states = self.memories.ports.resolve_initial_values(self._states)

    def advance(self, solver: str) -> None:
        """Close the states with their values after one solver step."""
        integrate_step(self.builder, self._states, solver)
