"""Signal Routing library: muxes, buses, selectors, switches and data stores."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.formatting import count_noun, size_text
from kennfeld.importers.simulink.blocks.bit_operations import fit_to_type, stored_integer
from kennfeld.importers.simulink.blocks.bus_values import fit_to_bus
from kennfeld.importers.simulink.flattening.connections import bus_member_names, find_bus_member
from kennfeld.importers.simulink.lowering import (
    LIKE_INPUT,
    BlockContext,
    Outputs,
    OutputType,
    UnsupportedError,
    block,
    no_feedthrough,
)
from kennfeld.importers.simulink.lowering.diagnostics import placeholder_signal
from kennfeld.importers.simulink.lowering.integer_signals import integer_type_of, specified_integer_type
from kennfeld.importers.simulink.lowering.parameter_fields import (
    case_values,
    dimension_settings,
    first_index,
    index_options,
    selected_indices,
    selection_length,
)
from kennfeld.importers.simulink.signals import (
    Bus,
    Signal,
    SignalOrBus,
    apply,
    as_signal,
    fit_to_shape,
    leaf_signals,
    map_members,
    period_of,
    select,
    select_by_index,
    width_notes,
)
from kennfeld.importers.simulink.variables.data_types import BusType, stated_type
from kennfeld.models.imperative.node_arrays import Nodes

_MAX_SELECTED = 10_000
_MAX_COMPARISONS = 100_000


@block("DataTypeConversion", OutDataTypeStr="Inherit: Inherit via back propagation", SampleTime="-1",
       ConvertRealWorld="Real World Value (RWV)")  # fmt: skip
def conversion(block: BlockContext) -> SignalOrBus:
    """Pass on the input, as values are physical; converted to boolean, 1 unless it is 0."""
    if block.begins_with("ConvertRealWorld", "Stored"):
        return _by_bits(block, stated_type(block.flat.block))
    if block.is_boolean:
        return apply("ne", block.input(), 0.0)
    return block.input_or_bus(0)


def _by_bits(block: BlockContext, wanted: str) -> SignalOrBus:
    """Return the number that the stored bits of the input represent in another type."""
    plain = re.fullmatch(r"u?int(8|16|32|64)|double|single|half", wanted)
    # the bits of an integer are its value; those of a fixed-point number depend on its scaling
    if not (plain and integer_type_of(block.source())):
        message = "it reinterprets the stored bits of a number, but fixed-point types are ignored"
        raise UnsupportedError(message, "Use a Gain block with the scaling instead, or bind it.")
    word = specified_integer_type(block.flat)
    return stored_integer(block, 0) if word is None else fit_to_type(block, stored_integer(block, 0), word)


@block("Mux", Inputs="4")
def mux(block: BlockContext) -> SignalOrBus:
    """Join all elements of all inputs to one vector."""
    return as_one_vector(block, *(block.input_or_bus(at) for at in range(block.input_count)))


@block("BusToVector")
def bus_to_vector(block: BlockContext) -> SignalOrBus:
    """Join the signals of a bus to one vector, a row or column if one of them is."""
    return block.joined([signal for _, signal in leaf_signals(block.input_or_bus(0))])


def as_one_vector(block: BlockContext, *wired: SignalOrBus) -> Signal:
    """Join all elements of signals and buses to one vector."""
    parts = [signal for item in wired for _, signal in leaf_signals(item)]
    return block.signal([node for part in parts for node in part.flat], period_of(parts))


@block("Demux", Outputs="4")
def demux(block: BlockContext) -> tuple[SignalOrBus, ...]:
    """Split a vector into outputs of the specified widths."""
    wired = as_signal(block.input_or_bus(0))
    if isinstance(wired, Bus):
        members = list(wired.members.values())
        # a bus of as many members is taken apart, any other one is a vector
        if len(members) == _outputs(block):
            return tuple(members)
        wired = as_one_vector(block, wired)
    stated = _stated(block)
    # a list of widths is a width in all if it leaves none open
    wanted = stated[0] if len(stated) == 1 else sum(stated) if min(stated) > 0 else len(stated)
    if wired.size == 1 < wanted:
        block.suggest_dimensions((wanted,))
    ends = np.cumsum(_widths(block, wired))
    return tuple(block.signal(part, wired.period) for part in np.split(np.array(wired.flat), ends[:-1]))


def _outputs(block: BlockContext) -> int:
    widths = _stated(block)
    return widths[0] if len(widths) == 1 else len(widths)


def _stated(block: BlockContext) -> list[int]:
    """Return the number of outputs, or the width of each output."""
    numbers = block.numeric_array("Outputs").ravel()
    if not (numbers.size and all(n.is_integer() for n in numbers.tolist())):
        raise UnsupportedError(f"its Outputs must be integers, got {block.field_text('Outputs')[:60]}")
    return [int(n) for n in numbers]


def _widths(block: BlockContext, wired: Signal) -> list[int]:
    size, stated = wired.size, _stated(block)
    if len(stated) > 1:
        # -1 leaves a width open: what remains is shared evenly among these
        free = [at for at, width in enumerate(stated) if width <= 0]
        rest = size - sum(width for width in stated if width > 0)
        for at, width in zip(free, _divide_evenly(rest, len(free)), strict=True):
            stated[at] = width
        if sum(stated) != size or min(stated) < 1:
            parts = str(stated)[:100]
            message = f"a vector of {count_noun(size, 'element')} cannot be split into outputs of {parts}"
            raise UnsupportedError(message + width_notes(wired))
        return stated
    count = stated[0] if stated else 0
    if not 1 <= count <= size:
        message = f"a vector of {count_noun(size, 'element')} cannot be split into {count} outputs"
        raise UnsupportedError(message + width_notes(wired))
    return _divide_evenly(size, count)


def _divide_evenly(size: int, count: int) -> list[int]:
    """Divide a number of elements evenly among outputs; the first get the remainder."""
    return [size // count + (at < size % count) for at in range(count)] if count else []


@block("BusCreator", routes=True, Inputs="2")
def bus_creator(block: BlockContext) -> SignalOrBus:
    """Collect the inputs to a bus, named after their lines, or as its bus object specifies."""
    labels = [block.flat.input_names.get(at, "") for at in range(block.input_count)]
    names = bus_member_names(labels, block.field_text("Inputs"))
    bus = Bus({name: _created_member(block, at) for at, name in enumerate(names)})
    return fit_to_bus(block, block.output_type, bus) if isinstance(block.output_type, BusType) else bus


def _created_member(block: BlockContext, index: int) -> SignalOrBus:
    """Return an input, or a placeholder while only the others are compared with the bus object."""
    source = block.source(index)
    if source is not None and not block.compiler.is_lowered(source):
        return placeholder_signal(block.builder)
    return block.input_or_bus(index)


@block("BusSelector", OutputSignals="signal1", OutputAsBus="off")
def bus_selector(block: BlockContext) -> Outputs:
    """Select signals of a bus by name."""
    wired = block.bus()
    paths = [path.strip() for path in block.field_text("OutputSignals").split(",")]
    signals = [_member_of(wired, path) for path in paths]
    if block.is_on("OutputAsBus"):
        return Bus({path.rpartition(".")[2]: signal for path, signal in zip(paths, signals, strict=True)})
    return tuple(signals)


def _member_of(wired: SignalOrBus, path: str) -> SignalOrBus:
    """Return the member of a bus at a path "a.b"."""
    for name in path.split("."):
        if not isinstance(wired, Bus):
            raise UnsupportedError(f"it selects {path} from a signal that is not a bus")
        member = wired.member(name)
        if member is None and (other := find_bus_member(list(wired.members), name)) is not None:
            member = wired.members[other]
        if member is None:
            known = ", ".join(wired.members)
            raise UnsupportedError(f"it selects {path}, but the bus contains {known[:200]}")
        wired = member
    return wired


@block("BusAssignment", routes=True, AssignedSignals="")
def bus_assignment(block: BlockContext) -> SignalOrBus:
    """Replace signals of a bus."""
    bus = block.bus()
    if isinstance(bus, Signal) and not bus.sound:
        # behind an unsupported block nothing is known of the bus itself
        return bus
    for at, path in enumerate(block.field_text("AssignedSignals").split(","), 1):
        # raises an error if the bus has no such signal, which `_set_member` would add
        old, new = _member_of(bus, path.strip()), block.input_or_bus(at)
        _check_assigned(path.strip(), old, new)
        bus = _set_member(bus, path.strip().split("."), new)
    return bus


def _check_assigned(path: str, old: SignalOrBus, new: SignalOrBus) -> None:
    """Raise `UnsupportedError` if a signal does not have the width that the object of a bus specifies for it."""
    if not isinstance(old, Signal) or old.width is None or old.width.key is not None:
        return
    if not isinstance(new, Signal) or new.size == old.size:
        return
    sizes = f"it assigns {count_noun(new.size, 'element')} to {path}"
    raise UnsupportedError(sizes + width_notes(old, new))


@block("BusElement", "BusElements")
def bus_element(block: BlockContext) -> SignalOrBus:
    """Return an element of an input bus port, or the bus that an output bus port collects from its elements."""
    if block.flat.unsupported_reason:
        raise UnsupportedError(f"unsupported: {block.flat.unsupported_reason}")
    if block.flat.type == "BusElement":
        path = block.flat.bus_paths[0] if block.flat.bus_paths else ""
        return _member_of(block.input_or_bus(0), path) if path else block.input_or_bus(0)
    bus: SignalOrBus = Bus()
    for at, path in enumerate(block.flat.bus_paths):
        if not path:
            return block.input_or_bus(at)
        bus = _set_member(bus, path.split("."), block.input_or_bus(at))
    return bus


def _set_member(wired: SignalOrBus, path: list[str], new: SignalOrBus) -> SignalOrBus:
    """Return a bus with a signal added or replaced at a path, creating the buses on the way."""
    if not path:
        return new
    bus = wired if isinstance(wired, Bus) else Bus()
    inner = _set_member(bus.member(path[0]) or Bus(), path[1:], new)
    return replace(bus, members={**bus.members, path[0]: inner})


@block("Concatenate", Mode="Vector", ConcatenateDimension="1")
def concatenate(block: BlockContext) -> SignalOrBus:
    """Concatenate vectors, or matrices along a dimension."""
    inputs = block.inputs
    period = period_of(inputs)
    if block.option("Mode", "Vector", "Multidimensional array") == "Vector":
        return block.signal(_concatenate_vectors(inputs), period)
    axis = block.integer_field("ConcatenateDimension", 1, 2) - 1
    parts = [signal.matrix for signal in inputs]
    try:
        return block.signal(np.concatenate(parts, axis=axis), period)
    except ValueError:
        sizes = ", ".join(size_text(part.shape) for part in parts)
        message = f"its inputs of sizes {sizes} cannot be concatenated{width_notes(*inputs)}"
        raise UnsupportedError(message) from None


def _concatenate_vectors(inputs: Sequence[Signal]) -> Nodes:
    """Concatenate the elements of vectors; a row or column if one of them is."""
    nodes = np.array([node for signal in inputs for node in signal.flat], dtype=np.int64)
    shapes = {signal.shape for signal in inputs if signal.nodes.ndim == 2 and signal.size > 1}
    if not shapes:
        return nodes
    if all(rows == 1 for rows, _ in shapes):
        return nodes.reshape(1, -1)
    if all(columns == 1 for _, columns in shapes):
        return nodes.reshape(-1, 1)
    sizes = ", ".join(size_text(signal.shape) for signal in inputs)
    message = f"it concatenates vectors, but its inputs have the sizes {sizes}"
    raise UnsupportedError(message + width_notes(*inputs))


@block("Reshape", OutputDimensionality="1-D array", OutputDimensions="[1,1]")
def reshape(block: BlockContext) -> SignalOrBus:
    """Reshape the elements of the input, column by column."""
    x = block.input()
    shapes = {"1-D array": (-1,), "Column vector (2-D)": (-1, 1), "Row vector (2-D)": (1, -1)}
    kind = block.option("OutputDimensionality", *shapes, "Customize", "Derive from reference input port")
    if kind == "Derive from reference input port":
        shape: tuple[int, ...] = block.input(1).shape
    else:
        shape = shapes.get(kind) or tuple(int(n) for n in block.numeric_array("OutputDimensions").ravel())
    try:
        return block.signal(x.nodes.reshape(shape, order="F"), x.period)
    except ValueError:
        message = f"{count_noun(x.size, 'element')} cannot be reshaped to {size_text(shape)}"
        raise UnsupportedError(message + width_notes(x)) from None


@block("Selector", output=LIKE_INPUT, NumberOfDimensions="1", IndexMode="One-based", InputPortWidth="-1")
def selector(block: BlockContext) -> SignalOrBus:
    """Select elements of a vector or matrix by index."""
    x = block.input()
    dimensions = block.integer_field("NumberOfDimensions", 1, 2)
    options = index_options(block) or _old_options(block, dimensions)
    index_fields = dimension_settings(block, "Indices", "IndexParamArray") or [block.field_text("Elements", "")]
    width = block.integer_field("InputPortWidth", -1, _MAX_SELECTED)
    # without a width of the port, an index tells at least how many elements there are
    least = max(width, _last_index(block, options[0], index_fields[0]) if options and index_fields else -1)
    if x.size == 1 < least and dimensions == 1:
        block.suggest_dimensions((least,))
    nodes = np.array(x.flat, dtype=np.int64) if dimensions == 1 else x.nodes
    if nodes.ndim != dimensions:
        message = f"it selects along {dimensions} dimensions, but its input has {nodes.ndim}"
        raise UnsupportedError(message + width_notes(x))
    port = 1
    for axis, option in enumerate(options[:dimensions]):
        text = index_fields[axis] if axis < len(index_fields) else ""
        if option in ("Index vector (port)", "Starting index (port)"):
            # axis by axis: what remains after one is selected along the next
            nodes = _select_variable(block, nodes, axis, _variable_indices(block, option, axis, block.input(port)))
            port += 1
        else:
            places = selected_indices(block, option, text, nodes.shape[axis], axis, note=width_notes(x))
            nodes = np.take(nodes, places, axis=axis)
    return block.signal(nodes, period_of(block.inputs))


def _last_index(block: BlockContext, option: str, text: str) -> int:
    """Return the number of the last element that constant indices select, 0 if they are not constant."""
    if option != "Index vector (dialog)" or not text:
        return 0
    first = first_index(block)
    return int(max(block.evaluate(text).ravel(), default=first)) - first + 1


def _old_options(block: BlockContext, dimensions: int) -> list[str]:
    if not block.is_set_to("ElementSrc", "Internal", default="Internal") or block.is_on("IndexIsStartValue"):
        raise UnsupportedError("its indices come from an input in a way that is not supported")
    return ["Index vector (dialog)"] * dimensions


def _variable_indices(block: BlockContext, option: str, axis: int, index: Signal) -> Signal:
    """Return the indices from an input; a starting index covers as many elements as the file specifies."""
    if option != "Starting index (port)":
        return index
    count = selection_length(block, axis)
    if index.size != 1 or not 1 <= count <= _MAX_SELECTED:
        raise UnsupportedError(f"it selects {count} elements from {index.size} starting indices")
    return index + block.constant(*map(float, range(count)))


def _select_variable(block: BlockContext, nodes: Nodes, axis: int, places: Signal) -> Nodes:
    """Select elements at variable indices by comparing the index with each candidate."""
    if places.size * nodes.size > _MAX_COMPARISONS:
        raise UnsupportedError(f"{places.size} variable indices into {nodes.size} elements are too many")
    slices = [block.signal(np.atleast_1d(np.take(nodes, at, axis=axis))) for at in range(nodes.shape[axis])]
    picked = []
    for place in places.flat:
        # an index is cut off to an integer; beyond the ends, it selects the first or last element
        selected = select_by_index(block.signal([place]), slices, 1.0 + first_index(block))
        picked.append(selected.nodes.reshape(np.take(nodes, 0, axis=axis).shape))
    return np.stack(picked, axis=axis)


@block("ManualSwitch", "Manual Switch", linked=True, CurrentSetting="1", sw="1")
def manual_switch(block: BlockContext) -> SignalOrBus:
    """Pass on the input selected by the stored switch position."""
    upper = block.numeric_field(block.field_name("CurrentSetting", "sw")) != 0
    return block.input_or_bus(0 if upper else 1)


@block("Switch", output=OutputType((0, 2), floating=True), Criteria="u2 >= Threshold", Threshold="0", SampleTime="-1")
def switch(block: BlockContext) -> SignalOrBus:
    """Pass on the first input if the second meets the criterion, else the third."""
    criterion = block.option("Criteria", "u2 >= Threshold", "u2 > Threshold", "u2 ~= 0")
    u = block.input(1)
    if criterion == "u2 ~= 0":
        condition = apply("ne", u, 0.0)
    else:
        condition = apply("ge" if ">=" in criterion else "gt", u, block.parameter("Threshold"))
    return select_signal(condition, block.input_or_bus(0), block.input_or_bus(2))


def select_signal(condition: Signal, yes: SignalOrBus, no: SignalOrBus) -> SignalOrBus:
    """Select one of two signals or buses."""
    mismatch = "it switches between a bus and a signal, or between different buses"
    return map_members(lambda a, b: select(condition, a, b), mismatch, yes, no)


@block("MultiPortSwitch", Inputs="3", DataPortOrder="One-based contiguous", DataPortIndices="{1,2,3}", SampleTime="-1",
       DataPortForDefault="Last data port", zeroidx="off")  # fmt: skip
def multiport_switch(block: BlockContext) -> SignalOrBus:
    """Select an input by the value of the first; other values select the last or default input."""
    order = block.option("DataPortOrder", "One-based contiguous", "Zero-based contiguous", "Specify indices")
    index = block.truncate(block.input(0))
    data = [block.input_or_bus(at) for at in range(1, block.input_count)]
    if len(data) == 1 and isinstance(data[0], Signal):  # the elements of a single data port are the choices
        data = list(data[0].elements)
    if not data:
        raise UnsupportedError("it has no data port")
    if order == "Specify indices":
        numbers = case_values(block, "DataPortIndices")
        if len(data) != len(numbers) + block.is_set_to("DataPortForDefault", "Additional data port"):
            raise UnsupportedError(f"it has {len(data)} data ports but {len(numbers)} indices")
    else:
        first = 0 if order.startswith("Zero") or block.is_on("zeroidx") else 1
        numbers = [[float(first + at)] for at in range(len(data))]
    # built from the last port, which any number without a case takes, to the first
    selected = data[-1]
    for at in reversed(range(len(data) - 1)):
        selected = select_signal(block.is_among(index, numbers[at]), data[at], selected)
    return selected


@block("InactiveVariant", needs=no_feedthrough)
def inactive(block: BlockContext) -> SignalOrBus:
    """Refuse an output of an inactive variant source or sink."""
    raise UnsupportedError("this output belongs to an inactive variant")


@block(
    "DataStoreMemory",
    output=OutputType(states=True),
    needs=no_feedthrough,
    DataStoreName="A",
    InitialValue="0",
    Dimensions="-1",
)
def data_store_memory(block: BlockContext) -> SignalOrBus:
    """Read the content of a data store at the start of the step."""
    init = block.parameter("InitialValue")
    dimensions = [int(n) for n in block.numeric_array("Dimensions").ravel()]
    # a scalar start fills a store with stated dimensions
    if init.size == 1 and min(dimensions, default=-1) > 0:
        init = block.signal(fit_to_shape(init.nodes, tuple(dimensions)), init.period)
    return block.compiler.contents.content(block.flat, init)


def _memory(block: BlockContext) -> BlockContext:
    if block.field_text("DataStoreElements", "") or block.is_on("EnableIndexing"):
        raise UnsupportedError("it accesses elements of its data store, which is not supported")
    if block.flat.data_store is None:
        remedy = "Define it as a Simulink.Signal in a script or dictionary given as parameters, or bind this block."
        raise UnsupportedError(f"data store {block.field_text('DataStoreName')} not found", remedy)
    return block.of(block.flat.data_store)


@block("DataStoreRead", output=OutputType(states=True), needs=no_feedthrough, DataStoreName="A", SampleTime="-1")
def data_store_read(block: BlockContext) -> SignalOrBus:
    """Read the content of a data store after the writers that run before this block.

    One that exists outside of what is imported, and is not written within, is an input.
    """
    if block.flat.data_store is None and not _writes(block):
        inputs, own = block.compiler.inputs, block.field_text("DataStoreName").strip()
        name = inputs.channel(block.flat, own)
        block.warn(f"reads the data store {own}, which is not in the model: it is the input {name}")
        return inputs.open_signal(block.flat, name, "its data store is not in the model")
    content = data_store_memory(_memory(block))
    assert isinstance(content, Signal)
    return block.compiler.contents.content_after(content, block.compiler.stores.writers_before(block.flat))


def _writes(block: BlockContext) -> bool:
    """Return True if the data store of a name is written."""
    own = block.field_text("DataStoreName").strip()
    writers = (flat for flat in block.compiler.flat.blocks if flat.type == "DataStoreWrite")
    return any(block.of(flat).field_text("DataStoreName").strip() == own for flat in writers)


@block("DataStoreWrite", DataStoreName="A", SampleTime="-1")
def data_store_write(block: BlockContext) -> SignalOrBus:
    """Return the signal that is written."""
    _memory(block)
    return block.input()
