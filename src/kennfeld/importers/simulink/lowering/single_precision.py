"""Floating-point types of signals, and the rounding of those of type single as generated code rounds them.

A signal has the type that its block specifies, else the one that follows from what it is computed of. That of a state
in feedback is known in the next pass, like its size. A block all of whose inputs are single computes in single
precision: each of its operations is rounded. Any other block of type single rounds its result.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from typing import Final

import numpy as np

from kennfeld.base.formatting import join_names
from kennfeld.graph.builder import CONDITIONS, BoundedGraphBuilder, GraphBuilder
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.float_types import FloatType, float_type_of
from kennfeld.importers.simulink.lowering.pass_state import InferredAttributes, Key
from kennfeld.importers.simulink.lowering.registry import BlockType
from kennfeld.importers.simulink.reader.dialog_words import begins_with_word
from kennfeld.importers.simulink.signals import Bus, ExternalBus, Signal, SignalOrBus, leaf_signals
from kennfeld.importers.simulink.variables.data_types import (
    BusType,
    data_type,
    has_type_of_readers,
)
from kennfeld.importers.simulink.variables.mask_scope import MaskVariable, Scope, Variable
from kennfeld.models.imperative.node_arrays import Nodes

# operations whose result is one of single precision if their operands are, and those that give conditions
_EXACT: Final = {"single", "select", "min", "max", "neg", "abs", "sign", "floor", "ceil", "round", "hold", *CONDITIONS}
_CODE: Final = ("Chart", "MATLAB Function")
# sources whose type is that of their data, which is not read
_RECORDED: Final = ("FromWorkspace", "FromFile", "FromSpreadsheet", "Signal Editor", "SignalEditor")
_DOUBLE_CALL: Final = re.compile(r"\bdouble\s*\(")
_SINGLE_CALL: Final = re.compile(r"\bsingle\s*\(")
_NAME: Final = re.compile(r"[A-Za-z]\w*")
_MAX_NAMED: Final = 3
_MAX_DEPTH: Final = 20  # of masks within masks
_UNROUNDED: Final = nullcontext()

Readers = Callable[[FlatBlock], Iterable[FlatBlock]]


class SinglePrecisionBuilder(BoundedGraphBuilder):
    """A builder that rounds the results of operations to single precision while `rounds` is True."""

    def __init__(self) -> None:
        super().__init__()
        self.rounds = False
        self._single: dict[int, bool] = {}

    def call(self, op: str, *args: int) -> int:
        is_fixed = [self.nodes[arg].op == "const" for arg in args]
        # code generation computes what is constant in double, and stores it in single precision
        if not self.rounds or all(is_fixed):
            return super().call(op, *args)
        own = [self.single(arg) if fixed else arg for arg, fixed in zip(args, is_fixed, strict=True)]
        node = super().call(op, *own)
        return node if op in _EXACT else self.single(node)

    @property
    def resolution(self) -> float:
        return float(np.finfo(np.float32).eps) if self.rounds else super().resolution

    def rounded(self, node: int) -> int:
        return self.single(node) if self.rounds else node

    def in_double(self) -> AbstractContextManager[None]:
        return self.rounding(False)

    @contextmanager
    def rounding(self, rounds: bool) -> Iterator[None]:
        """Round the results of operations in this context, or do not."""
        before, self.rounds = self.rounds, rounds
        try:
            yield
        finally:
            self.rounds = before

    def single(self, node: int) -> int:
        """Return a node rounded to single precision; itself, if it certainly is so already."""
        return node if self.is_single(node) else super().call("single", node)

    def note_single(self, nodes: Nodes) -> None:
        """Note nodes, such as states, that are rounded where they are written."""
        self._single.update(dict.fromkeys(map(int, nodes.ravel()), True))

    def is_single(self, node: int) -> bool:
        """Return True if a node is certainly a number of single precision."""
        waiting = [node]
        while waiting:
            op, args, payload = self.nodes[waiting[-1]]
            own = args[1:] if op == "select" else args
            missing = [arg for arg in own if arg not in self._single] if op in _EXACT - {"single", *CONDITIONS} else []
            if waiting[-1] in self._single:
                waiting.pop()
            elif missing:
                waiting += missing
            else:
                self._single[waiting.pop()] = self._is_single(op, own, payload)
        return self._single[node]

    def _is_single(self, op: str, args: Sequence[int], payload: object) -> bool:
        # a number that single precision holds exactly needs no rounding
        if op == "const" and isinstance(payload, float):
            with np.errstate(over="ignore"):
                return float(np.float32(payload)) == payload or payload != payload
        if op == "single" or op in CONDITIONS:
            return True
        return op in _EXACT and all(self._single[arg] for arg in args)


class FloatTypes:
    """The floating-point types of signals in one pass.

    Args:
        builder: the graph under construction; one that rounds, if signals of type single are to be rounded.
        guesses: attributes of earlier passes.
        arriving: returns the signals at the inputs of a block that are known.
        readers: returns the blocks that read a block.
        inherited: the type of a port of the model that does not specify one.
    """

    def __init__(
        self,
        builder: GraphBuilder,
        guesses: InferredAttributes,
        arriving: Callable[[FlatBlock], Sequence[SignalOrBus]],
        readers: Readers,
        inherited: FloatType,
    ) -> None:
        self.builder = builder if isinstance(builder, SinglePrecisionBuilder) else None
        self.guesses, self.arriving, self.readers, self.inherited = guesses, arriving, readers, inherited
        self.unknown: dict[str, None] = {}  # paths of blocks whose type is not known although they get single numbers

    # types

    def of_inputs(self, flat: FlatBlock) -> FloatType | None:
        """Return the type of a result that is computed of all inputs of a block, None if none is known."""
        return max((kind for wired in self.arriving(flat) for kind in _types(wired)), default=None)

    def _output(self, flat: FlatBlock, kind: BlockType, signal: Signal, at: int) -> FloatType:
        """Return the type of the output `at` of a block."""
        stated = stated_float_type(flat, self.readers, at)
        if stated is not None:
            return stated
        if kind.continuous:  # states of solvers are double
            return FloatType.DOUBLE
        if flat.inputs and flat.type in _CODE:
            return self._of_code(flat)
        inferred = signal.type if signal.type is not None or not flat.inputs else self.of_inputs(flat)
        if inferred is not None:
            return inferred
        if flat.type in ("Inport", "From"):
            return self.inherited
        if flat.type == "Constant":
            return _type_of_value(flat)
        if flat.type in _RECORDED:
            return FloatType.UNKNOWN
        return FloatType.DOUBLE if kind.output.floating and not flat.inputs else FloatType.OTHER

    def _of_code(self, flat: FlatBlock) -> FloatType:
        """Return the type of a result of code that does not specify it: single, unless the code may convert it."""
        kind = self.of_inputs(flat)
        if kind is FloatType.SINGLE and (flat.type == "Chart" or _DOUBLE_CALL.search(flat.block.script)):
            return FloatType.UNKNOWN
        return FloatType.OTHER if kind is None else kind

    # rounding

    def rounding(self, flat: FlatBlock) -> AbstractContextManager[None]:
        """Round each operation of a block that computes in single precision."""
        is_single = self.builder is not None and self._computes_in_single(flat)
        return self.builder.rounding(True) if is_single and self.builder is not None else _UNROUNDED

    def _computes_in_single(self, flat: FlatBlock) -> bool:
        # times within a chart are double, whatever its data are
        if flat.type == "Chart" or self.of_inputs(flat) is not FloatType.SINGLE:
            return False
        return stated_float_type(flat, self.readers) in (None, FloatType.SINGLE)

    def outputs(self, flat: FlatBlock, kind: BlockType, outputs: tuple[SignalOrBus, ...]) -> tuple[SignalOrBus, ...]:
        """Return the outputs of a block with their types, those of type single rounded."""
        if self.builder is None:
            return outputs
        return tuple(self._finished(flat, kind, wired, at) for at, wired in enumerate(outputs))

    def _finished(self, flat: FlatBlock, kind: BlockType, wired: SignalOrBus, at: int) -> SignalOrBus:
        if isinstance(wired, ExternalBus):
            return wired
        if isinstance(wired, Bus):
            # members have the types of their own blocks, or those of the object of a port
            return Bus({name: self._finished_member(flat, member) for name, member in wired.members.items()})
        known = self._output(flat, kind, wired, at)
        if known is FloatType.UNKNOWN and self.of_inputs(flat) is FloatType.SINGLE:
            self.unknown[flat.path] = None
        return self.rounded(replace(wired, type=known))

    def _finished_member(self, flat: FlatBlock, wired: SignalOrBus) -> SignalOrBus:
        if isinstance(wired, Bus):
            inner = {name: self._finished_member(flat, member) for name, member in wired.members.items()}
            return wired if isinstance(wired, ExternalBus) else Bus(inner)
        return self.rounded(wired)

    def rounded(self, signal: Signal) -> Signal:
        """Return a signal of type single rounded, others as they are."""
        if self.builder is None or signal.type is not FloatType.SINGLE:
            return signal
        return replace(signal, nodes=_in_single(self.builder, signal.nodes))

    def operand(self, signal: Signal) -> Signal:
        """Return an input as a block takes it: an integer is rounded if the block computes in single precision."""
        if self.builder is None or not self.builder.rounds or signal.type not in (None, FloatType.OTHER):
            return signal
        return replace(signal, nodes=_in_single(self.builder, signal.nodes))

    def rounded_nodes(self, nodes: Nodes) -> Nodes:
        """Return parameters of a block as it stores them; constants are rounded where they are used."""
        if self.builder is None or not self.builder.rounds:
            return nodes
        return np.where(_are_constant(self.builder, nodes), nodes, _in_single(self.builder, nodes))

    # states

    def begun(self, flat: FlatBlock, key: Key, init: Signal) -> Signal:
        """Return the initial value of a state, of the type of the state."""
        if self.builder is None:
            return init
        stated = None if flat.type in _CODE else stated_float_type(flat, self.readers)
        kind = self.guesses.types.get(key) if stated is None else stated
        return self.rounded(replace(init, type=kind))

    def written(self, flat: FlatBlock, key: Key, new: Signal, seen: Signal) -> Signal:
        """Return the next value of a state, of the type that the state has; note its own type for the next pass."""
        if self.builder is None:
            return new
        inferred = new.type if new.type is not None or flat.type in _CODE else self.of_inputs(flat)
        if inferred is not None:
            self.guesses.type(key, inferred)
        return self.rounded(replace(new, type=seen.type))

    def read(self, state: Signal) -> Signal:
        """Return a state, noted as one that is rounded where it is written."""
        if self.builder is not None and state.type is FloatType.SINGLE:
            self.builder.note_single(state.nodes)
        return state


def _are_constant(builder: GraphBuilder, nodes: Nodes) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return np.array([builder.value(int(node)) is not None for node in nodes.ravel()], dtype=bool).reshape(nodes.shape)


def _in_single(builder: SinglePrecisionBuilder, nodes: Nodes) -> Nodes:
    flat = np.array([builder.single(int(node)) for node in nodes.ravel()], dtype=np.int64)
    return flat.reshape(nodes.shape)


def _types(wired: SignalOrBus) -> Iterator[FloatType]:
    """Yield the types of the signals of a bus that are known."""
    if isinstance(wired, ExternalBus):
        yield FloatType.UNKNOWN
        return
    yield from (signal.type for _, signal in leaf_signals(wired) if signal.type is not None)


def stated_float_type(flat: FlatBlock, readers: Readers, at: int = 0) -> FloatType | None:
    """Return the floating-point type that a block specifies for its output `at`, None if it is inherited."""
    if flat.block.chart is not None:
        return _type_of_data(flat, at)
    if flat.data_store is not None:
        return stated_float_type(flat.data_store, readers)
    if flat.output_type is not None:
        return float_type_of(flat.output_type, flat.scope)
    if begins_with_word(flat.block.value("OutDataTypeStr") or "", "Inherit: Logical"):
        return FloatType.OTHER
    if flat.type == "DataTypeConversion" and has_type_of_readers(flat.block):
        return _type_of_readers(flat, readers)
    return None


def _type_of_readers(flat: FlatBlock, readers: Readers) -> FloatType:
    """Return the type that all readers of a conversion specify, if they only pass its result on."""
    kinds = {
        stated_float_type(reader, readers) if reader.type in ("Outport", "SignalSpecification") else None
        for reader in readers(flat)
    }
    kind = kinds.pop() if len(kinds) == 1 else None
    return FloatType.UNKNOWN if kind is None else kind


def _type_of_data(flat: FlatBlock, at: int) -> FloatType | None:
    """Return the type of an output of code, None if it is inherited."""
    assert flat.block.chart is not None
    outputs = [data.type.strip() for data in flat.block.chart.data if data.scope == "OUTPUT_DATA"]
    if at >= len(outputs) or not outputs[at] or begins_with_word(outputs[at], "Inherit"):
        return None
    return float_type_of(data_type(outputs[at], flat.scope), flat.scope)


def _type_of_value(flat: FlatBlock) -> FloatType:
    """Return the type of a constant that specifies none: that of its value, or of its readers."""
    return (
        FloatType.OTHER if has_type_of_readers(flat.block) else _class_of(flat.block.value("Value") or "1", flat.scope)
    )


def _class_of(text: str, scope: Scope, depth: int = 0) -> FloatType:
    """Return the type of an expression: single, as in MATLAB, if a part of it is."""
    if _SINGLE_CALL.search(text):
        return FloatType.SINGLE
    names = _NAME.findall(text) if depth < _MAX_DEPTH else []
    is_single = any(_is_single_variable(scope.find(name), depth) for name in names)
    return FloatType.SINGLE if is_single else FloatType.DOUBLE


def _is_single_variable(meaning: object, depth: int) -> bool:
    if isinstance(meaning, MaskVariable) and meaning.evaluated:
        return _class_of(meaning.text, meaning.outside, depth + 1) is FloatType.SINGLE
    return isinstance(meaning, Variable) and meaning.single


def single_blocks(blocks: Iterable[FlatBlock], readers: Readers) -> str:
    """Return the blocks that specify single precision, for a sentence; empty if none does."""
    paths = dict.fromkeys(flat.path for flat in blocks if not flat.hidden and _is_single_block(flat, readers))
    return join_names(list(paths), _MAX_NAMED)


def _is_single_block(flat: FlatBlock, readers: Readers) -> bool:
    if flat.type == "Inport" and isinstance(flat.output_type, BusType):
        types = (float_type_of(data_type(each.type, flat.scope), flat.scope) for each in flat.output_type.elements)
        return FloatType.SINGLE in types
    return stated_float_type(flat, readers) is FloatType.SINGLE
