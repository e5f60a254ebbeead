"""Signals that lead nowhere: the outputs of a model in which no block is an outport or records or displays a signal."""

from dataclasses import replace

from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, FlatModel
from kennfeld.importers.simulink.flattening.flatten import standalone_system
from kennfeld.importers.simulink.flattening.hierarchy import SPECIAL
from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.importers.simulink.reader.model_tree import ModelDocument

_NOTES = ("DocBlock", "CMBlock", "Model Info", "Note")
# a constant at an open end carries no signal, and a condition is no signal of the model
_NO_RESULTS = (
    "Constant", "Ground", "Inport", "From", "DataStoreMemory", "DataStoreRead", "ConditionalSubsystem",
    "IterationCondition", "ForEachPartition", "BusElement", "InactiveVariant", "FunctionCallGenerator",
    "Function-Call Generator",
)  # fmt: skip


def with_open_ends(flat: FlatModel) -> FlatModel:
    """Return a model whose results are the blocks with open outputs if it has no other results."""
    if flat.results:
        return flat
    candidates = [
        block
        for block in flat.blocks
        # of an iterated subsystem, the last iteration has the result
        if block.type not in _NO_RESULTS and block.next_pass is None and not (block.hidden or block.synthetic)
    ]
    return replace(flat, ends=tuple(block for block in candidates if open_ports(flat, block, _output_count(block))))


def open_ports(flat: FlatModel, block: FlatBlock, count: int) -> list[int]:
    """Return those of a block's `count` outputs, from 0, that lead to no block with an output or an effect."""
    read = {
        source.port
        for reader in flat.readers.get(block, ())
        if not _ends_signals(flat, reader)
        for source in reader.inputs
        if source is not None and source.flat is block
    }
    return [port for port in range(count) if port not in read]


def _ends_signals(flat: FlatModel, reader: FlatBlock) -> bool:
    """Return True if a block has no outputs and no effect on others, such as a Terminator or the driver of a pin."""
    if reader.type == "DataStoreWrite":
        return not any(b.data_store is reader.data_store and b.type == "DataStoreRead" for b in flat.blocks)
    kind = BLOCK_TYPES.get(reader.type)
    return kind.sink if kind is not None else not _output_count(reader)


def _output_count(block: FlatBlock) -> int:
    """Return the number of outputs; a block whose file does not state it has one, unless its type is a sink."""
    kind, ports = BLOCK_TYPES.get(block.type), block.block.ports
    if (kind is not None and kind.sink) or block.type == "DataStoreWrite":
        return 0
    if block.type == "Chart" and ports is not None:
        return max(ports.outputs, 1)  # without outputs, its data and states
    # the output of a conditional or iterated subsystem stands for a port, which counts none itself
    return 1 if ports is None or block.block.type == "Outport" else ports.outputs


def with_ports_of_only_block(document: ModelDocument) -> tuple[ModelDocument, str]:
    """Return a document whose only block, a subsystem or chart without lines, has a port for each of its signals.

    Such a file is a function that is kept in a model or library of its own. The second value is the path of the block,
    "" for any other document, which is returned unchanged.
    """
    root = document.root
    blocks = [block for block in root.blocks if block.type not in _NOTES]
    if root.lines or len(blocks) != 1 or blocks[0].system is None:
        return document, ""
    (block,) = blocks
    assert block.system is not None
    # a control port would have no source: the subsystem would never run
    if block.chart is None and any(block.system.of(*SPECIAL)):
        return document, ""
    alone = standalone_system(block, block.system)
    return (replace(document, root=alone), block.path) if len(alone.blocks) > 1 else (document, "")
