"""Outputs that never change because something before them does not compute: it is commented out, disabled, or missing.

Constants are propagated through the graph as in compilers (Wegman and Zadeck, ACM TOPLAS 13 (1991) 181): all states are
first assumed to keep their initial values, until one proves to change.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.node import Node
from kennfeld.graph.operations import OPERATIONS
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, FlatModel
from kennfeld.importers.simulink.lowering.compiler import BlockCompiler
from kennfeld.importers.simulink.reader.block_ports import port_label
from kennfeld.importers.simulink.signals import leaf_signals

_MAX_CAUSES = 3  # named in a sentence


def find_constant_outputs(compiler: BlockCompiler, flat: FlatModel) -> Iterator[Finding]:
    """Yield a finding for each outport that is constant because of a block that does not compute."""
    if not any(block.commented or block.type == "Ground" or block.control is not None for block in flat.blocks):
        return
    known = constant_nodes(compiler.builder)
    for outport in flat.outports:
        nodes = _nodes(compiler, outport)
        if not nodes or any(node not in known for node in nodes):
            continue
        causes = list(dict.fromkeys(_causes(compiler, outport, known)))
        if causes:
            values = {known[node] for node in nodes}
            value = f" ({values.pop():g})" if len(values) == 1 else ""
            message = f"the output is constant{value}: {join_names(causes, _MAX_CAUSES)}"
            yield Finding(Location(path=port_label(outport.block)), message, severity="warning")


def _nodes(compiler: BlockCompiler, flat: FlatBlock) -> list[int]:
    leaves = (leaf for output in compiler.outputs(flat) for leaf in leaf_signals(output))
    return [int(node) for _, signal in leaves for node in signal.flat]


def _causes(compiler: BlockCompiler, outport: FlatBlock, known: Mapping[int, float]) -> Iterator[str]:
    """Yield why blocks upstream give constants, nearest first, along constant signals only."""
    seen, waiting = {outport}, [outport]
    for flat in waiting:  # grows while it is walked
        yield from (f"{path} is commented out" for path in flat.commented.values())
        if flat.type == "Ground":
            yield f"{flat.path} is grounded"
        before = [source.flat for source in flat.inputs if source is not None]
        if flat.control is not None and _never_runs(compiler, flat.control, known):
            yield f"{flat.control.path} never runs"
            before.append(flat.control)
        for block in before:
            if block not in seen and all(node in known for node in _nodes(compiler, block)):
                seen.add(block)
                waiting.append(block)


def _never_runs(compiler: BlockCompiler, control: FlatBlock, known: Mapping[int, float]) -> bool:
    """Return True if the condition of a conditional subsystem, its first output, is always 0."""
    nodes = _nodes(compiler, control)
    return bool(nodes) and known.get(nodes[0]) == 0


def constant_nodes(builder: GraphBuilder) -> dict[int, float]:
    """Return the values of the nodes that never change, whatever the inputs and parameters are.

    A product with 0 counts as 0.
    """
    return _Propagation(builder).known


class _Propagation:
    """Propagation of constants; `known` are the values of nodes that no changing state or input reaches."""

    def __init__(self, builder: GraphBuilder) -> None:
        self.nodes, self.states = builder.nodes, builder.states
        self.known: dict[int, float] = {}
        self._users: dict[int, list[int]] = {}
        self._written: dict[int, list[int]] = {}  # states by the nodes of their next values
        self._reads = {node.payload: at for at, node in enumerate(builder.nodes) if node.op == "state"}
        for at, node in enumerate(builder.nodes):
            for argument in node.args:
                self._users.setdefault(argument, []).append(at)
            if (value := self._value(at)) is not None:
                self.known[at] = value
        for which, state in enumerate(self.states):
            self._written.setdefault(state.next, []).append(which)
        self._drop([read for which, read in self._reads.items() if not self._keeps(which)])

    def _value(self, at: int) -> float | None:
        node = self.nodes[at]
        if node.op != "state":
            return _value(node, self.known)
        init = self.states[node.payload].init
        # assumed to keep its initial value, until `_keeps` finds otherwise
        return float(self.nodes[init].payload) if self.nodes[init].op == "const" else None

    def _keeps(self, which: int) -> bool:
        state = self.states[which]
        return state.init in self.known and self.known.get(state.next) == self.known[state.init]

    def _drop(self, waiting: list[int]) -> None:
        """Drop the values of nodes, and of those that depend on them."""
        while waiting:
            at = waiting.pop()
            if self.known.pop(at, None) is None:
                continue
            waiting += [user for user in self._users.get(at, ()) if user in self.known and self._value(user) is None]
            # a state whose next value changes is read as a changing one
            waiting += [self._reads[which] for which in self._written.get(at, ()) if which in self._reads]


def _value(node: Node, known: Mapping[int, float]) -> float | None:
    args = [known.get(a) for a in node.args]
    match node.op, args:
        case "const", _:
            return float(node.payload)
        case "hold", [x]:
            return x
        case "advance", [start, slope, *_]:
            return start if slope == 0 else None
        case "select", [condition, yes, no]:
            if condition is None:
                return yes if yes == no else None
            return yes if condition else no
        case (("mul" | "and"), _) if 0 in args:
            return 0.0
    if node.op not in OPERATIONS or None in args:
        return None
    with np.errstate(all="ignore"):
        return float(OPERATIONS[node.op].evaluate(*args))
